"""Compare recordings of the same points: open them, refuse what does not compare, count, and draw."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dynaviz.comparison.counts import (
    PLACE,
    AgreementCounts,
    SpatialCells,
    SpatialGains,
    compare_pair,
    count_agreement,
    run_scores,
    spatial_gains,
)
from dynaviz.comparison.summary import Comparison, differences, names, runtimes
from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import sha256
from dynaviz.progress import Progress, silent
from dynaviz.results.result import Result
from dynaviz.viz.reader import RunRecording

LETTERS = "ABCDEFGH"
FINE = 1.0  # metres: edge of the cells that are drawn


def compare(
    recordings: Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str] | None = None,
    progress: Progress = silent,
) -> Comparison:
    """Compare recordings of runs on the same points; the data set is not needed.

    Args:
        recordings: two or more, at most one for each of ``LETTERS``; each is compared with the first.
        out: where to write a recording that shows them side by side; None writes none.
        progress: called with a phase, and how many recordings of how many are done.

    Raises:
        UsageError: for fewer than two recordings, too many, or an ``out`` that is one of them.
        DataError: for a recording that cannot be read, of a run that was not finished, without ground truth, or of
            other points than the first.
    """
    opened = _open(recordings, out)
    results = [_result(recording) for recording in opened]
    crossed = []
    for done, other in enumerate(opened[1:], 1):
        crossed.append(_cross(opened[0], other))
        progress("answers", done, len(opened) - 1)
    total = crossed[0].points.sum(1)
    if not total.sum():
        raise DataError(opened[0].path, "has no labelled point to compare", hint="Run on a sequence with ground truth")
    blind = [recording for recording in opened if recording.properties["mode"] == "scores"]
    places: list[tuple[SpatialCells, SpatialCells]] = []
    for done, recording in enumerate([] if blind else opened, 1):
        places.append(_places(recording))
        progress("places", done, len(opened))
    pairs = []
    for i, this in enumerate(crossed, 1):
        where = spatial_gains(places[0][0], places[i][0], total) if places else None
        pair = compare_pair(this, where, (_legend(opened[0]), _legend(opened[i])))
        about = {"first": LETTERS[0], "second": LETTERS[i]}
        settings = {"differ": differences(results[0], results[i]), "runtime": runtimes(results[0], results[i])}
        pairs.append({**about, **pair, "places_note": _note(opened[0], opened[i]), **settings})
    runs = [
        _run(*what, _side(crossed, i))
        for i, what in enumerate(zip(LETTERS, names(results, [r.path for r in opened]), opened, results, strict=False))
    ]
    comparison = Comparison(dict(results[0].sequence), runs, pairs)
    if out is not None:
        from dynaviz.viz import merge

        fine: list[SpatialGains] = [spatial_gains(places[0][1], other[1], total) for other in places[1:]]
        merge.write(Path(out), opened, comparison, crossed, fine, progress)
    return comparison


def _open(paths: Sequence[str | os.PathLike[str]], out: str | os.PathLike[str] | None) -> list[RunRecording]:
    if not 2 <= len(paths) <= len(LETTERS):
        raise UsageError(f"{len(paths)} recording(s) given: compare takes 2 to {len(LETTERS)} of the same sequence")
    if out is not None and any(Path(out).resolve() == Path(path).resolve() for path in paths):
        raise UsageError(f"-o {out} is one of the recordings to compare. Choose another name")
    opened = [RunRecording(path) for path in paths]
    first = opened[0].properties
    for recording in opened:
        p = recording.properties
        if not recording.complete:
            hint = "Run it again" + (f" with: {p['command']}" if p.get("command") else "")
            raise DataError(recording.path, "holds a run that was not finished", hint=hint)
        if not p["has_labels"]:
            hint = "Run on a sequence with ground truth"
            raise DataError(recording.path, "has no ground truth, so that nothing is right or wrong", hint=hint)
        if p["digest"] != first["digest"]:
            problem = f"is of other points than {opened[0].path}: {_data(p)} instead of {_data(first)}"
            raise DataError(recording.path, problem, hint="Run both on the same sequence and --frames")
    return opened


def _data(p: dict[str, Any]) -> str:
    return f"{p['sequence']}, {p['frames']} frames, digest {p['digest'][:12]}"


def _result(recording: RunRecording) -> Result:
    if recording.result is None:  # told apart before; a run that is finished has one
        raise DataError(recording.path, "holds no result", hint="Run it again")
    return recording.result


def _cross(first: RunRecording, second: RunRecording) -> AgreementCounts:
    try:
        return count_agreement(first.answers(), second.answers())
    except ValueError as error:
        problem = f"does not hold the same points as {first.path} ({error})"
        raise DataError(second.path, problem, hint="Run both methods again") from error


def _places(recording: RunRecording) -> tuple[SpatialCells, SpatialCells]:
    named, fine = SpatialCells(), SpatialCells(FINE)
    for drawn in recording.drawn():
        for places in (named, fine):
            places.add(drawn.frame, drawn.xyz, drawn.outcome, drawn.stands_for)
    return named, fine


def _side(crossed: Sequence[AgreementCounts], i: int) -> dict[str, float | None]:
    """The scores of a run: the first's are in each pair, another's in its own."""
    return run_scores(crossed[max(i - 1, 0)].points)[min(i, 1)]


def _legend(recording: RunRecording) -> dict[int, str]:
    return {code: reason.name for code, reason in enumerate(recording.reasons)}


def _note(first: RunRecording, second: RunRecording) -> str:
    for recording in (first, second):
        if recording.properties["mode"] == "scores":
            return f"none: {recording.path} holds no coordinates (--record scores)"
    return f"columns of {PLACE:g} m by their lower corner, and the frame that changes each most"


def _run(
    letter: str, name: str, recording: RunRecording, result: Result, found: dict[str, float | None]
) -> dict[str, Any]:
    return {
        "letter": letter,
        "name": name,
        "path": os.fspath(recording.path),
        "sha256": sha256(recording.path),
        "method": result.method,
        "title": recording.properties["title"],
        "mode": recording.properties["mode"],
        "scoring": result.scoring,
        "online": result.online,
        "seed": result.seed,
        "parameters": result.parameters,
        "scores": found,
        "runtime": result.runtime,
        "instrumented": result.instrumented,
        "command": result.command,
    }
