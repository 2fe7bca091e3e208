"""The places that scans visited, and what they inherit from the objects that were there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, U16, Bool
from dynaviz.blocks.blocks import BlockGrid
from dynaviz.spatial.grid import pack_indices

DYNAMIC = 0.5  # certainty of an object that is dynamic as a whole
PLACE = 4  # voxels along x and y
SCANS = 64  # in fewer, fewer errors add up: the prior is smaller; an object is compared with itself so many before


@dataclass(frozen=True, eq=False)
class Visits:
    """The places that one scan visited.

    Attributes:
        number: position of the scan.
        places: (V,) int32; objects: (V,) int32, that of each.
        reach: (O, 8) float32, metres: how far each object reaches in eight directions.
    """

    number: int
    places: I32
    objects: I32
    reach: F32


@dataclass(frozen=True, eq=False)
class Decision:
    """What decides the labels of points, by place; all (4 B,), the last block being that of points without one.

    Attributes:
        own: float32: evidence of places, less the prior.
        shared: float32: mean certainty of the objects that were there, from -1, static, to 1, dynamic.
        source: int32: position of the last scan in which it was above 0; -1 for none.
        inherit: weight of what places inherit from objects; with it, the evidence of dynamic ones exceeds 0.
        weights: as from ``History.weights``.
    """

    own: F32
    shared: F32
    source: I32
    inherit: float
    weights: tuple[float, ...]

    @property
    def prior(self) -> float:
        """The evidence that a voxel must exceed to count as empty at times."""
        return self.weights[3]


class History:
    """The visits of places by objects.

    Args:
        grid: the grid of the places' blocks.
        guard: metres around a hit that are not clear: objects that move by less leave nothing clear.
        inherit: weight of what a place inherits.
        weights: of a crossing near a hit, of a hit; clear crossings for full evidence; the prior.
        counts: three arrays (B, 512) uint16: scans that hit, saw clear, and grazed each voxel.
    """

    def __init__(
        self, grid: BlockGrid, guard: float, inherit: float, weights: tuple[float, ...], counts: tuple[U16, ...]
    ) -> None:
        rows, own = len(grid) + 1, grid.per_block
        self._guard, self._inherit, self._weights, self._counts = guard, inherit, weights, counts
        self._visits: dict[int, Visits] = {}
        self._stamps, self._source = (own(np.full((rows, 4), -1, np.int32), -1) for _ in range(2))
        self._up = own(np.zeros((rows, 8), np.uint64))
        self._own, self._shared = (own(np.zeros((rows, 4), np.float32)) for _ in range(2))
        self._number = own(np.zeros((rows, 4), np.int32))  # visits
        self._since = np.zeros(rows, np.int64)  # by block: the scan with which it came
        self._grid, self._now, self._weighed = grid, -1, -1  # the last scan; the last one whose places inherited
        grid.watch(self._block_came)

    def _block_came(self, numbers: I32) -> None:
        self._since[numbers] = self._now + 1

    def add(self, number: int, points: F32, voxels: I64, objects: I32, count: int) -> None:
        """Add the visits of a scan that was counted.

        Args:
            number: position of the scan.
            points: (N, 3) float32, metres, world frame.
            voxels: (N,) int64, objects: (N,) int32: of each point, -1 for none.
            count: number of objects.
        """
        places, owners = kernels.places.visit(voxels, objects, number, self._up, self._stamps)
        reach = kernels.places.reaches(points, objects, count)
        self._visits[number], self._now = Visits(number, places, owners, reach), number

    def weights(self) -> tuple[float, ...]:
        """As given, with the prior for the scans so far."""
        return *self._weights[:3], self._weights[3] * min((self._now + 1) / SCANS, 1.0)

    def _weigh(self, places: I32, found: F32) -> None:
        kernels.places.evidence(places, self._up, *self._counts, self.weights(), found.reshape(-1))

    def _certain(self, places: I32, objects: I32, count: int, own: F32, shared: F32) -> F64:
        """(O,) float64: certainty of objects, so many; 1 if they are dynamic."""
        weights = self._inherit, 1 / self._weights[2]
        certain: F64 = kernels.places.certainties(places, objects, count, own, shared, *weights)
        return np.where(certain > DYNAMIC, 1.0, certain)

    def so_far(self) -> Decision:
        """What decides the labels of the last scan, by the scans so far; their places inherit only if this is asked."""
        own, shared, source = self._own.ravel(), self._shared.ravel(), self._source.ravel()
        for number in range(self._weighed + 1, self._now + 1):
            if number in self._visits:
                visits = self._remaining(self._visits[number])
                self._weigh(visits.places, self._own)
                certain = self._certain(visits.places, visits.objects, len(visits.reach), own, shared)
                scans = np.full_like(visits.places, number)
                kernels.places.share(
                    visits.places, visits.objects, certain, scans, self._number.ravel(), shared, source
                )
        self._weighed = self._now
        return Decision(own, shared, source, self._inherit, self.weights())

    def decide(self) -> Decision:
        """What decides the labels of all scans that were not forgotten."""
        visits = [self._remaining(each) for each in self._visits.values()]
        empty, sizes = np.empty(0, np.int32), np.array([len(each.places) for each in visits], np.int64)
        places = np.concatenate([empty, *(each.places for each in visits)])
        numbers = np.repeat(np.array([each.number for each in visits], np.int32), sizes)
        firsts = np.cumsum([0, *(len(each.reach) for each in visits)])
        reach = np.concatenate([np.empty((0, 8), np.float32), *(each.reach for each in visits)])
        objects = np.concatenate([empty, *(each.objects + first for each, first in zip(visits, firsts, strict=False))])
        own, (shared, source) = np.zeros(self._own.size, np.float32), self._nothing()
        visited = np.zeros(own.size, np.bool_)
        visited[places] = True
        existing, rows = np.flatnonzero(visited).astype(np.int32), (np.cumsum(visited) - 1)[places]
        self._weigh(existing, own)
        for last in (False, True):
            certain = self._certain(places, objects, len(reach), own, shared)
            if last:
                evidence = (own + self._inherit * np.maximum(shared, 0.0))[places]
                visiting = existing, rows, objects, evidence
                certain[self._followed(firsts, reach, *visiting, certain > DYNAMIC)] = 1.0
            shared, source = self._nothing()
            number = np.zeros(len(own), np.int32)
            kernels.places.share(places, objects, certain, numbers, number, shared, source)
        return Decision(own, shared, source, self._inherit, self.weights())

    def _nothing(self) -> tuple[F32, I32]:
        return np.zeros(self._own.size, np.float32), np.full(self._own.size, -1, np.int32)

    def _followed(
        self, firsts: I64, reach: F32, existing: I32, rows: I64, objects: I64, evidence: F32, dynamic: Bool
    ) -> Bool:
        """(O,) bool: objects that are dynamic, that moved along themselves, and that continue such ones.

        Args:
            firsts: (F + 1,) int64: the first object of each scan; reach: (O, 8) float32, metres, of objects.
            existing: (E,) int32: all places that were visited; rows, objects: (V,) int64: of each visit.
            evidence: (V,) float32: above 0 if the place is dynamic; dynamic: (O,) bool.
        """
        keys = self._grid.blocks[existing >> 2]
        _, columns = np.unique(pack_indices(keys * (1, 1, 0)), return_inverse=True)
        width, order = columns.max(initial=0) + 1, np.argsort(objects, kind="stable")
        halves = np.stack([existing >> 1 & 1, existing & 1], 1)
        centres = ((2 * keys[:, :2] + halves + 0.5) * PLACE * self._grid.resolution).astype(np.float32)
        scans = np.searchsorted(firsts, objects, "right") - 1
        came, gone = np.zeros((2, len(existing)), np.int64)
        came[rows[::-1]], gone[rows] = scans[::-1], -scans
        of_places = (each[rows[order]] for each in (centres, came, gone))
        places = np.searchsorted(objects[order], np.arange(len(reach) + 1)), *of_places, evidence[order]
        objects, columns = np.divmod(np.unique(objects * width + columns[rows]), width)
        in_columns = np.searchsorted(objects, firsts), objects, columns
        last, found = np.full(width, -1), np.zeros_like(dynamic)
        dynamic |= kernels.places.moved(*in_columns, reach, self._guard, SCANS, *places, last)
        for back in (False, True):
            way = dynamic.copy()
            kernels.places.follow(*in_columns, way, np.full(width, -1), back)
            found |= way
        return found

    def _remaining(self, visits: Visits) -> Visits:
        """Visits of places whose blocks did not go since."""
        here = self._since[visits.places >> 2] <= visits.number
        if here.all():
            return visits
        return replace(visits, **{name: getattr(visits, name)[here] for name in ("places", "objects")})

    def forget(self, number: int) -> None:
        """Drop the visits of a scan."""
        self._visits.pop(number, None)
