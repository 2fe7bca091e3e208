"""The decisions of a person in a run: whose they are, and what they do to it."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynaviz.arrays import U8
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Label, Scan, outcomes, stream
from dynaviz.engine.loop import Listener
from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import open_file, sha256
from dynaviz.progress import Progress, silent
from dynaviz.reviews.applying import Applied
from dynaviz.reviews.decisions import FILE, Decisions
from dynaviz.runs.rescore import rescore
from dynaviz.runs.run import Run, open_run
from dynaviz.scores.scores import SCORES, Counts
from dynaviz.scores.sections import ReviewSection
from dynaviz.sources.drive import Drive
from dynaviz.sources.opening import Source


def decisions_of(run: Run, review: str | os.PathLike[str] | None = None) -> Decisions:
    """The decisions that a run follows.

    Args:
        run: with a folder.
        review: a file with decisions instead; it must exist.

    Raises:
        DataError: for a file that cannot be read, or that the run followed and that is gone.
    """
    if review is not None:
        return Decisions.existing(review)
    section = run.result.sections.review
    folder = run.folder or Path()
    if section is None or not section.file:
        return Decisions(folder / FILE)
    file = Path(section.file)
    if not file.is_file() and (folder / FILE).is_file():
        return Decisions(folder / FILE)
    if not file.is_file():
        hint = "Give the decisions with --review FILE"
        raise DataError(file, f"does not exist, whose decisions {run.path} follows", hint=hint)
    return Decisions(file)


def digest_of(file: str | os.PathLike[str]) -> str:
    """SHA-256 digest of a file with decisions; empty without one.

    Raises:
        DataError: if it cannot be read.
    """
    if not Path(file).is_file():
        return ""
    with open_file(file, "Give another file with --review"):
        return sha256(file)


class ReviewOfRun(Listener):
    """Counts what decisions change in the answers of a run.

    Args:
        decisions: the file.
        sequence: of the run.
        makes_truth: as for ``Applied``.

    Attributes:
        applied: for the ground truth and the maps of the run.

    Raises:
        DataError: for decisions of another world frame.
    """

    def __init__(self, decisions: Decisions, sequence: Drive, makes_truth: bool = False) -> None:
        self._file = decisions.path
        self._digest = digest_of(decisions.path)
        self.applied = Applied.to(sequence, decisions, makes_truth)
        self._counted = Applied.to(sequence, decisions, makes_truth)
        self._counts = Counts()

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Count a frame."""
        scan = labelled.scan
        dynamic, _ = self._counted.answers(scan, labelled.dynamic)
        self._counts += Counts.of(outcomes(scan.labels, dynamic))

    def sections(self) -> Mapping[str, ReviewSection]:
        """The section of the result, with a warning of decisions that match nothing."""
        by_hand = self._counted.by_hand
        if text := by_hand.warning(self._file):
            warnings.warn(text, stacklevel=2)
        metrics = self._counts.metrics()
        found = ReviewSection(
            os.path.abspath(self._file),
            self._digest,
            len(self._counted),
            len(by_hand.unmatched),
            by_hand.kept,
            by_hand.removed,
            {name: metrics[name] for name in SCORES},
        )
        return {"review": found}


@dataclass(frozen=True)
class ReviewedScores:
    """Scores of a run before and after the decisions.

    Attributes:
        before, after: SA, DA, AA and HA in percent against the ground truth as it is, and as the
            decisions state it; None where undefined.
        decisions: how many hold.
        points: how many points got another truth.
    """

    before: Mapping[str, float | None]
    after: Mapping[str, float | None]
    decisions: int
    points: int

    def __str__(self) -> str:
        def change(name: str) -> str:
            values = (
                "n/a" if each[name] is None else f"{each[name]:.2f}"
                for each in (self.before, self.after)
            )
            return f"{name} {' -> '.join(values)}"

        scores = ", ".join(map(change, ("AA", "SA", "DA")))
        many = f"{self.decisions} decision{'' if self.decisions == 1 else 's'}"
        return f"{scores} against the ground truth with {many} ({self.points:,} points changed)."


def reviewed_scores(
    run: str | os.PathLike[str],
    sequence: Source | None = None,
    review: str | os.PathLike[str] | None = None,
    progress: Progress = silent,
) -> ReviewedScores:
    """Score the stored labels of a run against the ground truth that decisions state.

    The run's files stay as they are.

    Args:
        run: its folder, ``result.json`` or ``run.rrd``.
        sequence: the run's sequence, if the data moved.
        review: the decisions; None for those of the run.
        progress: called while poses are refined again.

    Raises:
        DataError: for files that are missing or cannot be read, or a different sequence.
        UsageError: without ground truth, or if the run does not state where its sequence came from.
    """
    saved = open_run(run)
    result = saved.result
    saved.file("labels.npz")
    if not result.has_truth:
        raise UsageError(f"{saved.path}: the run has no ground truth to correct")
    decisions = decisions_of(saved, review)
    opened = saved.sequence(sequence, progress)
    applied = Applied.to(opened, decisions)
    labels = saved.labels
    given = Counts()
    changed = 0

    def corrected(position: int, scan: Scan) -> Scan:
        nonlocal changed
        nonlocal given
        found = applied.truth(scan)
        if found.labels is not None and scan.labels is not None:
            changed += int((found.labels != scan.labels).sum())
        given += Counts.of(outcomes(scan.labels, labels[position]))
        return found

    again = rescore(saved, opened, corrected)
    if again.sequence_digest != result.sequence.digest:
        problem = f"is from a different sequence than {opened.name}"
        raise DataError(saved.path, problem, hint="Give the sequence of the run with --sequence")
    metrics = [counts.metrics() for counts in (given, again.counts)]
    before, after = ({name: each[name] for name in SCORES} for each in metrics)
    return ReviewedScores(before, after, len(applied), changed)


def truths(run: Run, review: str | os.PathLike[str], progress: Progress = silent) -> dict[int, U8]:
    """The ground truth of a run's points as decisions state it.

    Args:
        run: whose sequence can be opened.
        review: the file with the decisions.
        progress: called with a phase, the number of frames done and their total.

    Returns:
        (N,) uint8, a ``Label`` per point, by position of the frame.

    Raises:
        DataError, UsageError: as ``Run.sequence`` and ``Decisions.existing``.
    """
    opened = run.sequence(progress=progress)
    decisions = Decisions.existing(review)
    applied = Applied.to(opened, decisions, makes_truth=not opened.has_labels)
    found: dict[int, U8] = {}
    for position, scan in enumerate(stream(opened)):
        labels = applied.truth(scan).labels
        if labels is None:
            labels = np.full(len(scan), Label.UNLABELLED, np.uint8)
        found[position] = labels
        progress("truth", position + 1, len(opened))
    return found
