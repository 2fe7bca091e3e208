"""A run's answers as SemanticKITTI's label files, for tools that read those."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from dynaviz.engine.external import PrecomputedLabels
from dynaviz.engine.summary import summarize
from dynaviz.errors import DataError
from dynaviz.io.atomic import atomic_folder
from dynaviz.io.semantic_label import write_semantic_labels
from dynaviz.progress import Progress, silent
from dynaviz.scan import Sequence, stream

STATIC, MOVING = 9, 251  # as SemanticKITTI's task of segmenting moving objects has them


def export_labels(
    run: str | os.PathLike[str],
    sequence: Sequence,
    out: str | os.PathLike[str],
    progress: Progress = silent,
) -> int:
    """Write ``NNNNNN.label`` for each frame: a uint32 for each point, 9 for kept and 251 for removed ones.

    Args:
        run: the folder of a run, or its ``labels.npz``.
        sequence: that of the run, with the same frames; its digest is checked.
        out: the folder to make; it must not exist yet, and appears whole or not at all.
        progress: called with a phase, and how many frames of how many are done.

    Returns:
        Number of removed points.

    Raises:
        DataError: for labels that cannot be read or belong to other data, and for an ``out`` that exists or cannot be
            written.
    """
    path, total, removed = Path(run), len(sequence), 0
    if path.is_dir():
        path /= "labels.npz"
        if not path.is_file():
            hint = "Give the folder of a whole run (dynaviz run ... -o FOLDER), or a labels.npz"
            raise DataError(path.parent, "has no labels.npz", hint=hint)
    given = PrecomputedLabels(path, path.stem)
    with atomic_folder(out) as folder:
        seen = summarize(sequence, lambda done: progress("checking", done, total))
        given.check(sequence.name, seen)
        for done, scan in enumerate(stream(sequence), 1):
            dynamic = given.label(scan).dynamic
            write_semantic_labels(
                folder / f"{scan.index:06d}.label", np.where(dynamic, MOVING, STATIC).astype(np.uint16)
            )
            removed += int(dynamic.sum())
            progress("writing", done, total)
    return removed
