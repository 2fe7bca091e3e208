"""The cases of a recording as a table: a row per case on the timeline ``case``.

For data frames, which read it without dynaviz.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr

from dynaviz.scores.failure_case import FailureCase
from dynaviz.views import paths
from dynaviz.views.cases import ShownCase
from dynaviz.views.record.sink import RecordingFile

LOOKS = ("hit", "through", "hidden", "between", "outside", "seen_through")  # percent
TEXT = pa.string()
COUNT = pa.int64()
NUMBER = pa.float64()


def write(sink: RecordingFile, cases: Sequence[ShownCase]) -> None:
    """Write the table; cells that are unknown are empty."""
    numbers = [case.number for case in cases]
    columns: dict[str, Any] = {}
    for name, kind in KINDS.items():
        columns[name] = pa.array([_row(case).get(name) for case in cases], kind)
    sink.case_columns(paths.CASES_TABLE, numbers, rr.AnyValues.columns(**columns))
    corners: dict[str, Any] = {
        "low": np.concatenate([case.low for case in cases]),
        "high": np.concatenate([case.high for case in cases]),
    }
    box = rr.AnyValues.columns(**corners).partition([3] * len(cases))
    sink.case_columns(paths.CASES_TABLE, numbers, box)


KINDS = {
    "title": TEXT,
    "kind": TEXT,
    "cause": TEXT,
    "behaviour": TEXT,
    "reason": TEXT,
    "metric": TEXT,
    "cost": NUMBER,
    "points": COUNT,
    "what": TEXT,
    "class": COUNT,
    "instance": COUNT,
    "range": NUMBER,
    "worst_frame": COUNT,
    "first_frame": COUNT,
    "last_frame": COUNT,
    **dict.fromkeys((f"looks_{name}" for name in LOOKS), NUMBER),
}


def _row(case: ShownCase) -> dict[str, Any]:
    failure = case.failure
    known = {"title": case.title, "worst_frame": case.frame}
    return known if failure is None else known | _of_failure(failure)


def _of_failure(case: FailureCase) -> dict[str, Any]:
    looks = case.looks
    return {
        "kind": case.kind,
        "cause": case.cause,
        "behaviour": case.behaviour,
        "reason": case.reason,
        "metric": case.metric,
        "cost": case.cost,
        "points": case.points,
        "what": case.what,
        "class": case.class_,
        "instance": case.instance,
        "range": case.range.mean,
        "first_frame": case.first_frame,
        "last_frame": case.last_frame,
        **({f"looks_{name}": getattr(looks, name) for name in LOOKS} if looks else {}),
    }
