"""The map of HMM-MOS: beliefs of the voxels near points, updated by a hidden Markov model scan by
scan.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, U64
from dynaviz.blocks.blocks import VOXELS, BlockGrid, voxels_of
from dynaviz.contracts.extent import Extent
from dynaviz_methods.shared.lanes import lane_marks, merged

KERNELS = kernels.load("dynaviz_methods.hmm_mos.kernels")
SHARED = kernels.load("dynaviz_methods.shared.kernels")

CHANGE = 0.005  # probability that a voxel changes its state between two scans, as published
CAP = 75  # square voxels: from here on, the likelihood of free is 1 in double precision


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """The occupied voxels of a scan, and what the changes around them say.

    Attributes:
        voxels: (N,) int64, voxel numbers, sorted.
        raw: (N,) int32, the score of each voxel.
        median: (N,) int32, the median score of the occupied voxels among the 27 around it.
        known: (N,) int32, number of voxels of its neighbourhood with a known state.
    """

    voxels: I64
    raw: I32
    median: I32
    known: I32


class BeliefMap(BlockGrid):
    """Beliefs of the voxels that can decide a label: those near points.

    Call per scan: ``place``, ``see``, ``learn``, ``score``, ``done``.

    Args:
        extent: where points will lie.
        resolution: edge of a voxel, metres; also the standard deviation of the likelihood.
        half: half width of the neighbourhood that decides a score, voxels.
        max_range: greatest range that is observed, metres.
        forget_after: age in scans from which a voxel counts as unknown.
        truncate: round the indices of points towards zero, and never forget the voxels seen first,
            as the public program does.

    Attributes:
        hit: (B, 8) uint64, bits of the voxels with points of this scan.
        turned: (B, 8) uint64, bits of the voxels that turn from free to occupied in this scan.
        state: (B, 512) uint8: 0 unknown, 1 occupied, 2 free.
        since: (B, 512) int32: number of the scan in which the state last changed, from 1.
        observed: blocks and bits of the voxels that this scan observed.
        field: (K, 512) uint8, squared voxels: for these blocks, distances to the nearest occupied
            voxel; if kept.
    """

    def __init__(
        self,
        extent: Extent,
        resolution: float,
        half: int,
        max_range: float,
        forget_after: int,
        truncate: bool,
    ) -> None:
        super().__init__(extent.widened((max(half, 1) + 1) * resolution), resolution)
        self._max_range = max_range
        self._forget_after = forget_after
        self._truncate = truncate
        # bits set in the numbers of a row
        self._sizes = np.bitwise_count(np.arange(1 << (2 * half + 1)))
        n = len(self)
        own = self.per_block
        self.hit, self.turned, self._sources, self._known = (
            own(np.zeros((n, 8), np.uint64)) for _ in range(4)
        )
        self.belief = own(np.zeros((n, VOXELS)))
        self.state = own(np.zeros((n, VOXELS), np.uint8))
        self.since, self._seen, self._scores = (
            own(np.zeros((n, VOXELS), np.int32)) for _ in range(3)
        )
        # blocks with observed voxels
        self._used = np.empty(0, np.int32)
        self._is_used = own(np.zeros(n, np.bool_))
        # by block; see ``KERNELS.beliefs.expire``
        self._first = own(np.full(n, never := KERNELS.beliefs.NEVER), never)
        self._marks = lane_marks(n)
        self._neighbours = self.neighbours()
        self._likelihoods = np.exp(-np.arange(CAP + 1) / 2)
        self._before = np.empty(0, np.int64)  # occupied voxels of the last scan
        self.number = 0  # of the scan, from 1
        self.field = np.empty((0, VOXELS), np.uint8)

    def place(self, points: F32) -> I64:
        """(N,) int64: the voxel of each point (N, 3), metres, world frame; -1 if it has none."""
        points = kernels.as_readonly(points, np.float32)
        size = float(self.resolution)
        found: I64 = KERNELS.integer_lines.locate(points, size, self._truncate, *self._place)
        return found

    def see(self, voxels: I64, origin: F64) -> None:
        """Cast rays to the occupied voxels.

        Args:
            voxels: (N,) int64, voxels with points, with duplicates; none is -1.
            origin: (3,) float64, metres, world frame.
        """
        self.number += 1
        self._origin = origin
        self._used = self.remaining(self._used)
        self._before = self.remaining_voxels(self._before)
        blocks = np.sort(_set(self.hit, voxels))
        self._occupied = voxels_of(blocks, self.hit[blocks].view(np.int64))
        self.hit[blocks] = 0
        start = np.floor(origin / self.resolution).astype(np.int64)
        farthest = math.floor((self._max_range / self.resolution) ** 2 * (1 + 1e-12))
        to = self._occupied, self._blocks, start, farthest
        KERNELS.integer_lines.cast(*to, *self._place, *self._marks)
        self.observed = merged(*self._marks)

    def learn(self, sure: float, keep_field: bool = False) -> None:
        """Update the beliefs of the observed voxels, and forget those far away.

        Args:
            sure: belief above which a state is decided.
            keep_field: keep the distances of this scan in ``field``.
        """
        sources = np.concatenate([self._occupied, self._before])
        _set(self._sources, sources)
        blocks, bits = self.observed
        self.field = np.empty((len(blocks) if keep_field else 0, VOXELS), np.uint8)
        KERNELS.beliefs.update(
            *(
                blocks,
                bits,
                self._sources,
                self._neighbours,
                self.number,
                self._forget_after,
                self._truncate,
            ),
            *(
                self._likelihoods,
                CHANGE,
                sure,
                self.belief,
                self._seen,
                self.since,
                self.state,
                self._known,
            ),
            *(self.turned, self.field, kernels.threads_in_use()),
        )
        self._sources[sources // VOXELS] = 0
        self._before = self._occupied
        self._first[blocks] = np.minimum(self._first[blocks], self.number)
        self._used = np.append(self._used, blocks[~self._is_used[blocks]])
        self._is_used[blocks] = True
        self._forget()

    def _forget(self) -> None:
        """Forget voxels that are far away, and those last observed long ago."""
        place = float(self.resolution), self._origin, 1.5 * self._max_range
        kept = KERNELS.beliefs.erase(
            self._used, self._blocks, *place, self._seen, self.state, self._known
        )
        self._is_used[self._used[~kept]] = False
        self._used = self._used[kept]
        if self.number > self._forget_after:
            oldest = self.number - self._forget_after
            KERNELS.beliefs.expire(self._used, oldest, self._seen, self._known, self._first)

    def score(self) -> Scores:
        """Score the occupied voxels within range."""
        corners = self.keys(self._occupied) * self.resolution - self._origin
        near = np.einsum("ij,ij->i", corners, corners) <= self._max_range**2
        voxels = self._occupied[near]
        _set(self.hit, voxels)
        k = KERNELS.change_scores
        lanes = kernels.threads_in_use()
        raw = np.zeros(len(voxels), np.int32)
        known = np.zeros(len(voxels), np.int32)
        firsts = np.flatnonzero(np.diff(voxels // VOXELS, prepend=-1, append=-1))
        bits = self._known, self.turned, self.hit
        k.scores(voxels, firsts, self._sizes, self._neighbours, *bits, raw, known, lanes)
        self._scores[voxels // VOXELS, voxels % VOXELS] = raw
        return Scores(
            voxels, raw, k.medians(voxels, self._neighbours, self.hit, self._scores, lanes), known
        )

    def beside(self, voxels: I64) -> I64:
        """Occupied voxels among the 26 around each of some voxels, and these voxels; sorted."""
        return np.unique(KERNELS.change_scores.beside(voxels, self._neighbours, self.hit))

    def turned_voxels(self) -> I64:
        """Voxels with points that turned from free to occupied in this scan."""
        blocks = self.observed[0]
        return voxels_of(blocks, (self.turned[blocks] & self.hit[blocks]).view(np.int64))

    def slice(self, distance: float) -> tuple[I32, F32, F32]:
        """Observed voxels at the sensor's height within a distance, metres.

        Keys, likelihood and belief of occupied.
        """
        blocks, bits = self.observed
        voxels = voxels_of(blocks, bits.view(np.int64))
        keys = self.keys(voxels)
        offset = (keys + 0.5) * self.resolution - self._origin
        here = (np.abs(offset[:, 2]) <= self.resolution / 2) & (
            np.hypot(offset[:, 0], offset[:, 1]) < distance
        )
        voxels = voxels[here]
        at = voxels % VOXELS
        rows = np.searchsorted(blocks, voxels // VOXELS)
        likelihood = self._likelihoods[self.field[rows, at]]
        return (
            keys[here],
            likelihood.astype(np.float32),
            self.belief[voxels // VOXELS, at].astype(np.float32),
        )

    def done(self) -> None:
        """Clear the marks of this scan."""
        self.hit[self._occupied // VOXELS] = 0
        self.turned[self.observed[0]] = 0


def _set(bits: U64, voxels: I64) -> I32:
    """Set the bits of voxels (N,); returns the blocks that had none."""
    blocks: I32 = SHARED.ever_free.put(voxels, bits)
    return blocks
