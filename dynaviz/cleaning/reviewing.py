"""Review a run: decide what is wrong, and write its map with the decisions, without running the
method.
"""

from __future__ import annotations

import dataclasses
import os
import warnings
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

from dynaviz.arrays import Bool
from dynaviz.cleaning.cleaned import Cleaned
from dynaviz.cleaning.doubt import doubt_in
from dynaviz.cleaning.followed import Reviewed
from dynaviz.cleaning.map_settings import MapSettings
from dynaviz.cleaning.trajectory import UsedPoses
from dynaviz.contracts.scan import Scan, stream
from dynaviz.contracts.sensors import Sensor
from dynaviz.engine.cleaned_map import Judgement, region_is_empty, write_maps
from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.progress import Progress, silent
from dynaviz.reviews.applying import Applied, seen_in
from dynaviz.reviews.candidates import Candidate, candidates
from dynaviz.reviews.decisions import VERDICTS, Decisions, ReviewDecision, Undo, Verdict
from dynaviz.reviews.regions import Region, Span
from dynaviz.reviews.survey import ReviewSurvey
from dynaviz.runs.reviewed import decisions_of
from dynaviz.runs.run import open_run
from dynaviz.scores.answers import RunAnswers
from dynaviz.scores.labels import reasons_by_frame
from dynaviz.sources.drive import Drive
from dynaviz.sources.opening import Source
from dynaviz.sources.sensing import estimate_sensor, sentence


def run_of(source: object) -> Path | None:
    """The folder of a run, if a source is one."""
    if not isinstance(source, str | os.PathLike):
        return None
    path = Path(source)
    path = path.parent if path.name == "result.json" else path
    return path if (path / "result.json").is_file() else None


