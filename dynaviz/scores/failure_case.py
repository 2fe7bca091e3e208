"""A failure case of a result."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct, field

from dynaviz.contracts.scan import ErrorKind
from dynaviz.scores.looks import CaseLooks

ROUNDED = 0.02  # metres around the box of a case, whose corners are rounded


class RangeSpan(Struct, frozen=True):
    """Ranges of a case's points from the sensor, metres."""

    min: float
    mean: float
    max: float


class JoinedPoints(Struct, frozen=True, kw_only=True):
    """Points that belong together: a failure case, or a cluster of removed points.

    Attributes:
        points: how many; a point counts once per frame.
        first_frame, last_frame, worst_frame: positions in the run; frames: number of frames.
        low, high: corners, (3,) metres, world frame.
        range: from the sensor, metres; moved: metres, how far the points moved.
        reasons: points by reason, most frequent first.
        ground: share of the points on the ground, 0 to 1; None if unknown.
    """

    points: int
    first_frame: int
    last_frame: int
    worst_frame: int
    frames: int
    low: tuple[float, ...]
    high: tuple[float, ...]
    range: RangeSpan
    moved: float
    reasons: Mapping[str, int]
    ground: float | None = None


class FailureCase(JoinedPoints, frozen=True, kw_only=True):
    """Wrong points that belong together.

    Attributes:
        kind: ``false_negative`` or ``false_positive``.
        cost: percentage points of DA or SA.
        cause: why it is wrong, measured (``dynaviz_eval.causes``); in earlier results declared by
            the method, or None.
        word: the method's own word for the rule that decided most points, or None.
        class_, instance: of the ground truth, or None.
        what: what it is, in words; sentence: a description for the reader.
        behaviour: what the object or place did (``dynaviz.scores.behaviour``), in the data alone;
            None if unknown.
        reason: the reason that decided it, of which ``sentence`` gives the meaning; None in earlier
            results.
        grazed: share of its surface that its rays meet at a small angle in its worst frame, 0 to 1;
            None for kept points, and if too few lie on a surface.
        looks: what other scans saw at its points; None in earlier results.
        near_cause: another cause whose threshold is so near that a part of the points on which
            ``looks`` are taken gives it; None if there is none.
        spans: first and last frames by state, as in ``dynaviz.scores.spans``; empty in earlier
            results.
    """

    kind: ErrorKind
    cost: float
    cause: str | None = None
    class_: int | None = field(name="class", default=None)
    instance: int | None = None
    what: str = ""
    sentence: str = ""
    behaviour: str | None = None
    reason: str | None = None
    grazed: float | None = None
    looks: CaseLooks | None = None
    word: str | None = None
    spans: Mapping[str, tuple[tuple[int, int], ...]] = {}
    near_cause: str | None = None

    @property
    def metric(self) -> str:
        """The score that it costs: DA for points wrongly kept, SA for points wrongly removed."""
        return "DA" if self.kind == "false_negative" else "SA"
