"""Labelled scans of one label and answer, and what the metric ``failures`` makes of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynaviz.contracts.method import Cause, MethodInfo, Reason
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Scan
from dynaviz.engine.looks import LookTables, answer
from dynaviz_eval.failures import FailuresMetric
from helpers.sections import plain

INFO = MethodInfo(
    "m",
    "M",
    "none",
    (
        Reason("crossed", "rays", Cause.GRAZING_RAYS),
        Reason("never_crossed", "no rays", Cause.NOTHING_BEHIND),
        Reason("too_high", "height", Cause.HEIGHT_LIMIT),
        Reason("mystery", "unknown"),
        Reason("hit_more", "hits", Cause.STANDING),
    ),
)


def labelled(
    frame: int, points: Any, labels: int, dynamic: bool, reasons: int = 0, **fields: Any
) -> Labelled:
    """A scan whose points share a label, an answer and a reason."""
    points = np.asarray(points, np.float32).reshape(-1, 3)
    n = len(points)
    scan = Scan(frame, points, np.eye(4), labels=np.full(n, labels, np.uint8), **fields)
    return Labelled.of(frame, scan, np.full(n, dynamic, np.bool_), np.full(n, reasons, np.uint8))


def section(*frames: Labelled) -> dict[str, Any]:
    """The section of these frames."""
    metric = FailuresMetric(INFO)
    tables = LookTables()
    for frame in frames:
        metric.update(frame)
        tables.add(frame)
    answer([metric], tables)
    return dict(plain(metric.finish())["failures"])
