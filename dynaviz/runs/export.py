"""Export the labels of a run, with the decisions of a person, as SemanticKITTI label files."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, U8, U16, Bool
from dynaviz.contracts.scan import Scan, stream
from dynaviz.io.atomic import atomic_folder, write_atomic
from dynaviz.io.semantic_label import write_semantic_labels
from dynaviz.progress import Progress, silent
from dynaviz.reviews.applying import UNDECIDED, Applied
from dynaviz.reviews.objects import MOST, box_around, numbered
from dynaviz.runs.reviewed import decisions_of
from dynaviz.runs.run import open_run
from dynaviz.sources.opening import Source
from dynaviz.sources.summary import summarize

# classes of SemanticKITTI's moving object segmentation task
UNLABELLED = 0
STATIC = 9
MOVING = 251
BOXES = "boxes.csv"
BOXED = 10  # points of an object in a frame, from which it has a box there
LASTING = 3  # frames in which it has so many, for it to have boxes at all
MOVED = 2.0  # metres from its first box to its last one, for the same
COLUMNS = (
    "frame", "stamp_ns", "instance", "points", "x", "y", "z", "length", "width", "height", "yaw",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class ObjectBox:
    """The box of an object in a frame.

    Attributes:
        frame: number of the frame in its data set; stamp_ns: its time, nanoseconds, or None.
        instance: number of the object; points: its points in the frame.
        middle: (3,) metres, world of the source; size: (3,) metres: length, width and height.
        yaw: radians, from the x axis to the length.
    """

    frame: int
    stamp_ns: int | None
    instance: int
    points: int
    middle: F64
    size: F64
    yaw: float

    def row(self) -> list[object]:
        """The values of ``COLUMNS``."""
        stamp = "" if self.stamp_ns is None else self.stamp_ns
        numbers = [f"{value:.3f}" for value in (*self.middle, *self.size)]
        return [self.frame, stamp, self.instance, self.points, *numbers, f"{self.yaw:.4f}"]


def export_labels(
    run: str | os.PathLike[str],
    out: str | os.PathLike[str],
    sequence: Source | None = None,
    progress: Progress = silent,
    review: str | os.PathLike[str] | None = None,
) -> tuple[int, int]:
    """Write ``NNNNNN.label`` for each frame, and ``boxes.csv``.

    A uint32 per point: 9 if it is static, 251 if it moves, 0 if a person could not tell; and in the
    upper 16 bits the number of its object, the same in all frames. A box for each object and frame:
    middle in the world of the source, size in metres, and yaw in radians. Objects with fewer than
    10 points in a frame have no box there; those with fewer than three boxes, or that move less
    than 2 m from the first box to the last, have none.

    Args:
        run: folder of a run, its ``result.json`` or ``run.rrd``.
        out: folder to create; it must not exist yet, and is written atomically.
        sequence: the run's sequence, if the data moved.
        progress: called with the phase, the number of frames done, and the total.
        review: a file with decisions; None for that of the run.

    Returns:
        Numbers of frames and of moving points.

    Raises:
        DataError: if the labels cannot be read or belong to a different sequence, or ``out`` exists
            or cannot be written.
        UsageError: if the run does not state where its sequence came from.
    """
    saved = open_run(run)
    with atomic_folder(out) as folder:
        labels = saved.labeller
        opened = saved.sequence(sequence)
        total = len(opened)
        summary = summarize(opened, lambda done: progress("checking", done, total))
        labels.check(opened.name, summary)
        applied = Applied.to(opened, decisions_of(saved, review))
        answers: list[tuple[Bool, U8]] = []
        moving = []
        for done, scan in enumerate(stream(opened), 1):
            answers.append(applied.answers(scan, labels.label(scan).dynamic))
            moving.append(scan.points[answers[-1][0] & (answers[-1][1] != UNDECIDED)])
            progress("finding objects", done, total)
        numbers = numbered(moving)
        lasting = _lasting(numbers)
        boxes: list[ObjectBox] = []
        for done, scan in enumerate(stream(opened), 1):
            dynamic, verdicts = answers[done - 1]
            classes = np.where(dynamic, MOVING, STATIC).astype(np.uint16)
            classes[verdicts == UNDECIDED] = UNLABELLED
            instances = np.zeros(len(scan), np.uint16)
            instances[classes == MOVING] = numbers[done - 1]
            write_semantic_labels(folder / f"{scan.index:06d}.label", classes, instances)
            boxes += _boxes(scan, instances, lasting, opened.origin)
            progress("writing", done, total)
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(
            [COLUMNS, *(box.row() for box in _of_movers(boxes))]
        )
        write_atomic(folder / BOXES, text.getvalue().encode())
    return total, sum(map(len, moving))


def _lasting(numbers: list[U16]) -> Bool:
    """(65536,) bool: the numbers of objects that have boxes."""
    frames = np.zeros(MOST + 1, np.int64)
    for own in numbers:
        frames += np.bincount(own, minlength=MOST + 1) >= BOXED
    lasting: Bool = frames >= LASTING
    lasting[0] = False  # not an object
    return lasting


def _of_movers(boxes: list[ObjectBox]) -> list[ObjectBox]:
    """The boxes of objects that move far enough."""
    ends: dict[int, tuple[F64, F64]] = {}
    for box in boxes:
        ends[box.instance] = ends.get(box.instance, (box.middle, box.middle))[0], box.middle
    moved = {number for number, (first, last) in ends.items() if math.dist(first, last) >= MOVED}
    return [box for box in boxes if box.instance in moved]


def _boxes(scan: Scan, instances: U16, lasting: Bool, origin: F64) -> Iterator[ObjectBox]:
    """The boxes of the objects in a scan."""
    order = np.argsort(instances, kind="stable")
    ends = np.flatnonzero(np.diff(instances[order])) + 1
    for part in np.split(order, ends):
        if len(part) < BOXED or not lasting[instances[part[0]]]:
            continue
        box = box_around(scan.points[part].astype(np.float64) + origin)
        yield ObjectBox(scan.index, scan.stamp_ns, int(instances[part[0]]), len(part), *box)
