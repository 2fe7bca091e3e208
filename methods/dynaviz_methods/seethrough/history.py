"""The places that scans visited, and what they inherit from dynamic objects where their life begins or ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import F32, I32, I64, U16, Bool
from dynaviz.blocks.blocks import BlockGrid

ALWAYS = 1 << 30  # visits: the life of a place whose beginning and end nobody saw
WIDE = 3  # blocks: edge of a part of an object, 2.4 m; a part and the eight around it are judged together
CERTAIN = 0.35  # evidence for full certainty
LEAST = 0.1  # weight of a place without evidence, against 1 more for one that is certain
LIVE_NEAR, LIVE_PRIOR, LIVE_LEAST = 0.3, 0.02, 0.5  # online, where there is less evidence, and little of it is certain


@dataclass(frozen=True, eq=False)
class Visits:
    """The places that one scan visited.

    Attributes:
        number: position of the scan.
        places: (V,) int32; parts: (V,) int32, the part of each; around: (P, 9) int32: parts next to each part.
    """

    number: int
    places: I32
    parts: I32
    around: I32


@dataclass(frozen=True, eq=False)
class Decision:
    """What decides the labels of points, by place; all (4 B,), the last block being that of points without one.

    Attributes:
        own: float32: evidence of places; born, left: float32: what they inherit at their beginning and at their end.
        came, went: int32: position of the first scan from which they inherit this, in each direction; -1 for none.
        inherit: weight of what places inherit; prior: what the sum must exceed.
    """

    own: F32
    born: F32
    left: F32
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
        weights: of a crossing near a hit, of a hit; clear crossings for full evidence, as many as visits of a birth.
        counts: three arrays (B, 512) uint16: scans that hit, crossed, and grazed each voxel.
    """

    def __init__(
        self, grid: BlockGrid, inherit: float, prior: float, weights: tuple[float, ...], counts: tuple[U16, ...]
    ) -> None:
        rows, own = len(grid) + 1, grid.per_block
        self._weights, self._live_weights = weights, (min(weights[0], LIVE_NEAR), *weights[1:])
        self._counts = counts
        self._whole, self._live = (inherit, prior, CERTAIN, LEAST), (inherit, LIVE_PRIOR, CERTAIN, LIVE_LEAST)
        self._birth = int(weights[2])  # visits: the length of births and deaths
        self._visits: dict[int, Visits] = {}
        self._stamps, self._came = (own(np.full((rows, 4), -1, np.int32), -1) for _ in range(2))
        self._up = own(np.zeros((rows, 8), np.uint64))
        self._own, self._born = (own(np.zeros((rows, 4), np.float32)) for _ in range(2))
        # Of each place: its visits, from how many it inherits, and how often its voxels were clear at the last one.
        self._number, self._most, self._clear = (own(np.zeros((rows, 4), np.int32)) for _ in range(3))
        self._joined = own(np.zeros((rows, 4), np.bool_))  # it came later than other places of its object
        self._never, self._unknown = np.full((rows, 4), np.int32(-1)), np.zeros((rows, 4), np.float32)
        self._since = np.zeros(rows, np.int64)  # by block: the scan with which it came
        self._grid, self._now = grid, -1
        grid.watch(self._block_came)

    def _block_came(self, numbers: I32) -> None:
        self._since[numbers] = self._now + 1

    def add(self, number: int, voxels: I64, objects: I32) -> None:
        """Add the visits of a scan that was counted, and let its places inherit from what is known so far.

        Args:
            number: position of the scan.
            voxels: (N,) int64, objects: (N,) int32: of each point, -1 for none.
        """
        k, self._now = kernels.places, number
        visits = Visits(number, *k.visit(voxels, objects, self._grid.blocks, WIDE, number, self._up, self._stamps))
        self._visits[number], places = visits, visits.places
        self._weigh(places, self._live_weights, self._own, self._clear)
        visited, most, clear = self._number.ravel(), self._most.ravel(), self._clear.ravel()
        fresh = visited[places] == 0
        new = places[fresh]
        most[new] = np.where(clear[new] > 0, self._birth, ALWAYS)
        self._joined.ravel()[new] = _joined(visits, visited)[fresh]
        scan, state = (places, visits.parts, visits.around, visited[places]), (self._own, self._born, self._unknown)
        k.inherit(*scan, most, *(of.ravel() for of in state), self._live, self._came.ravel(), number, False)
        visited[places] += 1

    def _weigh(self, places: I32, weights: tuple[float, ...], found: F32, clear: I32) -> None:
        evidence = self._up, *self._counts, weights
        kernels.places.evidence(places, *evidence, found.reshape(-1), clear.reshape(-1))

    def so_far(self) -> Decision:
        """What decides the labels of the last scan, by the scans so far."""
        of_places = self._own.ravel(), self._born.ravel(), self._unknown.ravel()
        return Decision(*of_places, self._came.ravel(), self._never.ravel(), *self._live[:2])

    def decide(self) -> Decision:
        """What decides the labels of all scans that were not forgotten."""
        k, size = kernels.places, self._own.size
        visits = [self._remaining(each) for each in self._visits.values()]
        starts, part_starts = (
            np.cumsum([0, *map(len, of)]) for of in ([v.places for v in visits], [v.around for v in visits])
        )
        places, parts, around = (
            np.concatenate([empty, *(getattr(v, name) for v in visits)])
            for name, empty in (
                ("places", np.empty(0, np.int32)),
                ("parts", np.empty(0, np.int32)),
                ("around", np.empty((0, 9), np.int32)),
            )
        )
        existing = np.unique(places)
        own, clear = np.zeros(size, np.float32), np.zeros(size, np.int32)
        self._weigh(existing, self._weights, own, clear)
        begun, ended = self._most.ravel() == self._birth, clear > self._clear.ravel()
        births, deaths = (
            np.where(seen, self._birth, np.where(no, 0, ALWAYS)).astype(np.int32)
            for seen, no in ((begun, ended & ~self._joined.ravel()), (ended, begun))
        )
        forward, backward = k.ranks(places, np.zeros(size, np.int32))
        born, left = np.zeros(size, np.float32), np.zeros(size, np.float32)
        came, went = np.full(size, -1, np.int32), np.full(size, -1, np.int32)
        of = starts, part_starts, places, parts, around
        k.sweep(*of, forward, births, own, born, left, self._whole, came, False)
        k.sweep(*of, backward, deaths, own, left, born, self._whole, went, True)
        return Decision(own, born, left, came, went, *self._whole[:2])

    def _remaining(self, visits: Visits) -> Visits:
        """Visits of places whose blocks did not go since."""
        here = self._since[visits.places >> 2] <= visits.number
        if here.all():
            return visits
        return Visits(visits.number, visits.places[here], visits.parts[here], visits.around)

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
            self._visits[number] = Visits(number, places, each.parts, each.around)
        self._grid, self._counts = grid, counts


def _joined(visits: Visits, visited: I32) -> Bool:
    """(V,) bool: in or next to whose parts there are places with visits before, of which ``visited`` (4 B,) counts."""
    older = np.zeros(len(visits.around) + 1, np.bool_)
    older[visits.parts[visited[visits.places] > 0]] = True
    joined: Bool = np.any(older[visits.around], 1)[visits.parts]
    return joined


def moved(state: NDArray[Any], to: I64, rows: int) -> NDArray[Any]:
    """State with one row per block, and an empty last row, in a grid in which block k is block ``to[k]``."""
    found = np.zeros((rows, *state.shape[1:]), state.dtype)  # memory of blocks that no scan touches is never used
    if state[-1].any():
        found[:] = state[-1]
    found[to] = state[:-1]
    return found
