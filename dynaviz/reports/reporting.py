"""Reports on many results, in any installed format."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dynaviz.arrays import F32, U8
from dynaviz.contracts import registry
from dynaviz.contracts.protocol import EvaluationProtocol, ProtocolScores
from dynaviz.errors import UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.progress import Progress, silent
from dynaviz.scores.collect import HINT, StudyRun, collect

SUFFIXES = {"htm": "html", "markdown": "md", "tex": "latex"}  # in addition to the names of formats


@dataclass(frozen=True, slots=True, eq=False)
class StudyOverview:
    """The thinned map of a whole run, with its wrong points.

    Attributes:
        points: (N, 3) float32, metres, world frame.
        outcome: (N,) uint8, an ``Outcome`` per point.
    """

    points: F32
    outcome: U8


@dataclass(frozen=True)
class Study:
    """The input of a report.

    Attributes:
        runs: in the order of their folders.
        home: the folder of the report; links are relative to it.
        progress: called with a phase, the number of finished steps, and the total number of steps.
        protocols: by name; only for a board.
        scores: of each run by the name of the protocol, by the run's file; only for a board.
        remarks: why a run has no such scores, by the run's file.
        columns: names of the columns that tables in Markdown and LaTeX keep, in addition to the
            first; empty for all.
    """

    runs: Sequence[StudyRun]
    home: Path = Path()
    progress: Progress = silent
    protocols: Mapping[str, type[EvaluationProtocol]] = field(default_factory=dict)
    scores: Mapping[Path, Mapping[str, ProtocolScores]] = field(default_factory=dict)
    remarks: Mapping[Path, str] = field(default_factory=dict)
    columns: Sequence[str] = ()

    def link(self, path: Path) -> str:
        """A path relative to the report, with forward slashes."""
        return Path(os.path.relpath(path, self.home)).as_posix()

    def overview(self, run: StudyRun) -> StudyOverview | None:
        """The map of a run from its recording; None if it has no recording, or one without points.

        Raises:
            DataError: for a recording that cannot be read.
        """
        if run.recording is None:
            return None
        from dynaviz.views import classes, paths
        from dynaviz.views.read.reader import RunRecording

        recording = RunRecording(run.recording)
        parts = [
            recording.static(path)
            for path in (paths.MAP, paths.REMOVED, paths.REMOVED_WRONG, paths.MAP_WRONG)
        ]
        drawn = [part for part in parts if "Points3D:positions" in part]
        if not drawn:
            return None
        return StudyOverview(
            np.concatenate([part["Points3D:positions"] for part in drawn]),
            np.concatenate([classes.outcomes(part["Points3D:class_ids"]) for part in drawn]),
        )


def report(
    *paths: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    format: str | None = None,
    columns: Sequence[str] = (),
    progress: Progress = silent,
) -> str:
    """Write a report on one or many results: tables and figures.

    Args:
        paths: folders that contain results, or ``result.json`` files.
        out: the file to write, or None.
        format: ``html``, ``md``, ``latex``, ``csv`` or another installed format (entry point group
            ``dynaviz.reports``). Default: the format of the suffix of ``out``, or ``md`` without
            ``out``.
        columns: for ``md`` and ``latex``: names of the columns to keep, such as ``SA`` and ``AA``,
            in addition to the first; a table that has none of them keeps all.
        progress: called with a phase, the number of finished steps, and the total number of steps.

    Returns:
        The report.

    Raises:
        UsageError: without paths, or for a format that is not installed.
        DataError: for paths without results, and for files that cannot be read or written.
    """
    if not paths:
        raise UsageError(f"no results. {HINT}")
    render = registry.load("reports", format or _format(out))
    home = Path() if out is None else Path(out).parent
    text: str = render(Study(collect(paths), home, progress, columns=columns))
    if out is not None:
        write_atomic(out, text.encode())
    return text


def _format(out: str | os.PathLike[str] | None) -> str:
    """The format of a file's suffix."""
    if out is None:
        return "md"
    suffix = Path(out).suffix.lower().removeprefix(".")
    known = [handle.name for handle in registry.handles("reports")]
    name = SUFFIXES.get(suffix, suffix)
    if name not in known:
        raise UsageError(
            f"{os.fspath(out)}: the suffix does not name a format. Give --format {'|'.join(known)}"
        )
    return name
