"""The only place that opens a run.

Its result, labels and recording, its sequence, and the run again.
"""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from dynaviz.contracts import registry
from dynaviz.contracts.scan import Sequence
from dynaviz.engine.external import PrecomputedLabels
from dynaviz.engine.loop import RunSpec
from dynaviz.engine.needs import suited
from dynaviz.errors import DataError, UsageError
from dynaviz.progress import Progress, silent
from dynaviz.scores.answers import RunAnswers
from dynaviz.scores.labels import RunLabels
from dynaviz.scores.result import Result
from dynaviz.sources.drive import Drive
from dynaviz.sources.opening import Source, open_source, reopened
from dynaviz.sources.options import SequenceOptions

if TYPE_CHECKING:
    from dynaviz.views.read.reader import RunRecording

ELSEWHERE = "Give the sequence of the run: --sequence PATH, or sequence= in Python"
_FINISHED = "Give the folder of a finished run, its result.json or run.rrd"


class Run:
    """A run: what it found, what it ran on, and how to repeat it.

    Attributes:
        result: what it found.
        path: the file that the result was read from; ``result.json`` without a folder for a run in
            this process.
        folder: with its files; None for a run in this process that wrote none.
    """

    def __init__(self, result: Result, path: Path, folder: Path | None) -> None:
        self.result = result
        self.path = path
        self.folder = folder

    def file(self, name: str) -> Path:
        """One of its files.

        Raises:
            DataError: if it does not exist.
        """
        if self.folder is None:
            raise UsageError(f"the run has no folder with {name}. Give out=FOLDER to dynaviz.run")
        if not (path := self.folder / name).is_file():
            raise DataError(path, "does not exist", hint=_FINISHED)
        return path

    @property
    def recording_file(self) -> Path:
        """The file of its recording.

        Raises:
            DataError: if it was not recorded.
        """
        answers = self.result.answers
        if isinstance(answers, RunAnswers) and answers.recording is not None:
            return answers.recording
        if self.path.suffix == ".rrd":
            return self.path
        if self.folder is None:
            raise UsageError(
                "the run was not recorded. Give out=FOLDER or record=FILE.rrd to dynaviz.run"
            )
        if not (path := self.folder / "run.rrd").is_file():
            raise DataError(
                path, "does not exist", hint="Give a run that was recorded, without --record none"
            )
        return path

    @cached_property
    def recording(self) -> RunRecording:
        """Its recording."""
        from dynaviz.views.read.reader import RunRecording

        return RunRecording(self.recording_file)

    @property
    def labels(self) -> RunLabels:
        """Its labels by position of the frame.

        Raises:
            DataError: if ``labels.npz`` is missing or damaged.
        """
        answers = self.result.answers
        return (
            answers.labels
            if isinstance(answers, RunAnswers)
            else RunLabels.load(self.file("labels.npz"))
        )

    @property
    def labeller(self) -> PrecomputedLabels:
        """Its stored labels as a labeller, which knows their reasons and the frames that they are
        for.
        """
        return PrecomputedLabels(self.file("labels.npz"), self.result.method)

    def sequence(self, at: Source | None = None, progress: Progress = silent) -> Drive:
        """The frames of the run with its poses and sensor, bit for bit.

        Args:
            at: an open sequence, or the path of the data if they moved; None for where the run
                found them.
            progress: called while poses are refined again, because their file is missing.

        Raises:
            UsageError: for a run of data in memory, or of an earlier version, without ``at``.
            DataError: for data that cannot be read.
        """
        origin = self.result.origin
        answers = self.result.answers
        found = answers.sequence if at is None and isinstance(answers, RunAnswers) else at
        if isinstance(found, Sequence):
            return Drive.of(found)
        if origin is None:
            if at is None:
                raise UsageError(
                    f"{self.path}: the run does not state where its sequence came from. {ELSEWHERE}"
                )
            return open_source(at, SequenceOptions())
        if at is None and not origin.sources:
            problem = (
                "the run was made from data in memory, which only the process that made it can "
                "open again"
            )
            raise UsageError(
                f"{self.path}: {problem}: call dynaviz.explore(result) there. {ELSEWHERE}"
            )
        try:
            return reopened(
                origin, self.folder, at if isinstance(at, str | os.PathLike) else None, progress
            )
        except DataError as error:
            if at is not None:
                raise
            raise DataError(error.path, error.problem, at=error.at, hint=ELSEWHERE) from None

    def spec(self, sequence: Drive, threads: int | None = None) -> RunSpec:
        """The run again, on its sequence, without metrics.

        Labels of another program are read from the run's files.

        Raises:
            UsageError: for a method that is not installed, or has other parameters by now.
        """
        result = self.result
        if result.sections.source is not None:
            labels = self.labeller
            return RunSpec(labels, sequence, labels.params, threads=threads)
        kind = registry.load("methods", result.method)
        parameters = self.parameters(kind)
        sequence = suited(kind, parameters, sequence)
        return RunSpec(
            kind(parameters), sequence, parameters, (), result.online, result.seed, threads=threads
        )

    def parameters(self, kind: type[Any]) -> Any:
        """Its parameters, as an instance of the method's ``Params``.

        Raises:
            UsageError: if the method has other parameters by now.
        """
        try:
            return msgspec.convert(self.result.parameters, kind.Params)
        except (msgspec.ValidationError, ValueError) as error:
            name = self.result.method
            raise UsageError(
                f"{self.path}: {name} has other parameters than the run: {error}. Run it again"
            ) from None


def open_run(run: str | os.PathLike[str] | Result) -> Run:
    """Open a run.

    Args:
        run: its folder, ``result.json`` or ``run.rrd``; or a result.

    Raises:
        DataError: if there is no result, or the run did not finish.
    """
    if isinstance(run, Result):
        folder: Path | None = getattr(run.answers, "folder", None)
        return Run(run, Path("result.json") if folder is None else folder / "result.json", folder)
    path = Path(run)
    if path.is_dir():
        path = next(
            (path / name for name in ("result.json", "run.rrd") if (path / name).is_file()), path
        )
        if path.is_dir():
            raise DataError(
                path,
                "contains no result.json and no run.rrd",
                hint="Give the folder of a finished run",
            )
    if path.suffix != ".rrd":
        return Run(Result.load(path), path, path.parent)
    from dynaviz.views.read.reader import RunRecording

    recording = RunRecording(path)
    if recording.result is None:
        raise DataError(
            path, "is the recording of a run that did not finish", hint="Run the method again"
        )
    found = Run(recording.result, path, path.parent)
    found.__dict__["recording"] = recording
    return found
