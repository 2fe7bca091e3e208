"""Results with given cases of removed points."""

from __future__ import annotations

from typing import Any

from dynaviz.scores.result import Result


def removed_cases(cases: tuple[dict[str, Any], ...]) -> Result:
    """A run with these failure cases."""
    listed = [
        {
            "kind": "false_positive", "points": 1, "first_frame": 2, "last_frame": 9,
            "worst_frame": 4, "frames": 8, "range": {"min": 1, "mean": 2, "max": 3}, "moved": 1.0,
            "reasons": {}, **case,
        }
        for case in cases
    ]  # fmt: skip
    known = {"method": "m", "parameters": {}, "sequence": {"name": "00"}, "counts": {}}
    return Result.from_dict({**known, "failures": {"cases": listed}}, "result.json")
