"""Finds results in folders, and combines results of several sequences by adding counts."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dynaviz.contracts import registry
from dynaviz.errors import DataError, DynavizError
from dynaviz.io.atomic import open_file
from dynaviz.io.lock import NAME, unfinished
from dynaviz.scores.result import Result, run_label
from dynaviz.scores.sections import Runtime, Sections, SequenceInfo

HINT = (
    "Give a folder with results in it, or the result.json of a run ('dynaviz run METHOD SEQ -o "
    "FOLDER' writes one)"
)


@dataclass(frozen=True)
class StudyRun:
    """One run of a study: its result, or its error.

    Attributes:
        file: its ``result.json`` or ``error.json``.
        result: None if the run failed.
        error: why the run failed; None if it did not.
        method, sequence, variant: what ran on what.
        given: the path given by the user under which it was found.
    """

    file: Path
    result: Result | None
    error: str | None
    method: str
    sequence: str
    variant: str
    given: Path

    @property
    def folder(self) -> Path:
        """The folder of its files."""
        return self.file.parent

    @property
    def label(self) -> str:
        """The method, and what distinguishes this run from its other runs."""
        return run_label(self.method, self.variant, self.result is not None and self.result.online)

    @property
    def recording(self) -> Path | None:
        """The recording of the run; None if it has none."""
        path = self.folder / "run.rrd"
        return path if path.is_file() else None


def collect(paths: Sequence[str | os.PathLike[str]]) -> list[StudyRun]:
    """Find all results and all failed runs of a bench in folders and their subfolders.

    Args:
        paths: folders, or ``result.json`` files of any name.

    Returns:
        One run per folder, sorted by folder within each path; a run under two of the paths is
        listed once.

    Raises:
        DataError: for a path that does not exist or contains no result, such as that of a killed
            run, and for a file that is not a result.
    """
    cells: dict[Path, StudyRun] = {}
    for given in map(Path, paths):
        found = list(_found(given))
        if not found:
            left = next(
                filter(None, (unfinished(file.parent) for file in sorted(given.rglob(NAME)))), None
            )
            raise left or DataError(
                given, "contains no result.json, and neither does any subfolder", hint=HINT
            )
        for file in found:
            cells.setdefault(file.resolve(), _cell(file, given))
    return list(cells.values())


def combined(results: Sequence[Result]) -> Result:
    """Combine the results of one method on several sequences.

    Each metric combines its own sections by adding counts.

    Args:
        results: at least one, of the same method and parameters.

    Raises:
        DynavizError: if they were scored in different ways.
    """
    first = results[0]
    if len({result.scoring for result in results}) > 1:
        raise DynavizError(
            "results of different scorings cannot be combined. Score all sequences the same way."
        )
    sections: dict[str, Any] = {}
    for metric in registry.loadable("metrics").values():
        if combine := getattr(metric, "combine", None):
            sections |= combine([result.sections.plain() for result in results])
    frames = sum(result.sequence.frames for result in results)
    points = sum(result.sequence.points for result in results)
    digest = "+".join(sorted(result.sequence.digest for result in results))
    return replace(
        first,
        sequence=SequenceInfo(f"all {len(results)}", digest, frames, points),
        sections=Sections.of(sections),
        runtime=_runtime([result.runtime for result in results]),
        labels_sha256=None,
        recording_sha256=None,
        record=None,
        instrumented=any(result.instrumented for result in results),
        command="",
    )


def _runtime(runtimes: Sequence[Runtime]) -> Runtime:
    """Mean and deviation over the frames of all sequences.

    Unknown if a map of another program is among them.
    """
    frames = 0
    seconds = 0.0
    squares = 0.0
    for runtime in runtimes:
        if runtime.frames is None or runtime.mean_s is None or runtime.std_s is None:
            return Runtime()
        frames += runtime.frames
        seconds += runtime.frames * runtime.mean_s
        squares += runtime.frames * (runtime.std_s**2 + runtime.mean_s**2)
    mean = seconds / frames
    square = squares / frames
    return Runtime(mean, math.sqrt(max(0.0, square - mean**2)), frames)


def _found(given: Path) -> Iterator[Path]:
    """The result or error file of each run; the result if a folder contains both."""
    if given.is_file():
        yield given
        return
    if not given.is_dir():
        raise DataError(given, "does not exist", hint=HINT)
    for folder in sorted(
        {file.parent for name in ("result.json", "error.json") for file in given.rglob(name)}
    ):
        result = folder / "result.json"
        yield result if result.is_file() else folder / "error.json"


def _cell(file: Path, given: Path) -> StudyRun:
    if file.name == "error.json":
        return _failed(file, given)
    result = Result.load(file)
    return StudyRun(file, result, None, result.method, result.sequence.name, result.variant, given)


def _failed(file: Path, given: Path) -> StudyRun:
    hint = "Remove it, or run its bench again"
    with open_file(file, hint) as content:
        try:
            facts = json.load(content)
            method, sequence, error = (str(facts[key]) for key in ("method", "sequence", "error"))
            variant = str(facts.get("variant") or "")
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            raise DataError(file, "does not state which run failed, and why", hint=hint) from None
    return StudyRun(file, None, error, method, sequence, variant, given)
