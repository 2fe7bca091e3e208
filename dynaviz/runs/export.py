"""Export the labels of a run as SemanticKITTI label files."""

from __future__ import annotations

import os

import numpy as np

from dynaviz.contracts.scan import stream
from dynaviz.io.atomic import atomic_folder
from dynaviz.io.semantic_label import write_semantic_labels
from dynaviz.progress import Progress, silent
from dynaviz.runs.run import open_run
from dynaviz.sources.opening import Source
from dynaviz.sources.summary import summarize

# classes of SemanticKITTI's moving object segmentation task
STATIC = 9
MOVING = 251


def export_labels(
    run: str | os.PathLike[str],
    out: str | os.PathLike[str],
    sequence: Source | None = None,
    progress: Progress = silent,
) -> tuple[int, int]:
    """Write ``NNNNNN.label`` for each frame.

    A uint32 per point, 9 if the point was kept and 251 if removed.

    Args:
        run: folder of a run, its ``result.json`` or ``run.rrd``.
        out: folder to create; it must not exist yet, and is written atomically.
        sequence: the run's sequence, if the data moved.
        progress: called with the phase, the number of frames done, and the total.

    Returns:
        Numbers of frames and of removed points.

    Raises:
        DataError: if the labels cannot be read or belong to a different sequence, or ``out`` exists
            or cannot be written.
        UsageError: if the run does not state where its sequence came from.
    """
    saved = open_run(run)
    removed = 0
    with atomic_folder(out) as folder:
        labels = saved.labeller
        opened = saved.sequence(sequence)
        total = len(opened)
        summary = summarize(opened, lambda done: progress("checking", done, total))
        labels.check(opened.name, summary)
        for done, scan in enumerate(stream(opened), 1):
            dynamic = labels.label(scan).dynamic
            write_semantic_labels(
                folder / f"{scan.index:06d}.label",
                np.where(dynamic, MOVING, STATIC).astype(np.uint16),
            )
            removed += int(dynamic.sum())
            progress("writing", done, total)
    return total, removed
