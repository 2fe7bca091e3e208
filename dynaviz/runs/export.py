"""Export the labels of a run as SemanticKITTI label files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from dynaviz.contracts.scan import Sequence, stream
from dynaviz.engine.external import PrecomputedLabels
from dynaviz.errors import DataError
from dynaviz.io.atomic import atomic_folder
from dynaviz.io.semantic_label import write_semantic_labels
from dynaviz.progress import Progress, silent
from dynaviz.sources.summary import summarize

STATIC, MOVING = 9, 251  # classes of SemanticKITTI's moving object segmentation task


def export_labels(
    run: str | os.PathLike[str],
    sequence: Sequence,
    out: str | os.PathLike[str],
    progress: Progress = silent,
) -> int:
    """Write ``NNNNNN.label`` for each frame: a uint32 per point, 9 if the point was kept and 251 if removed.

    Args:
        run: folder of a run, or its ``labels.npz``.
        sequence: the sequence of the run, with the same frames; its digest is checked.
        out: folder to create; it must not exist yet, and is written atomically.
        progress: called with the phase, the number of frames done, and the total.

    Returns:
        Number of removed points.

    Raises:
        DataError: if the labels cannot be read or belong to a different sequence, or ``out`` exists or cannot be
            written.
    """
    path, total, removed = Path(run), len(sequence), 0
    if path.is_dir():
        path /= "labels.npz"
        if not path.is_file():
            hint = "Give the folder of a finished run (dynaviz run METHOD PATH -o FOLDER), or a labels.npz"
            raise DataError(path.parent, "has no labels.npz", hint=hint)
    labels = PrecomputedLabels(path, path.stem)
    with atomic_folder(out) as folder:
        summary = summarize(sequence, lambda done: progress("checking", done, total))
        labels.check(sequence.name, summary)
        for done, scan in enumerate(stream(sequence), 1):
            dynamic = labels.label(scan).dynamic
            write_semantic_labels(
                folder / f"{scan.index:06d}.label", np.where(dynamic, MOVING, STATIC).astype(np.uint16)
            )
            removed += int(dynamic.sum())
            progress("writing", done, total)
    return removed
