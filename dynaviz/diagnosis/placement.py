"""Check positions: clouds that move although the poses are equal, and clouds that were measured
elsewhere.
"""

from __future__ import annotations

import numpy as np

from dynaviz.arrays import F64
from dynaviz.diagnosis.alignment import CLEAR_GAIN, LESS_HIDDEN, Pairs, hides_less
from dynaviz.diagnosis.finding import Confidence
from dynaviz.sources.hypotheses.registration import register
from dynaviz.sources.hypotheses.views import ScanView, hidden
from dynaviz.spatial import geometry

FEW = 8_000  # points by which candidates are ranked


def moving_clouds(views: Pairs) -> tuple[str, Confidence] | None:
    """A sentence and confidence if clouds move although the poses are identical.

    None if they do not move.
    """
    gains = []
    shifts = []
    for a, b in views:
        T = register(a.surface, b.points)
        gains.append(a.surface.overlap(geometry.apply(T, b.points)) - a.surface.overlap(b.points))
        shifts.append(float(np.linalg.norm((T @ a.T - a.T)[:3, 3])))
    if (
        not views
        or (moved := float(np.median(shifts))) < 0.05
        or (gain := float(np.median(gains))) < 0.03
    ):
        return None
    problem = (
        f"the clouds move by {moved:.2f} m between scans; aligning them adds {gain:.0%} to their "
        "overlap"
    )
    return problem, Confidence.CERTAIN if gain > CLEAR_GAIN else Confidence.LIKELY


def measured_elsewhere(views: Pairs, times: float) -> str | None:
    """A sentence if clouds hide many points from the given position but far fewer from another one.

    None otherwise.

    The view from another height differs in any case, so a raised position needs stronger evidence.
    """
    given = np.array([hidden(b.sample, b.path(_as_given)) for _, b in views])
    for raised, factor, share in ((False, times, LESS_HIDDEN[1]), (True, 3.0, 0.05)):
        if given.mean() < share:
            break
        best = []
        for _, b in views:
            candidates = _candidate_positions(b, raised)
            k = int(np.argmin([hidden(b.sample[:FEW], position[None]) for position in candidates]))
            shift = candidates[k] - b.T[:3, 3]
            best.append((hidden(b.sample, b.path(_as_given) + shift), float(np.linalg.norm(shift))))
        less, distances = np.array(best).T
        if hides_less(less, given, factor, share):
            return (
                f"the clouds appear to be measured up to {distances.max():.0f} m away from the "
                "given positions: "
                f"from there they hide {less.mean():.1%} of their points, from the given positions "
                f"{given.mean():.1%}"
            )
    return None


def _as_given(T: F64) -> F64:
    return T


def _candidate_positions(view: ScanView, raised: bool) -> F64:
    """(K, 3) metres: positions around the given one and the cloud's median; raised.

    1.5 m above the ground.
    """
    given = view.T[:3, 3].copy()
    middle = np.median(view.sample, axis=0)
    middle[2] = given[2]
    if raised:
        middle[2] = given[2] = np.percentile(view.sample[:, 2], 5) + 1.5
    azimuth = np.arange(8) * np.pi / 4
    ring = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(8)], 1)
    return np.concatenate(
        [[middle], *(c + r * ring for c in (given, middle) for r in (1.5, 3.0, 6.0, 12.0))]
    )
