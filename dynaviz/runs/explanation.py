"""Ask a run why points got their labels."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence

from dynaviz.contracts.evidence import Explains
from dynaviz.contracts.plugin_code import plugin
from dynaviz.engine.loop import RunSpec
from dynaviz.errors import DataError
from dynaviz.explain.document import Why, cause_at
from dynaviz.explain.repeat import repeat
from dynaviz.progress import Progress, silent
from dynaviz.runs.run import ELSEWHERE, Run, open_run
from dynaviz.runs.stored_evidence import Question, Stored
from dynaviz.scores.result import Result
from dynaviz.sources.opening import Source
from dynaviz.sources.summary import summarize


def why(
    run: str | os.PathLike[str] | Result | Run,
    frame: int | None = None,
    point: int | None = None,
    *,
    case: int | None = None,
    near: Sequence[float] | None = None,
    again: bool = False,
    sequence: Source | None = None,
    threads: int | None = None,
    progress: Progress = silent,
) -> Why:
    """Explain the label of a point: which scans decided it, and the verdict.

    The recording of the run stores the evidence on the points of its cases, so these are answered
    at once. For any other point the run is repeated, which takes as long as the run; ``Why.note``
    says so.

    Args:
        run: a run's folder, ``result.json`` or ``run.rrd``; or a result, also of a run on arrays in
            this process.
        frame: position in the run, as in the recording and in failure cases.
        point: row in the scan of that frame.
        case: number of a case, 1 for the first: its middle point is explained.
        near: (x, y, z) metres, in the coordinates of the recording: the nearest point within 0.5 m
            is explained, of ``frame`` if that is given.
        again: repeat the run even if the recording has the answer.
        sequence: the run's sequence, open or as a path, if the data moved. A path is opened as the
            run opened it.
        threads: for kernels; None for all cores.
        progress: called with a phase, the number of frames done and their total.

    Raises:
        UsageError: for a frame, point, case or place that does not exist, an unknown method, or a
            run without a known sequence.
        DataError: for files that cannot be read, a different sequence, or if repeating the run
            gives different labels.
    """
    opened = run if isinstance(run, Run) else open_run(run)
    asked = Question(frame, point, case, None if near is None else (near[0], near[1], near[2]))
    stored = Stored(opened)
    found = stored.find(asked)
    if found.ledger is not None and not again:
        return stored.document(found.ledger, case, found.ledgers)
    if found.place is None:
        place = stored.place_in_sequence(asked, opened.sequence(sequence, progress))
    else:
        place = found.place
    answer = explain(
        opened, {place[0]: [place[1]]}, sequence=sequence, threads=threads, progress=progress
    )[place[0]][0]
    if stored.recorded and not again:
        note = "The run was repeated, because its recording has no evidence on this point."
        answer = dataclasses.replace(answer, note=f"{note} {answer.note}".strip())
    return answer


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
    stored = Stored(opened)
    facts = opened.result.method, info.title, spec.sequence.name, opened.result.online
    return {
        frame: tuple(
            Why(
                *facts,
                each,
                cause_at(opened.result, each),
                f"{note} {stored.doubt(each)}".strip(),
            )
            for each in map(stored.with_case, found)
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
