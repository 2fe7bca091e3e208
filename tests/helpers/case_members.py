"""All points of the listed cases of a run, found by joining the wrong points again."""

from __future__ import annotations

from collections.abc import Sequence
from unittest import mock

from dynaviz.contracts import registry
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Scan
from dynaviz.runs.run import Run
from dynaviz_eval import failures

ALL = 1 << 22  # points of a case


def members(run: Run, scans: Sequence[Scan]) -> dict[tuple[int, int], int]:
    """By frame and row of a wrong point, the number of its case, 1 for the first."""
    labels = run.labeller
    with mock.patch.multiple(failures, LOOKED_AT=ALL, MOST_LOOKED_AT=ALL):
        metric = failures.FailuresMetric(registry.load("methods", run.result.method).info)
        for frame, scan in enumerate(scans):
            answer = labels.label(scan)
            metric.update(Labelled.of(frame, scan, answer.dynamic, answer.reasons, answer.answered))
        metric.places()
    found = {}
    for number, each in enumerate(metric._found, 1):
        assert len(each.sample) == run.result.failures[number - 1].points
        places = zip(each.sample["frame"].tolist(), each.sample["row"].tolist(), strict=True)
        found |= dict.fromkeys(places, number)
    return found
