"""Ask a run why points got their labels."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence

from dynaviz.contracts.evidence import Explains
from dynaviz.contracts.plugin_code import plugin
from dynaviz.engine.loop import RunSpec
from dynaviz.errors import DataError, UsageError
from dynaviz.explain.document import Why, cause_at
from dynaviz.explain.point_ledger import PointLedger
from dynaviz.explain.repeat import repeat
from dynaviz.progress import Progress, silent
from dynaviz.runs.run import ELSEWHERE, Run, open_run
from dynaviz.scores.result import Result
from dynaviz.sources.opening import Source
from dynaviz.sources.summary import summarize


def why(
    run: str | os.PathLike[str] | Result | Run,
    frame: int,
    point: int,
    *,
    sequence: Source | None = None,
    threads: int | None = None,
    progress: Progress = silent,
) -> Why:
    """Explain the label of a point.

    Every scan whose rays touched it, what each contributed, and the verdict.

    The run is repeated to ask the method after each scan, so this takes as long as the run.

    Args:
        run: a run's folder, ``result.json`` or ``run.rrd``; or a result, also of a run on arrays in
            this process.
        frame: position in the run, as in the recording and in failure cases.
        point: row in the scan of that frame.
        sequence: the run's sequence, open or as a path, if the data moved. A path is opened as the
            run opened it.
        threads: for kernels; None for all cores.
        progress: called with a phase, the number of frames done and their total.

    Raises:
        UsageError: for a frame or point that does not exist, an unknown method, or a run without a
            known sequence.
        DataError: for files that cannot be read, a different sequence, or if the replay gives
            different labels.
    """
    found = explain(run, {frame: [point]}, sequence=sequence, threads=threads, progress=progress)
    return found[frame][0]


def explain(
    run: str | os.PathLike[str] | Result | Run,
    points: Mapping[int, Sequence[int]],
    *,
    sequence: Source | None = None,
    threads: int | None = None,
    progress: Progress = silent,
) -> dict[int, tuple[Why, ...]]:
    """Explain several points in one replay.

    Args:
        run, sequence, threads, progress: as for ``why``.
        points: for each frame, rows in its scan.

    Returns:
        By frame, in the order of ``points``.

    Raises:
        UsageError, DataError: as ``why``.
    """
    opened = run if isinstance(run, Run) else open_run(run)
    spec = _again(opened, sequence, threads, progress)
    repeated = repeat(spec, list(points.items()), whole=True, progress=progress)
    if opened.result.labels_sha256 not in ("", repeated.labels_sha256):
        raise DataError(opened.path, _changed(opened.result), hint="Run the method again")
    info = spec.labeller.info
    note = ""
    if spec.method is None:
        note = (
            "The labels come from another program, so there is no ledger: only the rays are known."
        )
    elif not isinstance(spec.method, Explains):
        note = f"{info.name} states no evidence, so there is no ledger: only the rays are known."
    facts = opened.result.method, info.title, spec.sequence.name, opened.result.online
    return {
        frame: tuple(
            Why(*facts, each, cause_at(opened.result, each), note)
            for each in (_stored(opened, e) for e in found)
        )
        for frame, found in zip(points, repeated.ledgers, strict=True)
    }


def _again(run: Run, at: Source | None, threads: int | None, progress: Progress) -> RunSpec:
    """The run again, on the same data.

    Raises:
        UsageError: as ``Run.sequence`` and ``Run.spec``.
        DataError: for data that cannot be read, or a different sequence.
    """
    spec = run.spec(run.sequence(at, progress), threads)
    total = len(spec.sequence)
    summary = summarize(spec.sequence, lambda done: progress("survey", done, total))
    if run.result.sequence.digest not in ("", summary.digest):
        problem = f"is from a different sequence than the {total:,} frames of {spec.sequence.name}"
        raise DataError(run.path, problem, hint=ELSEWHERE)
    return dataclasses.replace(spec, summary=summary)


def _changed(result: Result) -> str:
    """Why repeating a run may give other labels."""
    now, then = _code(result)
    if then and now and now != then:
        return (
            f"was made by other code of {result.method}, whose labels this version does not "
            "reproduce"
        )
    version = result.environment.versions.get("dynaviz", "of another version")
    return f"was written by dynaviz {version}, whose labels this version does not reproduce"


def _code(result: Result) -> tuple[str, str]:
    """Digests of the method's code now and when the run was made; empty if unknown."""
    found = plugin("methods", result.method)
    return found.sha256 if found else "", result.plugin.sha256 if result.plugin else ""


def _stored(run: Run, ledger: PointLedger) -> PointLedger:
    """The ledger with the number of the case, if the recording of the run stores that.

    The boxes of cases overlap.
    """
    try:
        recording = run.recording
    except (DataError, UsageError):  # not recorded
        return ledger
    for number, case in enumerate(run.result.failures, 1):
        if case.worst_frame == ledger.frame and any(
            each.point == ledger.point for each in recording.ledgers(number)
        ):
            return dataclasses.replace(ledger, case=number)
    return ledger
