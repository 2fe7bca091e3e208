"""What a failure case looks like, and the sentence that describes it."""

from __future__ import annotations

import numpy as np

from dynaviz.arrays import F32
from dynaviz.scores.behaviour import Behaviour
from dynaviz.scores.failure_case import FailureCase, JoinedPoints

STATIONARY = 1.0  # metres: a case that moves less did not move, in sentences
# share of the points of a case that must lie on a surface, to tell at which angle rays meet it
MEASURED = 0.15
FLAT = 0.6  # metres: a case lower than this and wider than WIDE is a level surface
WIDE = 1.5  # metres
PERSON = 1.2  # metres: the longest side of a person seen from above, with a stride
TALL = 2.3  # metres: the largest height of a person
UPRIGHT = 0.9  # metres: the least height of what looks like a person
VEHICLES = (("car", 6.0, 2.5), ("truck", 15.0, 4.5))  # longest side and largest height, metres


def grazed_share(case: np.void) -> float | None:
    """The share of the surface of a case that its rays meet at a small angle.

    None if too little is measured.
    """
    surface = int(case["surface"])
    return (
        int(case["grazed"]) / surface if surface and surface >= MEASURED * case["points"] else None
    )


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


def sized(case: np.void, size: F32) -> str:
    """Name a cluster of removed points, a row of ``cases.summed``, where nothing is known of it.

    Args:
        case: the cluster.
        size: (3,) metres: of its box in one frame, the median.
    """
    if is_ground(case):
        return "ground"
    if _is_level(size):
        return "level surface"
    length = float(max(size[:2]))
    height = float(size[2])
    if length <= PERSON and height <= TALL:
        return "person-sized object" if height >= UPRIGHT else "small object"
    if length < WIDE:
        return "pole or trunk"
    for name, longest, highest in VEHICLES:
        if length <= longest and height <= highest:
            return f"{name}-sized object"
    return "wall or other surface"


def when_and_where(case: JoinedPoints, behaviour: str | None = None) -> str:
    """Frames, ranges and behaviour of a case, such as ``41 frames, 8 to 30 m away, stood still
    until the end``.
    """
    near = case.range.min
    far = case.range.max
    metres = f"{near:.0f} to {far:.0f} m" if round(near) != round(far) else f"{near:.0f} m"
    frames = f"{case.frames} frame{'s' * (case.frames > 1)}"
    if behaviour == Behaviour.FAR_AWAY:
        return f"{frames}, far away ({metres})"
    return ", ".join([frames, f"{metres} away", *([behaviour] if behaviour else [])])


def extent(case: JoinedPoints) -> str:
    """The size of a case, such as ``2.0 x 1.0 x 0.5 m``."""
    sizes = (high - low for low, high in zip(case.low, case.high, strict=True))
    return " x ".join(f"{size:.1f}" for size in sizes) + " m"


def sentence(case: FailureCase, meaning: str, patches: bool = False) -> str:
    """Describe a failure case in two short sentences.

    What the object did, and why the method decided as it did.

    Args:
        case: without its sentence.
        meaning: of the reason that decided it, in the method's words (``Reason.meaning``).
        patches: whether it consists of several patches of ground.
    """
    name = " ".join(str(part) for part in (case.what, case.instance) if part is not None)
    if case.kind == "false_negative":
        moved = f"moved {case.moved:.0f} m" if case.moved >= STATIONARY else "moved less than 1 m"
        unknown = case.behaviour is None and case.frames > 1
        fact = f"Kept: {name}, {when_and_where(case, moved if unknown else case.behaviour)}."
    else:
        name += " in patches within" if patches else ","
        fact = f"Removed: {name} {extent(case)}, {when_and_where(case, case.behaviour)}."
    why = meaning.partition(": ")[2] or meaning
    return f"{fact}{measured(case)} {why[:1].upper()}{why[1:]}."


def measured(case: FailureCase) -> str:
    """What rays showed of a case, such as `` Stood there: hit by 24 scans, seen through by 2.``.

    Empty without looks.
    """
    looks = case.looks
    if looks is None or case.cause is None:
        return ""
    cause = case.cause
    if case.near_cause is not None:
        cause += f" (near the threshold of: {case.near_cause})"
    hits = f"hit by {looks.hits:g} other scan{'s' * (looks.hits != 1)}"
    near = ""
    if case.kind == "false_positive" and looks.mover is not None:
        near = f", the nearest mover is {looks.mover:.1f} m away"
    return f" {cause[:1].upper()}{cause[1:]}: {hits}, seen through by {looks.throughs:g}{near}."
