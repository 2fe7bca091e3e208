"""The places that scans visited, and what they inherit from the objects that were there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, U16, Bool
from dynaviz.blocks.blocks import BlockGrid
from dynaviz.spatial.grid import pack_indices

DYNAMIC = 0.5  # certainty of an object that is dynamic as a whole
SCANS = 64  # in fewer scans, fewer errors add up: the prior is smaller


@dataclass(frozen=True, eq=False)
class Visits:
    """The places that one scan visited.

    Attributes:
        number: position of the scan.
        places: (V,) int32; objects: (V,) int32, that of each.
    """

    number: int
    places: I32
    objects: I32


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
        inherit: weight of what a place inherits.
        weights: of a crossing near a hit, of a hit; clear crossings for full evidence; the prior.
        counts: three arrays (B, 512) uint16: scans that hit, saw clear, and grazed each voxel.
    """

    def __init__(self, grid: BlockGrid, inherit: float, weights: tuple[float, ...], counts: tuple[U16, ...]) -> None:
        rows, own = len(grid) + 1, grid.per_block
        self._inherit, self._weights, self._counts = inherit, weights, counts
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

    def add(self, number: int, voxels: I64, objects: I32) -> None:
        """Add the visits of a scan that was counted.

        Args:
            number: position of the scan.
            voxels: (N,) int64, objects: (N,) int32: of each point, -1 for none.
        """
        visits = kernels.places.visit(voxels, objects, number, self._up, self._stamps)
        self._visits[number], self._now = Visits(number, *visits), number

    def weights(self) -> tuple[float, ...]:
        """As given, with the prior for the scans so far."""
        return *self._weights[:3], self._weights[3] * min((self._now + 1) / SCANS, 1.0)

    def _weigh(self, places: I32, found: F32) -> None:
        kernels.places.evidence(places, self._up, *self._counts, self.weights(), found.reshape(-1))

    def _certain(self, places: I32, objects: I32, own: F32, shared: F32) -> F64:
        """(O,) float64: certainty of objects; 1 if they are dynamic."""
        certain: F64 = kernels.places.certainties(places, objects, own, shared, self._inherit, 1 / self._weights[2])
        return np.where(certain > DYNAMIC, 1.0, certain)

    def so_far(self) -> Decision:
        """What decides the labels of the last scan, by the scans so far; their places inherit only if this is asked."""
        own, shared, source = self._own.ravel(), self._shared.ravel(), self._source.ravel()
        for number in range(self._weighed + 1, self._now + 1):
            if number in self._visits:
                visits = self._remaining(self._visits[number])
                self._weigh(visits.places, self._own)
                certain = self._certain(visits.places, visits.objects, own, shared)
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
        firsts = np.cumsum([0, *(each.objects.max(initial=-1) + 1 for each in visits)])
        objects = np.concatenate([empty, *(each.objects + first for each, first in zip(visits, firsts, strict=False))])
        own, (shared, source) = np.zeros(self._own.size, np.float32), self._nothing()
        visited = np.zeros(own.size, np.bool_)
        visited[places] = True
        existing, rows = np.flatnonzero(visited).astype(np.int32), (np.cumsum(visited) - 1)[places]
        self._weigh(existing, own)
        for last in (False, True):
            certain = self._certain(places, objects, own, shared)
            if last:
                certain[self._followed(firsts, existing, rows, objects, certain > DYNAMIC)] = 1.0
            shared, source = self._nothing()
            number = np.zeros(len(own), np.int32)
            kernels.places.share(places, objects, certain, numbers, number, shared, source)
        return Decision(own, shared, source, self._inherit, self.weights())

    def _nothing(self) -> tuple[F32, I32]:
        return np.zeros(self._own.size, np.float32), np.full(self._own.size, -1, np.int32)

    def _followed(self, firsts: I64, existing: I32, rows: I64, objects: I64, dynamic: Bool) -> Bool:
        """(O,) bool: objects that continue dynamic ones, forward or backward in time, and these.

        Args:
            firsts: (F + 1,) int64: the first object of each scan.
            existing: (E,) int32: all places that were visited; rows, objects: (V,) int64: of each visit.
            dynamic: (O,) bool.
        """
        _, columns = np.unique(pack_indices(self._grid.blocks[existing >> 2] * (1, 1, 0)), return_inverse=True)
        width = columns.max(initial=0) + 1
        objects, columns = np.divmod(np.unique(objects * width + columns[rows]), width)
        starts, found = np.searchsorted(objects, firsts), np.zeros_like(dynamic)
        for back in (False, True):
            way = dynamic.copy()
            kernels.places.follow(starts, objects, columns, way, np.full(width, -1), back)
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
