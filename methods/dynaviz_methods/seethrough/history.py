"""The places that scans visited, and what they inherit from the objects that were there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, I32, I64, U16, Bool
from dynaviz.blocks.blocks import BlockGrid
from dynaviz.kernels.keys import REACH, X_SHIFT
from dynaviz.spatial.grid import pack_indices

KERNELS = kernels.load("dynaviz_methods.seethrough.kernels")

DYNAMIC = 0.5  # certainty of an object that is dynamic as a whole
PLACE = 4  # voxels along x and y
# in fewer, fewer errors add up: the prior is smaller; an object is compared with itself so many
# before;
SCANS = 64
# online, the objects of so many scans decide


@dataclass(frozen=True, eq=False)
class Visits:
    """The places that one scan visited, and the columns of blocks that contain them, by object.

    Attributes:
        number: position of the scan.
        places: (V,) int32; begins: (O + 1,) int64: where those of each object begin.
        columns: (K,) int32; at: (O + 1,) int64: where those of each object begin.
        cells: (C,) int64, ascending: key of each column of this scan.
        reach: (O, 8) float32, metres: how far each object reaches in eight directions.
    """

    number: int
    places: I32
    begins: I64
    columns: I32
    at: I64
    cells: I64
    reach: F32


@dataclass(frozen=True, eq=False)
class Decision:
    """What decides the labels of points, by place.

    Attributes:
        rows: (4 B,) int32: where the following arrays tell of each place; 0 for those that no
            object visited. The last block is that of points without one. Online, the next decision
            changes them.
        own: (R + 1,) float32: evidence of places, less the prior.
        shared: (R + 1,) float32: mean certainty of the objects that were there, from -1, static, to
            1, dynamic.
        source: (R + 1,) int32: position of the last scan in which it was above 0; -1 for none.
        inherit: weight of what places inherit from objects; with it, the evidence of dynamic ones
            exceeds 0.
        weights: as from ``History.weights``.
    """

    rows: I32
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
        guard: metres around a hit that are not clear: objects that move by less leave nothing
            clear.
        inherit: weight of what a place inherits.
        weights: of a crossing near a hit, of a hit; clear crossings for full evidence; the prior.
        counts: three arrays (B, 512) uint16: scans that hit, saw clear, and grazed each voxel.
    """

    def __init__(
        self,
        grid: BlockGrid,
        guard: float,
        inherit: float,
        weights: tuple[float, ...],
        counts: tuple[U16, ...],
    ) -> None:
        rows = len(grid) + 1
        self._guard = guard
        self._inherit = inherit
        self._weights = weights
        self._counts = counts
        self._visits: dict[int, Visits] = {}
        # scans whose visits go when they are no longer among the last ones
        self._dropped: set[int] = set()
        self._stamps = grid.per_block(np.full((rows, 4), -1, np.int32), -1)
        self._up = grid.per_block(np.zeros((rows, 8), np.uint64))
        # of the last online decision
        self._rows = np.zeros(4 * rows, np.int32)
        self._places = np.empty(0, np.int32)
        self._since = np.zeros(rows, np.int64)  # by block: the scan with which it came
        # the last scan
        self._grid = grid
        self._now = -1
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
        places, begins = KERNELS.places.visit(
            voxels, objects, count, number, self._up, self._stamps
        )
        owners = np.repeat(np.arange(count), np.diff(begins))
        pairs = np.unique(
            pack_indices(np.column_stack([owners, self._grid.blocks[places >> 2, :2]]))
        )
        at = np.searchsorted(pairs, np.arange(count + 1) + REACH << X_SHIFT)
        cells, columns = np.unique(pairs & (1 << X_SHIFT) - 1, return_inverse=True)
        reach = KERNELS.moves.reaches(points, objects, count)
        self._visits[number] = Visits(
            number, places, begins, columns.astype(np.int32), at, cells, reach
        )
        self._now = number

    def weights(self) -> tuple[float, ...]:
        """As given, with the prior for the scans so far."""
        return *self._weights[:3], self._weights[3] * min((self._now + 1) / SCANS, 1.0)

    def decide(self, online: bool = False) -> Decision:
        """What decides the labels, by the scans so far.

        Args:
            online: by the visits of the last ``SCANS`` scans; else by those of all scans that were
                not forgotten. What voxels show, all scans counted.
        """
        visits = [
            each for each in self._visits.values() if not online or each.number > self._now - SCANS
        ]
        firsts = np.cumsum([0, *(len(each.reach) for each in visits)])
        visited, begins = self._remaining(visits)
        rows = self._rows if online else np.zeros_like(self._rows)
        rows[self._places] = 0
        places = np.append(np.int32(0), np.sort(KERNELS.places.distinct(visited, rows)))  # by row
        rows[places[1:]] = np.arange(1, len(places))
        of_visits = rows[visited]
        if online:
            self._places = places
        own = KERNELS.places.evidence(places, self._up, *self._counts, self.weights())
        numbers = np.array([each.number for each in visits], np.int32)
        shared = np.zeros_like(own)
        for last in (False, True):
            of_places = of_visits, begins, own, shared, self._inherit
            certain = KERNELS.places.certainties(*of_places, 1 / self._weights[2])
            dynamic = certain > DYNAMIC
            if last:
                dynamic = self._followed(visits, firsts, places, of_places, dynamic)
            certain[dynamic] = 1.0
            shared, source = KERNELS.places.share(
                firsts, numbers, of_visits, begins, certain, len(own)
            )
        return Decision(rows, own, shared, source, self._inherit, self.weights())

    def _remaining(self, visits: Sequence[Visits]) -> tuple[I32, I64]:
        """Visited places whose blocks did not go since, (V,) int32, and where those of each object
        begin, (O + 1,).
        """
        places, begins = _joined([(each.places, each.begins) for each in visits])
        if not self._grid.rolls:
            return places, begins
        scans = np.repeat([each.number for each in visits], [len(each.places) for each in visits])
        here = self._since[places >> 2] <= scans
        return places[here], np.append(0, np.cumsum(here))[begins]

    def _followed(
        self,
        visits: Sequence[Visits],
        firsts: I64,
        places: I32,
        of_places: tuple[I32, I64, F32, F32, float],
        dynamic: Bool,
    ) -> Bool:
        """(O,) bool: objects that are dynamic, that moved along themselves, and that continue such
        ones.

        Args:
            visits: of the scans; firsts: (F + 1,) int64: the first object of each.
            places: (R + 1,) int32, by row; of_places: the first arguments of
                ``KERNELS.places.certainties``.
            dynamic: (O,) bool.
        """
        if not len(dynamic):
            return dynamic
        cells, numbers = np.unique(
            np.concatenate([each.cells for each in visits]), return_inverse=True
        )
        of_scans = np.split(
            numbers.astype(np.int32), np.cumsum([len(each.cells) for each in visits[:-1]])
        )
        columns, at = _joined(
            [(of[each.columns], each.at) for of, each in zip(of_scans, visits, strict=True)]
        )
        tracks = firsts, at, columns, len(cells)
        reach = np.concatenate([each.reach for each in visits])
        quarters = np.stack([places >> 1 & 1, places & 1], 1)
        centres = (2 * self._grid.blocks[places >> 2, :2] + quarters + 0.5) * (
            PLACE * self._grid.resolution
        )
        moves = reach, self._guard, SCANS, self._weights[1], centres.astype(np.float32)
        dynamic |= KERNELS.moves.moved(*tracks, *moves, *of_places)
        forward = dynamic.copy()
        backward = dynamic.copy()
        KERNELS.tracks.follow(*tracks, forward, False)
        KERNELS.tracks.follow(*tracks, backward, True)
        return forward | backward

    def forget(self, number: int) -> None:
        """Drop the visits of a scan, once it is not among the last ``SCANS``."""
        self._dropped.add(number)
        for each in [each for each in self._dropped if each <= self._now - SCANS]:
            self._dropped.remove(each)
            self._visits.pop(each, None)


def _joined(parts: Sequence[tuple[I32, I64]]) -> tuple[I32, I64]:
    """Values (N,) of objects, and where those of each one begin, (O + 1,), of several scans in
    turn.
    """
    values = np.concatenate([np.empty(0, np.int32), *(each for each, _ in parts)])
    firsts = np.cumsum([0, *(len(each) for each, _ in parts)])
    begins = [begins[:-1] + first for (_, begins), first in zip(parts, firsts, strict=False)]
    return values, np.concatenate([*begins, firsts[-1:]])
