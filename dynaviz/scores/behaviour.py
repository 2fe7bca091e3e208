"""What an object or a place did during the drive, in the same words for all methods."""

from __future__ import annotations

from enum import StrEnum


class Behaviour(StrEnum):
    """Half of a diagnosis: what the data did.

    The other half, what the method did, is ``contracts.method.Cause``.

    It depends on the data alone, so two methods that fail on the same object get the same word for
    it. The thresholds are in ``dynaviz_eval.behaviour``.
    """

    # Of dynamic objects that were kept.
    PASSED_BY = "passed by"  # kept moving while it was seen
    STOOD = "stood still until the end"  # from some frame on until it was last seen
    CAME_TO_STOP = "came to a stop"  # the same, but it moved in most of the frames
    WAITED_FIRST = "waited first"  # stood still when it was first seen, and moved off later
    STOPPED = "stopped on its way"  # moved, stood still, and moved on
    # came into view near the end of the drive, and was still there when it ended
    ARRIVED_LATE = "arrived late"
    END_OF_DRIVE = "end of the drive"  # seen in the last frames of the drive only
    TOUCHED = "touched something"  # static points next to most of its points
    # Of static places that were removed.
    NEXT_TO_MOVER = (
        "next to a mover"  # dynamic points next to most of its points, in the same frame
    )
    SEEN_BRIEFLY = "seen briefly"  # a few frames hit the place
    SEEN_LATE = "seen late"  # first hit near the end of the drive
    ON_AND_OFF = (
        "seen on and off"  # hit in less than half of the frames between the first and the last hit
    )
    IN_VIEW = "always in view"  # hit in most of the frames between the first and the last hit
    # Of both.
    FAR_AWAY = "far away"  # seen only from afar, by few points
