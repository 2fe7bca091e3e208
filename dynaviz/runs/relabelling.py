"""Corrections of ground truth, kept next to a run and never written into its sequence, and the
scores with them.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from msgspec import Struct

from dynaviz.contracts.scan import Label, Scan
from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.io.plain_json import read_json
from dynaviz.progress import Progress, silent
from dynaviz.runs.rescore import rescore as score_again
from dynaviz.runs.run import open_run
from dynaviz.scores.scores import SCORES, Counts
from dynaviz.sources.opening import Source

FILE = "corrections.json"
SCHEMA = 1
MARGIN = 0.02  # metres around a box, whose corners are those of rounded points
_HINT = "Remove it to start without corrections"
Truth = Literal["static", "dynamic"]
LABELS = {"static": Label.STATIC, "dynamic": Label.DYNAMIC}

Corner = tuple[float, float, float]


class Box(Struct, frozen=True):
    """A box in one frame.

    Attributes:
        frame: position in the run.
        low, high: metres, world frame.
    """

    frame: int
    low: Corner
    high: Corner


class Correction(Struct, frozen=True):
    """The ground truth of a case is wrong: in its boxes, points with the other truth get this one.

    Attributes:
        case: number in the run's list.
        what: the case in a few words.
        truth: ``static`` or ``dynamic``.
        boxes: one for each frame of the case.
    """

    case: int
    what: str
    truth: Truth
    boxes: tuple[Box, ...]


class Corrections(Struct, frozen=True):
    """The content of ``corrections.json``.

    Attributes:
        sequence: digest of the run's sequence.
        corrections: at most one for each case, in the order in which they were made.
        schema: of the file.
    """

    sequence: str
    corrections: tuple[Correction, ...] = ()
    schema: int = SCHEMA

    def corrected(self, position: int, scan: Scan) -> Scan:
        """The scan at a position of the run, with the corrected ground truth.

        Unlabelled points stay unlabelled.
        """
        boxes = [
            (each.truth, box)
            for each in self.corrections
            for box in each.boxes
            if box.frame == position
        ]
        if scan.labels is None or not boxes:
            return scan
        labels = scan.labels.copy()
        for truth, box in boxes:
            low = np.array(box.low) - MARGIN
            high = np.array(box.high) + MARGIN
            inside = ((scan.points >= low) & (scan.points <= high)).all(1)
            labels[inside & (labels != Label.UNLABELLED)] = LABELS[truth]
        return dataclasses.replace(scan, labels=labels)


@dataclass(frozen=True)
class CorrectedScores:
    """Scores of a run before and after its corrections.

    Attributes:
        before, after: SA, DA, AA and HA in percent; None where undefined.
        corrections: how many there are.
        points: how many points got another truth.
    """

    before: Mapping[str, float | None]
    after: Mapping[str, float | None]
    corrections: int
    points: int

    def __str__(self) -> str:
        def change(name: str) -> str:
            values = (
                "n/a" if each[name] is None else f"{each[name]:.2f}"
                for each in (self.before, self.after)
            )
            return f"{name} {' -> '.join(values)}"

        scores = ", ".join(map(change, ("AA", "SA", "DA")))
        many = f"{self.corrections} correction{'' if self.corrections == 1 else 's'}"
        return f"{scores} with {many} of {self.points:,} points."


def read_corrections(run: Path, sequence: str) -> Corrections:
    """Read the corrections of a run; empty without a file.

    Args:
        run: its folder.
        sequence: digest of the run's sequence.

    Raises:
        DataError: if the file cannot be read, was written by a newer dynaviz, or is for a different
            sequence.
    """
    path = run / FILE
    if not path.is_file():
        return Corrections(sequence)
    try:
        found = msgspec.convert(read_json(path, _HINT), Corrections)
    except msgspec.ValidationError as error:
        raise DataError(path, f"is not a file of corrections: {error}", hint=_HINT) from None
    if found.schema > SCHEMA:
        raise DataError(path, "was written by a newer dynaviz", hint="Upgrade dynaviz")
    if found.sequence != sequence:
        raise DataError(path, "is for a different sequence than the run", hint=_HINT)
    return found


def correct(run: Path, sequence: str, case: int, correction: Correction | None) -> Corrections:
    """Add the correction of a case to those of a run, or replace or remove it.

    Args:
        run, sequence: as for ``read_corrections``.
        case: its number.
        correction: None to remove it.

    Raises:
        DataError: as ``read_corrections``, or if the file cannot be written.
    """
    others = [each for each in read_corrections(run, sequence).corrections if each.case != case]
    changed = Corrections(sequence, (*others, *([correction] if correction else [])))
    write_atomic(run / FILE, msgspec.json.format(msgspec.json.encode(changed), indent=1) + b"\n")
    return changed


def rescore(
    run: str | os.PathLike[str], sequence: Source | None = None, progress: Progress = silent
) -> CorrectedScores:
    """Score the stored labels of a run with its corrected ground truth.

    The run's files stay as they are.

    Args:
        run: its folder, ``result.json`` or ``run.rrd``.
        sequence: the run's sequence, if the data moved.
        progress: called while poses are refined again.

    Raises:
        DataError: for files that are missing or cannot be read, or a different sequence.
        UsageError: without ground truth, or if the run does not state where its sequence came from.
    """
    saved = open_run(run)
    result = saved.result
    folder = saved.file("labels.npz").parent
    if not result.has_truth:
        raise UsageError(f"{saved.path}: the run has no ground truth to correct")
    corrections = read_corrections(folder, result.sequence.digest)
    opened = saved.sequence(sequence, progress)
    changed = 0

    def corrected(position: int, scan: Scan) -> Scan:
        nonlocal changed
        found = corrections.corrected(position, scan)
        if found.labels is not None and scan.labels is not None:
            changed += int((found.labels != scan.labels).sum())
        return found

    again = score_again(saved, opened, corrected)
    if again.sequence_digest != result.sequence.digest:
        problem = f"is from a different sequence than {opened.name}"
        raise DataError(saved.path, problem, hint="Give the sequence of the run with --sequence")
    metrics = [counts.metrics() for counts in (Counts(**result.counts), again.counts)]
    before, after = ({name: each[name] for name in SCORES} for each in metrics)
    return CorrectedScores(before, after, len(corrections.corrections), changed)
