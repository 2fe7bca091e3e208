"""The cause of a failure case, and the sentence that describes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F32
from dynaviz.contracts.method import Cause, Reason
from dynaviz.scores.behaviour import Behaviour

SPARSE = 2.0  # points per cell and frame; with fewer, the rings are too far apart
STATIONARY = 1.0  # metres: a case that moves less did not move, in sentences
SLOW = 0.1  # metres per frame: slower than anyone walks in front of most sensors
LONG = 10  # frames: what is slow in at least this many frames stands for long
# share of the points of a case that must lie on a surface, to tell at which angle rays meet it
MEASURED = 0.15
GRAZED = 0.5  # of its measured surface: with more at small angles, these are the cause
FLAT = 0.6  # metres: a case lower than this and wider than WIDE is a level surface
WIDE = 1.5  # metres

_VISIBILITY = (
    Cause.GRAZING_RAYS,
    Cause.PARTLY_EMPTY,
    Cause.SPARSE_RINGS,
    Cause.NOTHING_BEHIND,
    Cause.STANDING,
    Cause.OCCUPIED,
)


def causes_of(
    kind: str, total: NDArray[np.void], reasons: Sequence[Reason]
) -> list[tuple[Cause | None, int]]:
    """The cause of each case, and the code of the reason that decided it.

    The most frequent cause among the method's reasons, refined by angles and motion: a method knows
    only whether rays passed, and these show which of the paper's failures it is. The reason is the
    most frequent one with that cause.

    Args:
        kind: ``false_negative`` or ``false_positive``.
        total: (C,) cases, as returned by ``cases.summed``.
        reasons: the method's reasons, by code.
    """
    known = [None, *Cause]
    of_code = np.array([*(known.index(reason.cause) for reason in reasons), 0])
    by_cause = np.stack([total["reasons"][:, of_code == i].sum(1) for i in range(len(known))], 1)
    refine = _refine_removed if kind == "false_positive" else _refine_kept
    found = []
    for case, most in zip(total, by_cause.argmax(1).tolist(), strict=True):
        cause = known[most]
        code = int(np.where(of_code == most, case["reasons"], -1).argmax())
        found.append((refine(case, cause) if cause in _VISIBILITY else cause, code))
    return found


def _refine_removed(case: np.void, cause: Cause) -> Cause:
    """Why rays seem to have passed through static points."""
    if 2 * case["touching"] > case["points"]:
        return Cause.SHARED_CELL
    if (grazed_share(case) or 0.0) > GRAZED:
        return Cause.GRAZING_RAYS
    if _is_sparse(case) or (
        is_ground(case) and 2 * case["surface"] < case["points"]
    ):  # a single ring has no surface
        return Cause.SPARSE_RINGS
    return Cause.PARTLY_EMPTY if cause is Cause.GRAZING_RAYS else cause


def _refine_kept(case: np.void, cause: Cause) -> Cause:
    """Why rays did not show that the place of dynamic points is free.

    Hits outweigh them, or too few passed.
    """
    if cause in (Cause.STANDING, Cause.OCCUPIED):
        long = case["frames"] >= LONG and case["moved"] < SLOW * case["frames"]
        return Cause.STANDING if long else Cause.OCCUPIED
    return (
        Cause.SPARSE_RINGS
        if cause is Cause.SPARSE_RINGS or _is_sparse(case)
        else Cause.NOTHING_BEHIND
    )


def grazed_share(case: np.void) -> float | None:
    """The share of the surface of a case that its rays meet at a small angle.

    None if too little is measured.
    """
    surface = int(case["surface"])
    return (
        int(case["grazed"]) / surface if surface and surface >= MEASURED * case["points"] else None
    )


def _is_sparse(case: np.void) -> bool:
    return bool(case["points"] < SPARSE * case["cells"])


def _is_level(size: F32) -> bool:
    return bool(size[2] < FLAT and max(size[:2]) > WIDE)


def is_ground(case: np.void) -> bool:
    """Whether most points of a case are on the ground."""
    return bool(2 * case["ground"] > case["points"])


def shape(kind: str, case: np.void) -> str:
    """Name a case, a row of ``cases.summed``, by its height above ground and its size, without
    class names.
    """
    size = case["high"] - case["low"]
    if kind == "false_negative":
        return "moving object"
    if is_ground(case):
        return "ground"
    if _is_level(size):
        return "level surface"
    if max(size[:2]) < WIDE:
        return "pole or trunk" if size[2] > max(size[:2]) else "small object"
    return "wall or other surface"


def when_and_where(case: Mapping[str, Any]) -> str:
    """Frames, ranges and behaviour of a case, such as ``41 frames, 8 to 30 m away, stood still
    until the end``.
    """
    near = case["range"]["min"]
    far = case["range"]["max"]
    metres = f"{near:.0f} to {far:.0f} m" if round(near) != round(far) else f"{near:.0f} m"
    frames = f"{case['frames']} frame{'s' * (case['frames'] > 1)}"
    behaviour = case.get("behaviour")
    if behaviour == Behaviour.FAR_AWAY:
        return f"{frames}, far away ({metres})"
    return ", ".join([frames, f"{metres} away", *([behaviour] if behaviour else [])])


def extent(case: Mapping[str, Any]) -> str:
    """The size of a case, such as ``2.0 x 1.0 x 0.5 m``."""
    return (
        " x ".join(f"{high - low:.1f}" for low, high in zip(case["low"], case["high"], strict=True))
        + " m"
    )


def sentence(case: Mapping[str, Any], meaning: str, patches: bool = False) -> str:
    """Describe a failure case in two short sentences.

    What the object did, and why the method decided as it did.

    Args:
        case: its plain values.
        meaning: of the reason that decided it, in the method's words (``Reason.meaning``).
        patches: whether it consists of several patches of ground.
    """
    name = " ".join(str(part) for part in (case["what"], case.get("instance")) if part is not None)
    if case["kind"] == "false_negative":
        moved = (
            f"moved {case['moved']:.0f} m" if case["moved"] >= STATIONARY else "moved less than 1 m"
        )
        fact = f"Kept: {name}, {when_and_where(case)}" + (
            "." if case.get("behaviour") else f", {moved}."
        )
    else:
        name += " in patches within" if patches else ","
        fact = f"Removed: {name} {extent(case)}, {when_and_where(case)}."
    why = meaning.partition(": ")[2] or meaning
    return f"{fact} {why[:1].upper()}{why[1:]}."
