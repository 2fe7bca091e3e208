"""Answers of two runs to the same random points, and their comparison."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from dynaviz.scores.comparison.counts import SpatialCells, count_agreement, spatial_gains
from dynaviz.scores.comparison.frame_answers import FrameAnswers
from dynaviz.scores.comparison.pair import PairComparison, compare_pair
from dynaviz.scores.result import Result
from dynaviz.scores.sections import SequenceInfo

REASONS = {0: "zero", 1: "one", 2: "two"}
TwoRuns = tuple[list[FrameAnswers], list[FrameAnswers], list[np.ndarray]]


def two_runs(
    seed: int, frames: int, points: int, truths: tuple[int, ...] = (0, 0, 1, 255)
) -> TwoRuns:
    """Answers of both runs by frame, and the coordinates of the points."""
    random = np.random.default_rng(seed)
    first, second, xyz = [], [], []
    for frame in range(frames):
        n = int(random.integers(0, points + 1))
        truth, bands = (
            random.choice(truths, n).astype(np.uint8),
            random.integers(0, 5, n).astype(np.uint8),
        )
        for run in (first, second):
            dynamic, reasons = (
                random.random(n) < random.random(),
                random.integers(0, 3, n).astype(np.uint8),
            )
            run.append(FrameAnswers(frame, frame + 100, dynamic, truth, reasons, bands))
        xyz.append((random.normal(size=(n, 3)) * 12).astype(np.float32))
    return first, second, xyz


any_two_runs = st.builds(
    two_runs,
    st.integers(0, 2**32),
    st.integers(1, 9),
    st.integers(0, 30),
    st.sampled_from([(0, 0, 1, 255), (0,), (255,), (1,)]),
)


def cells_of(run: list[FrameAnswers], xyz: list[np.ndarray], size: float = 5.0) -> SpatialCells:
    """Wrong points of a run by place."""
    cells = SpatialCells(size)
    for answers, points in zip(run, xyz, strict=True):
        cells.add(answers.frame, points, answers.outcome, np.ones(len(points), np.int64))
    return cells


def compared(
    first: list[FrameAnswers], second: list[FrameAnswers], xyz: list[np.ndarray]
) -> PairComparison:
    """The comparison of both."""
    counts = count_agreement(first, second)
    places = spatial_gains(cells_of(first, xyz), cells_of(second, xyz), counts.points.sum(1))
    result = Result("guess", {}, SequenceInfo("random"))
    return compare_pair(("A", "B"), (result, result), counts, (REASONS, REASONS), places, "")
