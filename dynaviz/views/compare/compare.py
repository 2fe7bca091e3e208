"""Compare recordings of the same points.

Open and check them, count agreement, and write a merged recording.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from dynaviz.arrays import U8
from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import sha256
from dynaviz.progress import Progress, silent
from dynaviz.scores.comparison.counts import (
    PLACE,
    AgreementCounts,
    SpatialCells,
    SpatialGains,
    count_agreement,
    spatial_gains,
)
from dynaviz.scores.comparison.pair import (
    ComparedRun,
    PairComparison,
    ReasonNames,
    Scores,
    compare_pair,
    run_scores,
)
from dynaviz.scores.comparison.settings import names
from dynaviz.scores.comparison.summary import Comparison
from dynaviz.scores.result import Result
from dynaviz.views.read.reader import RunRecording

LETTERS = "ABCDEFGH"
FINE = 1.0  # metres: edge of the cells that are drawn


class Compared:
    """Runs on the same points, compared from their recordings; the data set is not needed.

    Args:
        recordings: two or more, at most one for each of ``LETTERS``; each is compared with the
            first.
        out: where a recording will be written that shows them side by side; None if none will.
        progress: called with a phase, the number of recordings done, and their total number.
        truths: another ground truth for the points of all runs: (N,) uint8, a ``Label`` per point,
            by position of the frame.

    Attributes:
        recordings: the opened ones, with this ground truth.
        comparison: what they differ in.

    Raises:
        UsageError: for fewer than two recordings, too many, or an ``out`` that is one of them.
        DataError: for a recording that cannot be read, of an unfinished run, without ground truth,
            or of other points than the first.
    """

    def __init__(
        self,
        recordings: Sequence[str | os.PathLike[str]],
        out: str | os.PathLike[str] | None = None,
        progress: Progress = silent,
        truths: Mapping[int, U8] | None = None,
    ) -> None:
        self.recordings = opened = _open(recordings, out)
        for recording in opened:
            recording.correct(truths or {})
        results = [_result(recording) for recording in opened]
        unscored = _leave_out_unanswered(opened, results)
        self._counts = counts = _count(opened, progress)
        self._out = out
        self._total = counts[0].points.sum(1)
        self._places = places = _cells(opened, progress)
        pairs = []
        for i in range(1, len(opened)):
            gains = spatial_gains(places[0][0], places[i][0], self._total) if places else None
            pairs.append(_pair(i, opened, results, counts[i - 1], gains))
        labels = names(results, [recording.path for recording in opened])
        runs = [
            _run(i, name, opened[i], results[i], _scores(counts, i))
            for i, name in enumerate(labels)
        ]
        self.comparison = Comparison(results[0].sequence, tuple(runs), tuple(pairs), unscored)

    def write(self, progress: Progress = silent) -> None:
        """Write the recording, if there shall be one."""
        if self._out is not None:
            from dynaviz.views.compare import merge

            places = self._places
            total = self._total
            fine: list[SpatialGains] = [
                spatial_gains(places[0][1], other[1], total) for other in places[1:]
            ]
            merge.write(
                Path(self._out), self.recordings, self.comparison, self._counts, fine, progress
            )


def _open(
    paths: Sequence[str | os.PathLike[str]], out: str | os.PathLike[str] | None
) -> list[RunRecording]:
    if not 2 <= len(paths) <= len(LETTERS):
        raise UsageError(
            f"{len(paths)} recording(s) given: compare takes 2 to {len(LETTERS)} of the same "
            "sequence"
        )
    if out is not None and any(Path(out).resolve() == Path(path).resolve() for path in paths):
        raise UsageError(f"-o {out} is one of the recordings to compare. Choose another name")
    opened = [RunRecording(path) for path in paths]
    first = opened[0].properties
    for recording in opened:
        p = recording.properties
        if not recording.complete:
            hint = "Run it again" + (f" with: {p['command']}" if p.get("command") else "")
            raise DataError(recording.path, "contains an unfinished run", hint=hint)
        if p["digest"] != first["digest"]:
            problem = (
                f"is from a different sequence than {opened[0].path}: {_data(p)} instead of "
                f"{_data(first)}"
            )
            raise DataError(
                recording.path, problem, hint="Run both on the same sequence and --frames"
            )
    return opened


def _data(p: dict[str, Any]) -> str:
    return f"{p['sequence']}, {p['frames']} frames, digest {p['digest'][:12]}"


def _result(recording: RunRecording) -> Result:
    if recording.result is None:  # unfinished runs were refused before
        raise DataError(recording.path, "contains no result", hint="Run it again")
    return recording.result


def _leave_out_unanswered(
    opened: Sequence[RunRecording], results: Sequence[Result]
) -> tuple[int, ...]:
    """Leave out the frames that a run has no answer for, so that all runs are scored on the same
    points.
    """
    unanswered = {
        frame
        for result in results
        if (s := result.sections.source)
        for frame in s.unanswered_frames
    }
    for recording in opened:
        recording.leave_out(unanswered)
    return tuple(sorted(unanswered))


def _count(opened: Sequence[RunRecording], progress: Progress) -> list[AgreementCounts]:
    """Agreement of the first run with each other."""
    counts = []
    for done, other in enumerate(opened[1:], 1):
        try:
            counts.append(count_agreement(opened[0].answers(), other.answers()))
        except ValueError as error:
            problem = f"does not contain the same points as {opened[0].path} ({error})"
            raise DataError(other.path, problem, hint="Run both methods again") from error
        progress("answers", done, len(opened) - 1)
    return counts


def _cells(
    opened: Sequence[RunRecording], progress: Progress
) -> list[tuple[SpatialCells, SpatialCells]]:
    """Wrong points of each run by place, and by the smaller cells that are drawn.

    Empty without coordinates.
    """
    if any(recording.properties["mode"] == "scores" for recording in opened):
        return []
    cells = []
    for done, recording in enumerate(opened, 1):
        coarse = SpatialCells()
        fine = SpatialCells(FINE)
        for drawn in recording.drawn():
            coarse.add(drawn.frame, drawn.xyz, drawn.outcome, drawn.stands_for)
            fine.add(drawn.frame, drawn.xyz, drawn.outcome, drawn.stands_for)
        cells.append((coarse, fine))
        progress("places", done, len(opened))
    return cells


def _pair(
    i: int,
    opened: Sequence[RunRecording],
    results: Sequence[Result],
    counts: AgreementCounts,
    gains: SpatialGains | None,
) -> PairComparison:
    first = opened[0]
    second = opened[i]
    return compare_pair(
        (LETTERS[0], LETTERS[i]),
        (results[0], results[i]),
        counts,
        (_reason_names(first), _reason_names(second)),
        gains,
        _note(first, second),
    )


def _reason_names(recording: RunRecording) -> ReasonNames:
    return {code: reason.name for code, reason in enumerate(recording.reasons)}


def _note(first: RunRecording, second: RunRecording) -> str:
    for recording in (first, second):
        if recording.properties["mode"] == "scores":
            return f"none: {recording.path} contains no coordinates (--record scores)"
    return f"Columns of {PLACE:g} m; x, y: lower corner; frame: where the place changes most"


def _scores(counts: Sequence[AgreementCounts], i: int) -> Scores:
    """The scores of a run: the first run is in each pair, any other in its own."""
    return run_scores(counts[max(i - 1, 0)].points)[min(i, 1)]


def _run(i: int, name: str, recording: RunRecording, result: Result, scores: Scores) -> ComparedRun:
    ceiling = result.sections.ceiling
    return ComparedRun(
        letter=LETTERS[i],
        name=name,
        path=os.fspath(recording.path),
        sha256=sha256(recording.path),
        method=result.method,
        title=recording.properties["title"],
        mode=recording.properties["mode"],
        scoring=result.scoring,
        online=result.online,
        seed=result.seed,
        parameters=result.parameters,
        scores=scores,
        runtime=result.runtime,
        instrumented=result.instrumented,
        command=result.command,
        ceiling=None if ceiling is None else msgspec.structs.replace(ceiling, objects=()),
    )
