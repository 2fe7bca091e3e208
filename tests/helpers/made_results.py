"""Results as a run writes them, made from counts."""

from __future__ import annotations

import dataclasses
from typing import Any

from dynaviz.scores.result import Result
from dynaviz.scores.scores import Counts

Numbers = tuple[int, int, int, int]  # static kept, static removed, dynamic removed, dynamic kept


def result(
    method: str,
    sequence: str | dict[str, Any] = "hall",
    numbers: Numbers = (900, 100, 80, 20),
    **fields: Any,
) -> Result:
    """A result as a run writes it; the metrics follow from the counts."""
    counts = Counts(*numbers)
    sections = {
        "counts": dataclasses.asdict(counts),
        "metrics": counts.metrics(),
        "error_distance": {
            kind: {"p10": 0.04, "histogram": [5, 3, *[0] * 38, 2], "count": 10}
            for kind in ("false_negative", "false_positive")
        },
        "breakdown": {
            "range": [
                {"from": 0.0, "to": 10.0, **counts.row()},
                {"from": 10.0, "to": None, **Counts().row()},
            ],
            "frame": [{"frame": 0, "index": 7}],
        },
        "failures": {
            "cases": [],
            "causes": {
                "false_negative": {"nothing behind": {"cases": 1, "points": numbers[3]}}
                if numbers[3]
                else {},
                "false_positive": {"grazing rays": {"cases": 1, "points": numbers[1]}}
                if numbers[1]
                else {},
            },
        },
        **fields.pop("sections", {}),
    }
    plain: dict[str, Any] = {
        "method": method,
        "parameters": {"resolution": 0.1, "a_b": 'x,"y"'},
        "sequence": sequence
        if isinstance(sequence, dict)
        else {
            "name": sequence,
            "digest": f"digest of {sequence}",
            "frames": 1,
            "points": sum(numbers),
        },
        "runtime": {
            "mean_s": 0.5,
            "std_s": 0.1,
            "frames": 1,
            "threads": 2,
            "prepare_s": 0.0,
            "peak_rss_mb": 1.0,
        },
        "environment": {"machine": {"system": "Linux", "arch": "x86_64", "cores": 2}},
        "labels_sha256": "ab" * 32,
        **fields,
        **sections,
    }
    return Result.from_dict(plain, "result.json")


def case(
    kind: str, cost: float, low: tuple[float, ...], high: tuple[float, ...], **fields: Any
) -> dict[str, Any]:
    """A failure case as plain JSON values."""
    return {
        "kind": kind, "points": 10, "cost": cost, "first_frame": 0, "last_frame": 4,
        "worst_frame": 1, "frames": 5,
        "low": list(low), "high": list(high), "range": {"min": 1.0, "mean": 2.0, "max": 3.0},
        "moved": 0.0,
        "reasons": {"never_crossed": 10}, "cause": "nothing "
        "behind", "what": "car", "sentence": "Kept: a car.",
        **fields,
    }  # fmt: skip


def thing(instance: int, removed: int, kept: int, **fields: Any) -> dict[str, Any]:
    """An object of a breakdown, of class 252, as plain JSON values."""
    counts = Counts(dynamic_removed=removed, dynamic_kept=kept)
    place = {
        "class": 252,
        "instance": instance,
        "first_frame": 0,
        "last_frame": 4,
        "points": removed + kept,
    }
    return {**place, **counts.row(), "reasons": {"never_crossed": kept} if kept else {}, **fields}


def without_truth(method: str, removals: dict[str, Any] | None = None) -> Result:
    """A result of a run without ground truth."""
    sections: dict[str, Any] = {"breakdown": {}, "failures": {}, "error_distance": {}}
    if removals is not None:
        sections["removals"] = removals
    return result(method, "open", (0, 0, 0, 0), sections=sections)


REMOVALS: dict[str, Any] = {
    "points": 1000, "removed": 50, "reasons": {"seen_free": 40, "low": 10},
    "range": [
        {"from": 0.0, "to": 10.0, "points": 400, "removed": 40},
        {"from": 10.0, "to": None, "points": 600, "removed": 10},
    ],
    "clusters": [
        {
            "points": 40, "first_frame": 0, "last_frame": 4, "worst_frame": 1, "frames": 5,
            "low": [0, 0, 0],
            "high": [4, 0.5, 3], "range": {"min": 1.0, "mean": 2.0, "max": 3.0}, "moved": 0.0,
            "reasons": {"seen_free": 40}, "suspicion": 0.9, "why": ["flat", "large"],
            "what": "wall",
            "sentence": "Removed: wall.",
        }
    ],
}  # fmt: skip
