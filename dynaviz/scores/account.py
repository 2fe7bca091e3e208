"""Where the points of a sequence went when a map was written."""

from __future__ import annotations

from msgspec import Struct


class PointAccount(Struct, frozen=True):
    """Where the points of a sequence went when a map was written.

    Each point counts once, so ``points`` is the sum; those changed by hand are counted again.

    Attributes:
        points: all of the selected frames, and those that no pose covers.
        kept, removed: points that the method judged.
        unposed_kept: points that no pose covers, kept without judgement.
        unposed_left_out: points that no pose covers, not in the map.
        not_finite: points with NaN or infinite coordinates, not in the map.
        outside_region: kept points outside the region of the map.
        thinned: kept points in voxels that have a point.
        kept_by_hand, removed_by_hand: of the kept and removed points, those whose answer the
            decisions of a person changed.
    """

    points: int = 0
    kept: int = 0
    removed: int = 0
    unposed_kept: int = 0
    unposed_left_out: int = 0
    not_finite: int = 0
    outside_region: int = 0
    thinned: int = 0
    kept_by_hand: int = 0
    removed_by_hand: int = 0

    @property
    def percent(self) -> float | None:
        """Removed points in percent of the judged ones; None without points."""
        judged = self.kept + self.removed + self.outside_region + self.thinned
        return 100.0 * self.removed / judged if judged else None

    def __str__(self) -> str:
        unposed = self.unposed_kept + self.unposed_left_out
        kept = self.unposed_kept
        fate = (
            ""
            if not unposed
            else " (kept)"
            if kept == unposed
            else f" ({kept:,} of them kept)"
            if kept
            else " (left out)"
        )
        parts = [
            f"{self.kept:,} kept",
            f"{self.removed:,} removed",
            f"{unposed:,} outside the trajectory{fate}",
            f"{self.not_finite:,} not finite",
            f"{self.outside_region:,} outside the region",
            *([f"{self.thinned:,} in voxels that have a point"] if self.thinned else []),
        ]
        by_hand = (
            f"; by hand: {self.kept_by_hand:,} of the kept, {self.removed_by_hand:,} of the removed"
            if self.kept_by_hand or self.removed_by_hand
            else ""
        )
        return f"{self.points:,} in = {' + '.join(parts)}{by_hand}"
