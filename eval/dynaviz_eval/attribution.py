"""What is to blame for a failure case, and how to say it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F32
from dynaviz.method import Cause, Reason

SPARSE = 2.0  # points a cell and frame, below which rings lie too far apart
STOOD = 1.0  # metres: what moves less ...
LONG = 10  # frames: ... in at least so many frames stood still
FLAT = 0.6  # metres: what is lower, and wider than WIDE, is a level surface
WIDE = 1.5  # metres

_VISIBILITY = (Cause.GRAZING_RAYS, Cause.SPARSE_RINGS, Cause.NOTHING_BEHIND, Cause.STANDING)
_BLAME: dict[str, dict[str, str]] = {
    "false_negative": {
        Cause.STANDING: "It stood too long: seen there more often than seen through.",
        Cause.NOTHING_BEHIND: "Too few rays came back from behind it to clear where it had been.",
        Cause.SPARSE_RINGS: "The sensor's rings are too sparse there to see through it.",
        Cause.NOT_YET_FREE: "Its place had not been seen free for long before it came.",
        Cause.HEIGHT_LIMIT: "It lies outside the heights that the method judges.",
        Cause.OUT_OF_RANGE: "It lies outside the range or view that the method judges.",
        Cause.TAKEN_FOR_GROUND: "The method took it for ground.",
        Cause.SHARED_CELL: "It was judged together with things around it that stand.",
    },
    "false_positive": {
        Cause.GRAZING_RAYS: "Rays that passed it at a small angle made it look free.",
        Cause.SPARSE_RINGS: "It was hit by few rays, and others passed between.",
        Cause.SHARED_CELL: "It was judged together with something else, in one voxel, bin or cluster.",
        Cause.HEIGHT_LIMIT: "Its height differs between scans.",
        Cause.STANDING: "It came into view late, or only at times.",
    },
}


def causes_of(kind: str, total: NDArray[np.void], reasons: Sequence[Reason]) -> list[Cause | None]:
    """What is to blame for each case: what the method says of its points, corrected by what the case looks like.

    A method knows that rays passed, or did not; how the thing lies and moves tells which of the paper's failures it is.

    Args:
        kind: ``false_negative`` or ``false_positive``.
        total: (C,) cases, as from ``cases.summed``.
        reasons: the legend of the method's codes.
    """
    known = [None, *Cause]
    of_code = np.array([*(known.index(reason.cause) for reason in reasons), 0])
    by_cause = np.stack([total["reasons"][:, of_code == i].sum(1) for i in range(len(known))], 1)
    look = _looks_removed if kind == "false_positive" else _looks_kept
    return [
        look(case, said) if said in _VISIBILITY else said
        for case, said in zip(total, (known[i] for i in by_cause.argmax(1)), strict=True)
    ]


def _looks_removed(case: np.void, said: Cause) -> Cause:
    """Why rays seem to have passed through what stands."""
    if 2 * case["beside"] > case["points"]:
        return Cause.SHARED_CELL
    if _is_level(case["high"] - case["low"]):
        return Cause.GRAZING_RAYS
    return Cause.SPARSE_RINGS if _is_sparse(case) else said


def _looks_kept(case: np.void, said: Cause) -> Cause:
    """Why no ray, or too few, passed through where something moved."""
    if case["frames"] >= LONG and case["moved"] < STOOD:
        return Cause.STANDING
    return Cause.SPARSE_RINGS if said is Cause.SPARSE_RINGS or _is_sparse(case) else Cause.NOTHING_BEHIND


def _is_sparse(case: np.void) -> bool:
    return bool(case["points"] < SPARSE * case["cells"])


def _is_level(size: F32) -> bool:
    return bool(size[2] < FLAT and max(size[:2]) > WIDE)


def shape(kind: str, size: F32) -> str:
    """What a thing is by its size, (3,) metres, where the data do not say."""
    if kind == "false_negative":
        return "something that moves"
    if _is_level(size):
        return "level surface"
    if max(size[:2]) < WIDE:
        return "pole or trunk" if size[2] > max(size[:2]) else "small thing"
    return "wall or other surface"


def sentence(case: Mapping[str, Any]) -> str:
    """What happened, in two short sentences."""
    cause, near, far = case["cause"], case["range"]["min"], case["range"]["max"]
    away = f"{near:.0f} to {far:.0f} m away" if round(near) != round(far) else f"{near:.0f} m away"
    when = f"{case['frames']} frame{'s' * (case['frames'] > 1)}, {away}"
    if case["kind"] == "false_negative":
        did = f"moved {case['moved']:.0f} m" if case["moved"] >= STOOD else "hardly moved"
        begin = f"Kept: {case['what']}, {when}, {did}."
    else:
        extent = " x ".join(f"{high - low:.1f}" for low, high in zip(case["low"], case["high"], strict=True))
        begin = f"Removed: {case['what']}, {extent} m, {when}."
    blame = _BLAME[case["kind"]].get(cause) or f"The method says: {next(iter(case['reasons']))}."
    return f"{begin} {blame}"
