"""What the looks of a drive say: about a failure case, about an object, and about SA and DA."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct, field


class CaseLooks(Struct, frozen=True):
    """What other scans saw at sampled points of a case.

    Attributes:
        points: number of sampled points.
        hit, through, hidden, between, outside: percent of all looks, as in
            ``dynaviz.contracts.looks.Look``; grazing rays count as ``through``.
        seen_through: percent of the points that at least one scan saw through.
        hits, throughs: scans that hit a point, and that saw through it; medians.
        grazing: percent of the passes of points on surfaces, at less than 20 degrees; None without.
        close: percent of the passes whose rays end within 1 m behind the point; None without.
        before, after: percent of the passes before the first hit of a point, and after its last;
            None without.
        surface: percent of the points on a surface, so that angles are known.
        mover: metres from a point to the nearest dynamic point of its scan, and mover_ever: of any
            scan; medians; None without.
    """

    points: int
    hit: float
    through: float
    hidden: float
    between: float
    outside: float
    seen_through: float
    hits: float
    throughs: float
    grazing: float | None = None
    close: float | None = None
    before: float | None = None
    after: float | None = None
    surface: float = 0.0
    mover: float | None = None
    mover_ever: float | None = None


class Estimate(Struct, frozen=True):
    """A percentage, and half of its 95 % interval in percentage points; 0 if all was measured."""

    percent: float
    error: float = 0.0

    def __str__(self) -> str:
        text = f"{self.percent:.1f}"
        return text if self.error < 0.05 else f"{text} ±{self.error:.1f}"


class ObjectCeiling(Struct, frozen=True):
    """Whether a drive showed that the places of a moving object are free.

    Attributes:
        class_, instance: of the ground truth, or None; what: its name.
        points: dynamic points; sampled: those whose places were looked at.
        seen_through: percent of these that another scan saw through.
        first_frame, last_frame: in which it was seen.
    """

    class_: int | None = field(name="class", default=None)
    instance: int | None = None
    what: str = ""
    points: int = 0
    sampled: int = 0
    seen_through: float = 0.0
    first_frame: int = 0
    last_frame: int = 0


class Ceiling(Struct, frozen=True):
    """What this drive showed, and what a method made of it.

    Percentages of all dynamic points, or of all static points. A place has evidence if another scan
    saw through it.

    Attributes:
        possible: DA that the evidence allows, point by point: the share of dynamic points whose
            places have evidence. The same for every method.
        possible_by_object: the same if evidence at any place of an object counts for all of it.
        removed_seen, removed_unseen: dynamic points removed with evidence, and without.
        kept_seen, kept_unseen: dynamic points kept although there was evidence, and without.
        lost_SA: removed static points by cause; empty without.
        lost_DA: kept dynamic points by cause; empty without.
        objects: the largest ones.
    """

    possible: Estimate | None = None
    possible_by_object: Estimate | None = None
    removed_seen: Estimate | None = None
    removed_unseen: Estimate | None = None
    kept_seen: Estimate | None = None
    kept_unseen: Estimate | None = None
    lost_SA: Mapping[str, Estimate] = {}
    lost_DA: Mapping[str, Estimate] = {}
    objects: tuple[ObjectCeiling, ...] = ()

    def of_kept(self) -> str:
        """What the kept dynamic points lacked, in words; empty if unknown."""
        if self.kept_seen is None or self.kept_unseen is None or self.possible is None:
            return ""
        return (
            f"{self.kept_seen} with evidence that was not used, {self.kept_unseen} without; "
            f"the drive allows {self.allowed}"
        )

    @property
    def allowed(self) -> str:
        """The possible DA in words; by object, too, if the method removed more than by point."""
        known = (self.possible, self.possible_by_object, self.removed_seen, self.removed_unseen)
        by_point, by_object, seen, unseen = (each or Estimate(0.0) for each in known)
        if self.possible_by_object is None or seen.percent + unseen.percent <= by_point.percent:
            return str(by_point)
        return f"{by_point} by point and {by_object} by object"
