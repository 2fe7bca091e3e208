"""Whether results are good enough: against limits, and against a baseline that was committed. For CI."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.io.plain_json import read_json
from dynaviz.results.result import Result, label

if TYPE_CHECKING:
    from dynaviz.results.collect import StudyRun

SCHEMA = 1
HEADLINE = ("SA", "DA", "AA", "HA")
ROUNDING = 1e-9  # percentage points
_HINT = "Write one with: dynaviz check RESULTS --write-baseline FILE"


@dataclass(frozen=True)
class BaselineEntry:
    """What a baseline keeps of a result: what ran on what, counts and metrics.

    Attributes:
        sequence: name, digest, frames and points.
        counts, metrics: as in ``Result``; metrics in percent, None where undefined.
        mean_s: seconds a frame, for telling; None in a baseline, which holds on any machine.
    """

    sequence: dict[str, Any]
    method: str
    variant: str
    online: bool
    parameters: dict[str, Any]
    scoring: str
    counts: dict[str, int]
    metrics: dict[str, float | None]
    mean_s: float | None = None

    @classmethod
    def of(cls, result: Result) -> BaselineEntry:
        """What is kept of a result."""
        return cls(
            dict(result.sequence),
            result.method,
            result.variant,
            result.online,
            dict(result.parameters),
            result.scoring,
            dict(result.counts),
            dict(result.metrics),
            result.runtime.get("mean_s"),
        )

    @property
    def label(self) -> str:
        """Method and sequence, and what sets this run of it apart."""
        return f"{label(self.method, self.variant, self.online)} on {self.sequence.get('name')}"

    @property
    def digest(self) -> str:
        """Of the sequence."""
        return str(self.sequence.get("digest"))


class CheckOutcome(IntEnum):
    """How a finding is to be taken, in the order of a table."""

    FELL = 0
    BETTER = 1
    HOLDS = 2
    TOLD = 3


@dataclass(frozen=True)
class CheckedValue:
    """One comparison.

    Attributes:
        run: method and sequence.
        what: the metric, or another matter.
        value, limit: in percent (seconds for ``s/frame``); None where undefined, both where it is no number.
        remark: what numbers do not say.
        counts: of the result, and by how much they differ from the baseline's.
    """

    verdict: CheckOutcome
    run: str
    what: str
    value: float | None = None
    limit: float | None = None
    remark: str = ""
    counts: Mapping[str, tuple[int, int | None]] = field(default_factory=dict)

    @property
    def in_words(self) -> bool:
        """Whether it has no numbers."""
        return self.value is None and self.limit is None


@dataclass(frozen=True)
class RegressionCheck:
    """All findings, the worst first."""

    findings: list[CheckedValue]

    @property
    def fallen(self) -> list[CheckedValue]:
        """What fell."""
        return [finding for finding in self.findings if finding.verdict is CheckOutcome.FELL]


def check(
    cells: Sequence[StudyRun],
    minima: Iterable[tuple[str, float]] = (),
    baseline: Sequence[BaselineEntry] | None = None,
    tolerance: float = 0.5,
    complete: bool = False,
) -> RegressionCheck:
    """Compare results with limits and with a baseline.

    Args:
        cells: the results; a cell that failed falls.
        minima: metrics and the least value in percent that each result must have.
        baseline: what results were; those that it does not hold are told.
        tolerance: percentage points by which a headline metric may be lower.
        complete: whether every entry of the baseline must have its result.

    Raises:
        UsageError: for a metric that a result does not have, and where a result is of another sequence or another
            scoring than its entry in the baseline.
    """
    minima, findings = list(minima), []
    left = list(baseline or [])
    for cell in cells:
        if cell.result is None:
            run, failed = f"{cell.label} on {cell.sequence}", (cell.method, cell.variant, cell.sequence)
            findings.append(CheckedValue(CheckOutcome.FELL, run, "run", remark=f"failed: {cell.error}"))
            left = [e for e in left if (e.method, e.variant, e.sequence.get("name")) != failed]
            continue
        now = BaselineEntry.of(cell.result)
        findings += [_least(now, name, least) for name, least in minima]
        before = None
        if baseline is not None:
            before = _match(now, baseline, alone=len(baseline) == len(cells) == 1)
            findings += _changes(now, before, tolerance)
            left = [entry for entry in left if entry is not before]
        findings += _runtime(now, before)
    if complete:
        findings += [
            CheckedValue(CheckOutcome.FELL, e.label, "run", remark="is in the baseline, but has no result")
            for e in left
        ]
    return RegressionCheck(sorted(findings, key=lambda finding: finding.verdict))


def _least(now: BaselineEntry, name: str, least: float) -> CheckedValue:
    if name not in now.metrics:
        raise UsageError(f"--min {name}: {now.label} has the metrics {', '.join(now.metrics) or 'none'}")
    value, counts = now.metrics[name], _counts(now, None)
    if value is None:
        return CheckedValue(CheckOutcome.FELL, now.label, name, None, least, _why_undefined(now), counts)
    return CheckedValue(
        CheckOutcome.FELL if value < least else CheckOutcome.HOLDS, now.label, name, value, least, "", counts
    )


def _changes(now: BaselineEntry, before: BaselineEntry | None, tolerance: float) -> list[CheckedValue]:
    if before is None:
        return [CheckedValue(CheckOutcome.TOLD, now.label, "run", remark="is not in the baseline")]
    findings, counts = [], _counts(now, before)
    for name in HEADLINE:
        new, old = now.metrics.get(name), before.metrics.get(name)
        verdict, remark = CheckOutcome.HOLDS, ""
        if new is None and old is not None:
            verdict, remark = CheckOutcome.FELL, _why_undefined(now)
        elif new is not None and old is not None:  # what becomes defined is no loss
            if new < old - tolerance - ROUNDING:
                verdict = CheckOutcome.FELL
            elif new > old + tolerance + ROUNDING:
                verdict = CheckOutcome.BETTER
        findings.append(CheckedValue(verdict, now.label, name, new, old, remark, counts))
    if now.method != before.method:
        findings.append(CheckedValue(CheckOutcome.TOLD, now.label, "method", remark=f"was {before.method}"))
    elif now.parameters != before.parameters:
        names = sorted(now.parameters.keys() | before.parameters.keys())
        changed = [n for n in names if now.parameters.get(n) != before.parameters.get(n)]
        told = ", ".join(f"{n} {before.parameters.get(n)} -> {now.parameters.get(n)}" for n in changed)
        findings.append(CheckedValue(CheckOutcome.TOLD, now.label, "parameters", remark=told))
    return findings


def _runtime(now: BaselineEntry, before: BaselineEntry | None) -> list[CheckedValue]:
    if now.mean_s is None or before is None or before.mean_s is None:
        return []
    return [CheckedValue(CheckOutcome.TOLD, now.label, "s/frame", now.mean_s, before.mean_s, "only told")]


def _counts(now: BaselineEntry, before: BaselineEntry | None) -> dict[str, tuple[int, int | None]]:
    return {
        name: (count, None if before is None else count - before.counts.get(name, 0))
        for name, count in now.counts.items()
    }


def _why_undefined(now: BaselineEntry) -> str:
    count = now.counts
    if not count.get("dynamic_removed", 0) + count.get("dynamic_kept", 0):
        return "undefined: no point is labelled as dynamic"
    if not count.get("static_kept", 0) + count.get("static_removed", 0):
        return "undefined: no point is labelled as static"
    return "undefined: nothing labelled was removed"


def _match(now: BaselineEntry, baseline: Sequence[BaselineEntry], alone: bool) -> BaselineEntry | None:
    """The entry of the same run; of several, the one that agrees in data, then scoring, then parameters."""

    def akin(e: BaselineEntry) -> bool:
        same_run = (e.method, e.variant, e.online) == (now.method, now.variant, now.online)
        return same_run and (e.digest == now.digest or e.sequence.get("name") == now.sequence.get("name"))

    found = [entry for entry in baseline if alone or akin(entry)]
    if not found:
        return None
    agreeing = [(e.digest == now.digest, e.scoring == now.scoring, e.parameters == now.parameters) for e in found]
    before = found[agreeing.index(max(agreeing))]
    if before.digest != now.digest:
        raise UsageError(
            f"{now.label} is of other data than the baseline: digest {now.digest[:12]} ({_size(now)}), there "
            f"{before.digest[:12]} ({_size(before)}). Use the same frames of the same sequence (simulated: the same "
            "scene, frames, seed and dynaviz), or write a baseline of this one"
        )
    if before.scoring != now.scoring:
        raise UsageError(
            f"{now.label} has the scoring {now.scoring}, the baseline {before.scoring}: these numbers do not compare. "
            "Score both in the same way"
        )
    return before


def _size(entry: BaselineEntry) -> str:
    return f"{entry.sequence.get('frames')} frames, {entry.sequence.get('points')} points"


def read_baseline(path: str | os.PathLike[str]) -> list[BaselineEntry]:
    """Read a baseline, or the ``result.json`` of one run as one.

    Raises:
        DataError: where the file is neither, or was written by a newer dynaviz.
    """
    plain = read_json(path, _HINT)
    if not isinstance(plain, dict) or "baseline" not in plain:
        return [BaselineEntry.of(Result.from_dict(plain, path))]
    if isinstance(plain["baseline"], int) and plain["baseline"] > SCHEMA:
        raise DataError(path, "was written by a newer dynaviz", hint="Upgrade with: pip install -U dynaviz")
    try:  # an entry has nothing but what a result has, too
        return [BaselineEntry.of(Result.from_dict(row, path)) for row in plain["results"]]
    except (KeyError, TypeError) as error:
        raise DataError(path, f"is not a baseline ({error})", hint=_HINT) from None


def write_baseline(path: str | os.PathLike[str], results: Iterable[Result]) -> None:
    """Write a baseline: of each result what ran on what, counts and metrics; no runtime, so that it holds anywhere.

    Raises:
        UsageError: where two results of the same run differ.
        DataError: where the file cannot be written.
    """
    entries: dict[str, BaselineEntry] = {}
    for entry in map(BaselineEntry.of, results):
        same = entries.setdefault(
            json.dumps([entry.label, entry.digest, entry.scoring, entry.parameters], sort_keys=True), entry
        )
        if same.counts != entry.counts:
            raise UsageError(f"two results of {entry.label} differ: leave one out of the baseline")
    rows = []
    for entry in sorted(entries.values(), key=lambda e: (str(e.sequence.get("name")), e.method, e.variant, e.online)):
        row = asdict(entry)
        del row["mean_s"]
        rows.append(json.dumps(row))
    # A line each, so that a diff of two versions shows which runs changed.
    text = f'{{"baseline": {SCHEMA}, "results": [\n' + ",\n".join(rows) + "\n]}\n"
    write_atomic(Path(path), text.encode())
