"""The places that scans visited, and what they inherit from dynamic objects where their life begins or ends."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import F32, I32, I64, U16, U64
from dynaviz.blocks.blocks import BlockGrid, Marks
from dynaviz.spatial.grid import pack_indices

CERTAIN = 0.35  # evidence for full certainty
LEAST = 0.5  # weight of a place without evidence, against 1 more for one that is certain
WHOLLY = 1 / 3  # mean certainty of the places of an object that is dynamic as a whole
LIVE_NEAR, LIVE_PRIOR = 0.3, 0.02  # online, where there is less evidence


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
        own: float32: evidence of places; born, left: float32: what they inherit at their beginning and at their end;
            along: float32: 1 if all objects that were there are dynamic as a whole, -1 if none is.
        came, went: int32: position of the last scan from which they inherit this, in each direction; -1 for none.
        inherit: weight of what places inherit; prior: what the sum must exceed.
    """

    own: F32
    born: F32
    left: F32
    along: F32
    came: I32
    went: I32
    inherit: float
    prior: float


class History:
    """The lives of places. A place begins with its first points and ends with its last.

    Args:
        grid: the grid of the places' blocks.
        inherit: weight of what a place inherits.
        prior: what the evidence of a place must exceed, with what it inherits.
        weights: of a crossing near a hit, of a hit; clear crossings for full evidence; most evidence of hits alone.
        counts: three arrays (B, 512) uint16: scans that hit, crossed, and grazed each voxel.
    """

    def __init__(
        self, grid: BlockGrid, inherit: float, prior: float, weights: tuple[float, ...], counts: tuple[U16, ...]
    ) -> None:
        rows, own = len(grid) + 1, grid.per_block
        self._weights, self._live_weights = weights, (min(weights[0], LIVE_NEAR), *weights[1:])
        self._counts = counts
        self._whole, self._live = (inherit, prior, CERTAIN, LEAST), (inherit, LIVE_PRIOR, CERTAIN, LEAST)
        self._visits: dict[int, Visits] = {}
        self._stamps, self._came = (own(np.full((rows, 4), -1, np.int32), -1) for _ in range(2))
        self._up = own(np.zeros((rows, 8), np.uint64))
        self._own, self._born = (own(np.zeros((rows, 4), np.float32)) for _ in range(2))
        self._clear, self._cleared = (own(np.full((rows, 4), -1, np.int32), -1) for _ in range(2))  # first, last scan
        self._number, self._begun = (own(np.zeros((rows, 4), np.int32)) for _ in range(2))  # visits; 1 at a birth
        self._never, self._unknown = np.full((rows, 4), np.int32(-1)), np.zeros((rows, 4), np.float32)
        self._since = np.zeros(rows, np.int64)  # by block: the scan with which it came
        self._grid, self._now = grid, -1
        grid.watch(self._block_came)

    def _block_came(self, numbers: I32) -> None:
        self._since[numbers] = self._now + 1

    def add(self, number: int, voxels: I64, objects: I32, marks: Marks, near: U64) -> None:
        """Add the visits of a scan that was counted, and let its places inherit from what is known so far.

        Args:
            number: position of the scan.
            voxels: (N,) int64, objects: (N,) int32: of each point, -1 for none.
            marks: of the scan; near: (B, 8) uint64: voxels of its blocks near its hits.
        """
        k, self._now = kernels.places, number
        visits = Visits(number, *k.visit(voxels, objects, number, self._up, self._stamps))
        self._visits[number], places = visits, visits.places
        k.see(marks.blocks, marks.bits, near, number, self._clear, self._cleared)
        self._weigh(places, self._live_weights, self._own)
        visited, clear = self._number.ravel(), self._clear.ravel()[places]
        self._begun.ravel()[places[(visited[places] == 0) & (clear >= 0) & (clear < number)]] = 1
        visited[places] += 1
        state = (of.ravel() for of in (self._own, self._born, self._unknown))
        k.inherit(places, visits.objects, visited, *state, self._live, self._came.ravel(), number)

    def _weigh(self, places: I32, weights: tuple[float, ...], found: F32) -> None:
        kernels.places.evidence(places, self._up, *self._counts, weights, found.reshape(-1))

    def so_far(self) -> Decision:
        """What decides the labels of the last scan, by the scans so far."""
        unknown, scans = self._unknown.ravel(), (self._came.ravel(), self._never.ravel())
        return Decision(self._own.ravel(), self._born.ravel(), unknown, unknown, *scans, *self._live[:2])

    def decide(self) -> Decision:
        """What decides the labels of all scans that were not forgotten."""
        k, size = kernels.places, self._own.size
        visits = [self._remaining(each) for each in self._visits.values()]
        starts = np.cumsum([0, *(len(each.places) for each in visits)])
        empty = np.empty(0, np.int32)
        places, objects = (np.concatenate([empty, *(getattr(v, of) for v in visits)]) for of in ("places", "objects"))
        own, born, left = (np.zeros(size, np.float32) for _ in range(3))
        came, went = np.full(size, -1, np.int32), np.full(size, -1, np.int32)
        existing, rows = np.unique(places, return_inverse=True)
        self._weigh(existing, self._weights, own)
        ended = (self._cleared > self._stamps).ravel().astype(np.int32)
        of = starts, places, objects
        k.sweep(*of, self._begun.ravel(), own, born, left, self._whole, came, False)
        k.sweep(*of, ended, own, left, born, self._whole, went, True)
        along = self._tracks(starts, existing, rows, objects, own)
        return Decision(own, born, left, along, came, went, *self._whole[:2])

    def _tracks(self, starts: I64, existing: I32, rows: I64, objects: I32, own: F32) -> F32:
        """(4 B,) float32: how dynamic the objects are, as a whole, that visited each place: from -1, none, to 1, all.

        Args:
            starts: (F + 1,) int64: the visits of each scan.
            existing: (E,) int32: all places that were visited; rows: (V,) int64, objects: (V,) int32: of each visit.
            own: (4 B,) float32: evidence of places.
        """
        _, columns = np.unique(pack_indices(self._grid.blocks[existing >> 2] * (1, 1, 0)), return_inverse=True)
        columns = columns[rows]
        scans = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        _, objects = np.unique(scans << 32 | objects, return_inverse=True)
        nothing = np.zeros_like(own)
        mean = kernels.places.means(existing[rows], objects, own, nothing, nothing, self._whole)
        width = columns.max(initial=0) + 1
        pairs, first = np.unique(objects * width + columns, return_index=True)
        starts = np.searchsorted(scans[first], np.arange(len(starts)))
        dynamic = np.zeros(len(mean), np.bool_)
        for back in (False, True):
            found = mean > WHOLLY
            kernels.places.follow(starts, pairs // width, pairs % width, found, np.full(width, -1), back)
            dynamic |= found
        along = np.zeros(len(own), np.float32)
        along[existing] = 2 * np.bincount(rows, dynamic[objects]) / np.bincount(rows) - 1
        return along

    def _remaining(self, visits: Visits) -> Visits:
        """Visits of places whose blocks did not go since."""
        here = self._since[visits.places >> 2] <= visits.number
        if here.all():
            return visits
        return replace(visits, **{name: getattr(visits, name)[here] for name in ("places", "objects")})

    def forget(self, number: int) -> None:
        """Drop the visits of a scan."""
        self._visits.pop(number, None)

    def move(self, grid: BlockGrid, to: I64, counts: tuple[U16, ...]) -> None:
        """Go on in another grid, in which block k of the old one is block ``to[k]``.

        Args:
            grid: it contains all blocks of the old one.
            to: (B,) int64; counts: the counts of the new grid.
        """
        for name, state in vars(self).items():
            if isinstance(state, np.ndarray):
                setattr(self, name, moved(state, to, len(grid) + 1))
        for number, each in self._visits.items():
            places = (to[each.places >> 2] << 2 | each.places & 3).astype(np.int32)
            self._visits[number] = replace(each, places=places)
        self._grid, self._counts = grid, counts


def moved(state: NDArray[Any], to: I64, rows: int) -> NDArray[Any]:
    """State with one row per block, and an empty last row, in a grid in which block k is block ``to[k]``."""
    found = np.zeros((rows, *state.shape[1:]), state.dtype)  # memory of blocks that no scan touches is never used
    if state[-1].any():
        found[:] = state[-1]
    found[to] = state[:-1]
    return found
