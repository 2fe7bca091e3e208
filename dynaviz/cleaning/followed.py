"""The decisions that a map follows, in its summary."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from dynaviz.reviews.applying import Applied
from dynaviz.reviews.decisions import Decisions
from dynaviz.sources.drive import Drive


@dataclass(frozen=True)
class Reviewed:
    """Decisions on the sequence of a map.

    Attributes:
        file: with the decisions.
        applied: what they did.
    """

    file: Path
    applied: Applied

    @classmethod
    def of(cls, sequence: Drive, review: str | os.PathLike[str] | Decisions) -> Reviewed:
        """The decisions of a file.

        Raises:
            DataError: if it cannot be read, or is for another world frame.
        """
        found = review if isinstance(review, Decisions) else Decisions.existing(review)
        return cls(found.path, Applied.to(sequence, found))

    def to_dict(self) -> dict[str, Any]:
        """In plain values, for JSON."""
        by_hand = self.applied.by_hand
        return {
            "file": str(self.file),
            "kept": by_hand.kept,
            "removed": by_hand.removed,
            "decisions": [
                {
                    **msgspec.to_builtins(msgspec.structs.replace(each.decision)),
                    "points": each.points,
                    "kept": each.kept,
                    "removed": each.removed,
                }
                for each in by_hand.effects
            ],
        }

    def lines(self) -> Iterator[str]:
        """Every decision, for the summary."""
        by_hand = self.applied.by_hand
        yield from ["", "## Decided by hand", ""]
        yield (
            f"{len(by_hand.effects)} decisions in `{self.file}` changed the answer of "
            f"{by_hand.kept + by_hand.removed:,} points: {by_hand.kept:,} kept, "
            f"{by_hand.removed:,} removed.\n"
        )
        if not by_hand.effects:
            return
        yield "| decision | what | points | kept | removed | reviewer | reason | made |"
        yield "|---|---|---:|---:|---:|---|---|---|"
        for each in by_hand.effects:
            made = each.decision
            words = [made.what or made.kind, made.reviewer, made.reason, made.made[:19]]
            what, reviewer, reason, when = (
                word.replace("|", "/").replace("\n", " ") for word in words
            )
            points = f"{each.points:,}" if each.points else "matches none"
            yield (
                f"| {made.verdict} | {what} | {points} | "
                f"{each.kept:,} | {each.removed:,} | {reviewer} | {reason} | {when} |"
            )
