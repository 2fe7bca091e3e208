"""The cause of a failure case, and the sentence that describes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F32
from dynaviz.method import Cause, Reason

SPARSE = 2.0  # points per cell and frame; with fewer, the rings are too far apart
STATIONARY = 1.0  # metres: a case that moves less ...
LONG = 10  # frames: ... in at least this many frames is stationary
FLAT = 0.6  # metres: a case lower than this and wider than WIDE is a level surface
WIDE = 1.5  # metres

_VISIBILITY = (Cause.GRAZING_RAYS, Cause.SPARSE_RINGS, Cause.NOTHING_BEHIND, Cause.STANDING)
_EXPLANATIONS: dict[str, dict[str, str]] = {  # by kind and cause
    "false_negative": {
        Cause.STANDING: "It stayed too long: observed more often as occupied than as free.",
        Cause.NOTHING_BEHIND: "Too few rays returned from behind it to show that its place became free.",
        Cause.SPARSE_RINGS: "The sensor's rings are too sparse there to show that its place became free.",
        Cause.NOT_YET_FREE: "Its place had not been observed as free for long enough before it arrived.",
        Cause.HEIGHT_LIMIT: "It is outside the height limits of the method.",
        Cause.OUT_OF_RANGE: "It is outside the range or field of view of the method.",
        Cause.TAKEN_FOR_GROUND: "The method classified it as ground.",
        Cause.SHARED_CELL: "It was classified together with static points around it.",
    },
    "false_positive": {
        Cause.GRAZING_RAYS: "Rays at grazing angles made it appear free.",
        Cause.SPARSE_RINGS: "Few rays hit it, and others passed between these.",
        Cause.SHARED_CELL: "It was classified together with something else in one voxel, bin or cluster.",
        Cause.HEIGHT_LIMIT: "Its height differs between scans.",
        Cause.STANDING: "It came into view late, or only intermittently.",
    },
}


def causes_of(kind: str, total: NDArray[np.void], reasons: Sequence[Reason]) -> list[Cause | None]:
    """The cause of each case: the most frequent cause among the method's reasons, refined by shape and motion.

    A method knows only whether rays passed. The shape and the motion of the case show which of the paper's failures
    it is.

    Args:
        kind: ``false_negative`` or ``false_positive``.
        total: (C,) cases, as returned by ``cases.summed``.
        reasons: the method's reasons, by code.
    """
    known = [None, *Cause]
    of_code = np.array([*(known.index(reason.cause) for reason in reasons), 0])
    by_cause = np.stack([total["reasons"][:, of_code == i].sum(1) for i in range(len(known))], 1)
    refine = _refine_removed if kind == "false_positive" else _refine_kept
    return [
        refine(case, cause) if cause in _VISIBILITY else cause
        for case, cause in zip(total, (known[i] for i in by_cause.argmax(1)), strict=True)
    ]


def _refine_removed(case: np.void, cause: Cause) -> Cause:
    """Why rays seem to have passed through static points."""
    if 2 * case["near_dynamic"] > case["points"]:
        return Cause.SHARED_CELL
    if _is_level(case["high"] - case["low"]):
        return Cause.GRAZING_RAYS
    return Cause.SPARSE_RINGS if _is_sparse(case) else cause


def _refine_kept(case: np.void, cause: Cause) -> Cause:
    """Why no ray, or too few, passed through the place of dynamic points."""
    if case["frames"] >= LONG and case["moved"] < STATIONARY:
        return Cause.STANDING
    return Cause.SPARSE_RINGS if cause is Cause.SPARSE_RINGS or _is_sparse(case) else Cause.NOTHING_BEHIND


def _is_sparse(case: np.void) -> bool:
    return bool(case["points"] < SPARSE * case["cells"])


def _is_level(size: F32) -> bool:
    return bool(size[2] < FLAT and max(size[:2]) > WIDE)


def shape(kind: str, size: F32) -> str:
    """Name a case by its size, (3,) metres, for data without class names."""
    if kind == "false_negative":
        return "moving object"
    if _is_level(size):
        return "level surface"
    if max(size[:2]) < WIDE:
        return "pole or trunk" if size[2] > max(size[:2]) else "small object"
    return "wall or other surface"


def sentence(case: Mapping[str, Any]) -> str:
    """Describe a failure case in two short sentences."""
    cause, near, far = case["cause"], case["range"]["min"], case["range"]["max"]
    away = f"{near:.0f} to {far:.0f} m away" if round(near) != round(far) else f"{near:.0f} m away"
    when = f"{case['frames']} frame{'s' * (case['frames'] > 1)}, {away}"
    if case["kind"] == "false_negative":
        moved = f"moved {case['moved']:.0f} m" if case["moved"] >= STATIONARY else "moved less than 1 m"
        fact = f"Kept: {case['what']}, {when}, {moved}."
    else:
        extent = " x ".join(f"{high - low:.1f}" for low, high in zip(case["low"], case["high"], strict=True))
        fact = f"Removed: {case['what']}, {extent} m, {when}."
    explanation = _EXPLANATIONS[case["kind"]].get(cause) or f"The method's reason: {next(iter(case['reasons']))}."
    return f"{fact} {explanation}"
