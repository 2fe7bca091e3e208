"""Checks results against limits and against a stored baseline, for CI."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.io.plain_json import read_json
from dynaviz.scores.changed_cases import STORED_CASES, ChangedCase, changed_cases
from dynaviz.scores.result import Result, run_label
from dynaviz.scores.sections import Failures

if TYPE_CHECKING:
    from dynaviz.scores.collect import StudyRun

SCHEMA = 1
HEADLINE = ("SA", "DA", "AA", "HA")
ROUNDING = 1e-9  # percentage points
STORED = ("sequence", "method", "variant", "online", "parameters", "scoring", "counts", "metrics")
"""What a baseline stores of a result. The runtime is left out, so that it is valid on any machine.
"""
_HINT = "Write one with: dynaviz check RESULTS --write-baseline FILE"


class CheckOutcome(IntEnum):
    """Outcome of one check, in the order in which tables list them.

    INFO is reported, but never fails the check.
    """

    FAILED = 0
    IMPROVED = 1
    PASSED = 2
    INFO = 3


@dataclass(frozen=True)
class CheckedValue:
    """One value of a run, and the limit that it was checked against.

    Attributes:
        outcome: whether the check failed, passed or improved on the baseline.
        run: method and sequence.
        name: the metric, ``s/frame``, or ``run``, ``method`` or ``parameters`` for an entry without
            numbers.
        value: in percent (seconds for ``s/frame``); None if undefined.
        limit: the least value that passes; None if every value does.
        before: of the baseline; None without one.
        remark: a further explanation.
        counts: by outcome, the number of points in the result and its difference from the baseline,
            None without one.
    """

    outcome: CheckOutcome
    run: str
    name: str
    value: float | None = None
    limit: float | None = None
    before: float | None = None
    remark: str = ""
    counts: Mapping[str, tuple[int, int | None]] = field(default_factory=dict)

    @property
    def is_text(self) -> bool:
        """Whether the entry has no numbers, only a remark."""
        return self.value is None and self.limit is None and self.before is None


@dataclass(frozen=True)
class RegressionCheck:
    """All checked values, failures first.

    Attributes:
        values: the checks.
        cases: by run, the failure cases that are new or grew since the baseline.
    """

    values: list[CheckedValue]
    cases: Mapping[str, Sequence[ChangedCase]] = field(default_factory=dict)

    @property
    def failed(self) -> list[CheckedValue]:
        """The values that failed."""
        return [value for value in self.values if value.outcome is CheckOutcome.FAILED]


def label(result: Result) -> str:
    """Method, variant and sequence, for tables and messages."""
    return f"{run_label(result.method, result.variant, result.online)} on {result.sequence.name}"


def check(
    cells: Sequence[StudyRun],
    minima: Iterable[tuple[str, float]] = (),
    baseline: Sequence[Result] | None = None,
    tolerance: float = 0.5,
    complete: bool = False,
) -> RegressionCheck:
    """Compare results with limits and with a baseline.

    Args:
        cells: the runs; a run that raised an error fails the check.
        minima: metrics and the minimum value, in percent, that each result must reach.
        baseline: earlier results; a run that is not among them is reported as information.
        tolerance: percentage points by which SA, DA, AA and HA may be lower than in the baseline.
        complete: whether every entry of the baseline must have a result.

    Raises:
        UsageError: for a metric that a result does not have, or if a result is from a different
            sequence or uses another scoring than its baseline entry.
    """
    minima = list(minima)
    values = []
    cases: dict[str, list[ChangedCase]] = {}
    left = list(baseline or [])
    for cell in cells:
        if cell.result is None:
            run = f"{cell.label} on {cell.sequence}"
            failed = (cell.method, cell.variant, cell.sequence)
            values.append(
                CheckedValue(CheckOutcome.FAILED, run, "run", remark=f"failed: {cell.error}")
            )
            left = [e for e in left if (e.method, e.variant, e.sequence.name) != failed]
            continue
        now = cell.result
        values += [_against_minimum(now, name, minimum) for name, minimum in minima]
        before = None
        if baseline is not None:
            before = _match(now, baseline, alone=len(baseline) == len(cells) == 1)
            values += _against_baseline(now, before, tolerance)
            if before is not None and (found := changed_cases(now, before, cell.recording)):
                cases[label(now)] = found
            left = [entry for entry in left if entry is not before]
        values += _runtime(now, before)
    if complete:
        values += [
            CheckedValue(
                CheckOutcome.FAILED, label(e), "run", remark="is in the baseline, but has no result"
            )
            for e in left
        ]
    return RegressionCheck(sorted(values, key=lambda value: value.outcome), cases)


def _against_minimum(now: Result, name: str, minimum: float) -> CheckedValue:
    if name not in now.metrics:
        raise UsageError(
            f"--min {name}: {label(now)} has the metrics {', '.join(now.metrics) or 'none'}"
        )
    value = now.metrics[name]
    counts = _counts(now, None)
    if value is None:
        return CheckedValue(
            CheckOutcome.FAILED,
            label(now),
            name,
            limit=minimum,
            remark=_why_undefined(now),
            counts=counts,
        )
    outcome = CheckOutcome.FAILED if value < minimum else CheckOutcome.PASSED
    return CheckedValue(outcome, label(now), name, value, minimum, counts=counts)


def _against_baseline(now: Result, before: Result | None, tolerance: float) -> list[CheckedValue]:
    if before is None:
        return [CheckedValue(CheckOutcome.INFO, label(now), "run", remark="is not in the baseline")]
    values = []
    counts = _counts(now, before)
    for name in HEADLINE:
        new = now.metrics.get(name)
        old = before.metrics.get(name)
        outcome = CheckOutcome.PASSED
        remark = ""
        if new is None and old is not None:
            outcome = CheckOutcome.FAILED
            remark = _why_undefined(now)
        elif new is not None and old is not None:  # a metric that becomes defined passes
            if new < old - tolerance - ROUNDING:
                outcome = CheckOutcome.FAILED
            elif new > old + tolerance + ROUNDING:
                outcome = CheckOutcome.IMPROVED
        limit = None if old is None else old - tolerance
        values.append(CheckedValue(outcome, label(now), name, new, limit, old, remark, counts))
    if now.method != before.method:
        values.append(
            CheckedValue(CheckOutcome.INFO, label(now), "method", remark=f"was {before.method}")
        )
    elif now.parameters != before.parameters:
        names = sorted(now.parameters.keys() | before.parameters.keys())
        changed = [n for n in names if now.parameters.get(n) != before.parameters.get(n)]
        changes = ", ".join(
            f"{n} {before.parameters.get(n)} -> {now.parameters.get(n)}" for n in changed
        )
        values.append(CheckedValue(CheckOutcome.INFO, label(now), "parameters", remark=changes))
    return values


def _runtime(now: Result, before: Result | None) -> list[CheckedValue]:
    value = now.runtime.mean_s
    old = before.runtime.mean_s if before else None
    if value is None or old is None:
        return []
    info = CheckOutcome.INFO
    return [CheckedValue(info, label(now), "s/frame", value, before=old, remark="not checked")]


def _counts(now: Result, before: Result | None) -> dict[str, tuple[int, int | None]]:
    return {
        name: (count, None if before is None else count - before.counts.get(name, 0))
        for name, count in now.counts.items()
    }


def _why_undefined(now: Result) -> str:
    count = now.counts
    if not count.get("dynamic_removed", 0) + count.get("dynamic_kept", 0):
        return "undefined: no point is labelled as dynamic"
    if not count.get("static_kept", 0) + count.get("static_removed", 0):
        return "undefined: no point is labelled as static"
    return "undefined: no labelled point was removed"


def _match(now: Result, baseline: Sequence[Result], alone: bool) -> Result | None:
    """The baseline entry of the same run.

    Of several, the one with the same data, then scoring, then parameters.
    """

    def same_run(e: Result) -> bool:
        same_method = (e.method, e.variant, e.online) == (now.method, now.variant, now.online)
        return same_method and (
            e.sequence.digest == now.sequence.digest or e.sequence.name == now.sequence.name
        )

    found = [entry for entry in baseline if alone or same_run(entry)]
    if not found:
        return None
    agreeing = [
        (
            e.sequence.digest == now.sequence.digest,
            e.scoring == now.scoring,
            e.parameters == now.parameters,
        )
        for e in found
    ]
    before = found[agreeing.index(max(agreeing))]
    if before.sequence.digest != now.sequence.digest:
        raise UsageError(
            f"{label(now)}: the data differ from the baseline: digest {_data(now)}, in the "
            f"baseline {_data(before)}. "
            "Use the same frames of the same sequence (if simulated: the same scene, frames, seed "
            "and dynaviz "
            "version), or write a new baseline"
        )
    if before.scoring != now.scoring:
        raise UsageError(
            f"{label(now)}: the result uses the scoring {now.scoring}, the baseline "
            f"{before.scoring}; their metrics "
            "are not comparable. Score both in the same way"
        )
    return before


def _data(result: Result) -> str:
    sequence = result.sequence
    return f"{sequence.digest[:12]} ({sequence.frames} frames, {sequence.points} points)"


def _entry(result: Result) -> dict[str, Any]:
    """What a baseline stores of a result."""
    plain = {name: msgspec.to_builtins(getattr(result, name)) for name in STORED}
    section = result.sections.failures
    if section is not None:
        cases = [
            msgspec.structs.replace(case, looks=None, spans={})
            for case in section.cases[:STORED_CASES]
        ]
        plain["failures"] = msgspec.to_builtins(Failures(tuple(cases), section.causes))
    return plain


def read_baseline(path: str | os.PathLike[str]) -> list[Result]:
    """Read a baseline, or the ``result.json`` of one run as one.

    Raises:
        DataError: for any other file, or one that was written by a newer dynaviz.
    """
    plain = read_json(path, _HINT)
    if not isinstance(plain, dict) or "baseline" not in plain:
        return [Result.from_dict(plain, path)]
    if isinstance(plain["baseline"], int) and plain["baseline"] > SCHEMA:
        raise DataError(path, "was written by a newer dynaviz", hint="Upgrade dynaviz")
    try:  # an entry has the same keys as a result
        return [Result.from_dict(row, path) for row in plain["results"]]
    except (KeyError, TypeError) as error:
        raise DataError(path, f"is not a baseline ({error})", hint=_HINT) from None


def write_baseline(path: str | os.PathLike[str], results: Iterable[Result]) -> None:
    """Write a baseline: counts, metrics, causes and costliest cases of each result.

    Raises:
        UsageError: if two results of the same run differ.
        DataError: if the file cannot be written.
    """
    found: dict[str, Result] = {}
    for each in results:
        key = json.dumps(
            [label(each), each.sequence.digest, each.scoring, each.parameters], sort_keys=True
        )
        if found.setdefault(key, each).counts != each.counts:
            raise UsageError(f"two results of {label(each)} differ: leave one out of the baseline")
    order = sorted(found.values(), key=lambda e: (e.sequence.name, e.method, e.variant, e.online))
    rows = [json.dumps(_entry(each)) for each in order]
    # One line per run, so that a diff of two versions shows which runs changed.
    text = f'{{"baseline": {SCHEMA}, "results": [\n' + ",\n".join(rows) + "\n]}\n"
    write_atomic(Path(path), text.encode())