class Review:
    """The decisions on a run, and its map with them.

    Args:
        run: its folder, ``result.json`` or ``run.rrd``.
        review: a file with decisions; None for ``review.json`` in the folder of the run, or the
            file that it followed. It need not exist yet.
        sequence: the run's sequence, if the data moved.
        progress: called while poses are refined again.

    Raises:
        DataError, UsageError: for a run, a sequence or decisions that cannot be read.
    """

    def __init__(
        self,
        run: str | os.PathLike[str],
        review: str | os.PathLike[str] | None = None,
        sequence: Source | None = None,
        progress: Progress = silent,
    ) -> None:
        self._run = open_run(run)
        self._run.file("labels.npz")
        self._decisions = decisions_of(self._run) if review is None else Decisions(review)
        self._sequence = self._run.sequence(sequence, progress)

    def __repr__(self) -> str:
        return f"<Review of {self._run.folder}: {len(self.decisions)} decisions in {self.file}>"

    @property
    def file(self) -> Path:
        """The file with the decisions."""
        return self._decisions.path

    @property
    def history(self) -> tuple[ReviewDecision | Undo, ...]:
        """All entries, in the order in which they were made."""
        return Decisions(self.file).entries

    @property
    def decisions(self) -> tuple[ReviewDecision, ...]:
        """The decisions that hold, in order."""
        return Decisions(self.file).standing

    @property
    def labels(self) -> list[Bool]:
        """The labels with the decisions.

        (N,) bool for each frame by position, True for removed points.
        """
        applied = Applied.to(self._sequence, Decisions(self.file))
        labels = self._run.labels
        return [
            applied.answers(self._sequence[position], labels[position])[0]
            for position in range(len(self._sequence))
        ]

    @property
    def sequence(self) -> Drive:
        """The sequence of the run."""
        return self._sequence

    def survey(self, progress: Progress = silent) -> ReviewSurvey:
        """All points of the run and its candidates, in memory.

        Args:
            progress: called with a phase, the number of frames done and their total.
        """
        labels = self._run.labels
        total = len(self._sequence)
        self._check_labels(len(labels))
        points = sum(map(len, labels))

        def scans() -> Iterator[Scan]:
            for done, scan in enumerate(stream(self._sequence), 1):
                yield scan
                progress("looking for places", done, total)

        return ReviewSurvey(scans(), labels, self._sequence.origin, points)

    @cached_property
    def candidates(self) -> tuple[Candidate, ...]:
        """The places that are worth a decision, found without ground truth.

        The one that is expected to change most is first.

        Raises:
            DataError: for labels of another sequence.
        """
        labels = self._run.labels
        self._check_labels(len(labels))
        return candidates(stream(self._sequence), labels, self._sequence.origin)

    def _check_labels(self, frames: int) -> None:
        if frames != len(self._sequence):
            total = len(self._sequence)
            problem = f"has labels for {frames} frames, {self._sequence.name} has {total}"
            file = self._run.file("labels.npz")
            raise DataError(file, problem, hint="Give the sequence of the run")

    def decide(
        self,
        about: Region | Candidate,
        verdict: Verdict,
        *,
        span: Span | None = None,
        what: str = "",
        reason: str = "",
        reviewer: str = "",
    ) -> ReviewDecision:
        """Decide what a part of the world is, and add it to the file.

        Args:
            about: a candidate, or a region, metres and times of the source.
            verdict: ``static``, ``dynamic`` or ``undecided``.
            span: when; None for the frames of an object, and all times of other regions.
            what: the part in a few words.
            reason, reviewer: why, and who decided.

        Raises:
            UsageError: for an unknown verdict or an empty region.
            DataError: if the file is damaged or cannot be written.
        """
        if verdict not in VERDICTS:
            raise UsageError(f"verdict {verdict}: choose from {', '.join(VERDICTS)}")
        result = self._run.result
        key = ""
        answered = ""
        if isinstance(about, Candidate):
            key = about.key
            answered = about.answered
            what = what or about.title
            about = about.region
        made = ReviewDecision(
            verdict, about, span, what=what, reason=reason, reviewer=reviewer,
            key=key, answered=answered,
            by=f"{result.method} on {result.sequence.name}", seen=seen_in(self._sequence, 0),
        )  # fmt: skip
        return self._decisions.add(made)

    def undo(self, id_: str | None = None, *, reviewer: str = "") -> ReviewDecision:
        """Take the last decision back, or one by its id.

        Raises:
            UsageError: if there is none.
        """
        return self._decisions.undo(id_, reviewer)

    def write(
        self,
        out: str | os.PathLike[str],
        *,
        region: str | None = None,
        voxel_size: float | None = None,
        keep_dynamic: str | os.PathLike[str] | None = None,
        mark: bool = False,
        drop_unposed: bool = False,
        command: str = "",
        progress: Progress = silent,
    ) -> Cleaned:
        """Write the map with the decisions.

        Attributes, coordinates, tiles and marks are those of the first map, if the run wrote one.

        Args:
            out: the map, as for ``dynaviz.clean``.
            region, voxel_size, keep_dynamic, mark, drop_unposed: as for ``dynaviz.clean``; those
                that are left out are as they were for the first map.
            command, progress: as for ``dynaviz.run``.

        Returns:
            What was done. The summary in the folder of the run is written again.

        Raises:
            UsageError, DataError: as ``dynaviz.clean``; also for labels of another sequence.
        """
        saved = self._run
        folder = saved.folder or Path()
        earlier = MapSettings.load(folder) or MapSettings("")
        settings = earlier.like(
            Path(out), region=region, voxel_size=voxel_size,
            keep_dynamic=None if keep_dynamic is None else os.fspath(keep_dynamic),
            mark=mark, drop_unposed=drop_unposed,
        )  # fmt: skip
        files = settings.files(reviewed=True)
        opened = self._sequence
        if (limit := files[0].region) is not None and region_is_empty(opened, limit):
            hint = "Give it in the coordinates of the map: 'dynaviz info' shows their extent"
            raise UsageError(f"--region {region}: contains no point of {opened.name}. {hint}")
        labels = saved.labels
        self._check_labels(len(labels))
        reviewed = Reviewed.of(opened, Decisions(self.file))
        reasons = reasons_by_frame(saved.file("labels.npz"), labels) if settings.mark else None
        followed = UsedPoses(opened)
        check = _SamePoints(opened, saved.file("labels.npz"), [len(each) for each in labels])

        def seen(scan: Scan) -> None:
            check.add(scan)
            followed.add(scan)

        judgement = Judgement(labels, reasons, reviewed.applied)
        maps, account = write_maps(opened, judgement, files, progress, settings.drop_unposed, seen)
        if text := reviewed.applied.by_hand.warning(self.file):
            warnings.warn(text, stacklevel=2)
        trajectory = folder / "trajectory.csv"
        written = trajectory.is_file() or followed.write(trajectory)
        result = dataclasses.replace(saved.result, answers=RunAnswers(opened, labels, folder))
        estimated = bool(saved.result.origin and saved.result.origin.odometry)
        cleaned = Cleaned(
            result=result,
            account=account,
            maps=tuple(maps),
            folder=folder,
            poses=None,
            facts=opened.facts,
            sensor=_sensor(opened),
            doubt=doubt_in(result, account, opened, command, Path(out), not estimated),
            trajectory=trajectory if written else None,
            marked=settings.mark,
            review=reviewed,
        )
        settings.save(folder)
        write_atomic(folder / "summary.md", cleaned.markdown().encode())
        return cleaned


def review(
    run: str | os.PathLike[str],
    *,
    review: str | os.PathLike[str] | None = None,
    sequence: Source | None = None,
    progress: Progress = silent,
) -> Review:
    """Review a run: the places worth a decision, decisions, and the map with them.

    Args:
        run: its folder, ``result.json`` or ``run.rrd``.
        review: a file with decisions; None for that of the run.
        sequence: the run's sequence, if the data moved.
        progress: called while poses are refined again.

    Returns:
        ``candidates``, ``decide``, ``undo``, ``labels``, ``write`` and ``history``.

    Raises:
        DataError, UsageError: for a run, a sequence or decisions that cannot be read.
    """
    return Review(run, review, sequence, progress)


def _sensor(opened: Drive) -> str:
    known = opened.sensor.name != Sensor().name
    return "" if known else sentence(estimate_sensor(opened))


class _SamePoints:
    """Checks that each scan has as many points as the labels."""

    def __init__(self, sequence: Drive, file: Path, points: list[int]) -> None:
        self._name = sequence.name
        self._file = file
        self._points = points
        self._next = 0

    def add(self, scan: Scan) -> None:
        expected = self._points[self._next]
        self._next = self._next + 1
        if len(scan) != expected:
            problem = f"has {expected} labels for frame {scan.index}, which has {len(scan)} points"
            raise DataError(
                self._file, problem, hint=f"{self._name} is another sequence: give that of the run"
            )
