"""The Python interface, which the command line uses, too.

Open a sequence, run a method on it, score a map, compare.
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Unpack

from dynaviz.contracts.options import Record, check_keywords, keywords_of
from dynaviz.engine.external import RADIUS, read_external
from dynaviz.errors import UsageError
from dynaviz.progress import Progress, silent
from dynaviz.runs.execution import run_method, score_external
from dynaviz.runs.options import RunOptions, SequenceRunKeywords, split
from dynaviz.runs.reviewed import truths
from dynaviz.runs.run import open_run
from dynaviz.scores.comparison.summary import Comparison
from dynaviz.scores.result import Result
from dynaviz.sources.drive import Drive
from dynaviz.sources.opening import Source, open_source
from dynaviz.sources.options import SequenceKeywords, SequenceOptions


@keywords_of(SequenceOptions)
def open(path: Source, **options: Unpack[SequenceKeywords]) -> Drive:
    """Open a sequence of any known format.

    Args:
        path: a folder or a bag. The format is detected; a prefix forces it
            (``semantickitti:PATH``). A list of paths opens several drives in one world frame as one
            sequence. Or a list of ``(points, pose)`` or ``(points, pose, stamp)``: (N, 3 or more)
            metres in the sensor frame, (4, 4), ns. Or an open sequence, of which frames are
            selected.
        options: how to open it: see ``Options``.

    Raises:
        DataError: if the path contains no known format.
        UsageError: for invalid frames or sensors, or options that the format does not support.
        TypeError: for an unknown keyword argument.
    """
    check_keywords(open, options)
    return open_source(path, SequenceOptions.of(**options))


@keywords_of(SequenceOptions, RunOptions)
def run(
    method: str,
    sequence: Source,
    *,
    out: str | os.PathLike[str] | None = None,
    command: str = "",
    progress: Progress = silent,
    **options: Unpack[SequenceRunKeywords],
) -> Result:
    """Run a method on a sequence and score it.

    Args:
        method: its name (``dynaviz list methods``).
        sequence: an open sequence, a path, or a list of ``(points, pose)``.
        out: folder for the files of the run; None writes none.
        command: what the user typed, for the record.
        progress: called with a phase, the number of frames or tiles done and their total.
        options: how to open the sequence and how to run the method: see ``Options``.

    Returns:
        The result; printing it shows a table.

    Raises:
        UsageError: for an unknown method, an invalid parameter or record mode, or options of
            opening that an open sequence cannot take.
        DataError: for data that cannot be read, files that cannot be written, or a folder that
            another process writes into.
    """
    check_keywords(run, options)
    folder = None if out is None else Path(out)
    (opening, running) = split(options)
    opened = open_source(sequence, opening.without_refinement, folder=folder, progress=progress)
    return run_method(
        method,
        opened,
        running,
        out=folder,
        refine_poses=opening.refine_poses,
        command=command,
        progress=progress,
    )


@keywords_of(SequenceOptions)
def score(
    map: str | os.PathLike[str],
    sequence: Source,
    *,
    radius: float = RADIUS,
    name: str | None = None,
    key: str | None = None,
    out: str | os.PathLike[str] | None = None,
    record: Record | str | os.PathLike[str] = "errors",
    threads: int | None = None,
    review: str | os.PathLike[str] | None = None,
    command: str = "",
    progress: Progress = silent,
    **options: Unpack[SequenceKeywords],
) -> Result:
    """Score what another program wrote: a cleaned map, or labels of each scan.

    A point of the sequence counts as removed if the nearest point of the map is farther than the
    radius, or if its label says so. Anything unusual raises a warning, and is listed in the section
    ``source`` under ``remarks``.

    Args:
        map: the cleaned map (PCD, PLY, LAS, LAZ, NPY), in metres, in the world frame of the
            sequence; or a folder with labels of each scan (``000000.label``, ``.npy`` or ``.npz``,
            ``dynaviz.io.scan_labels``), directly, in ``predictions`` or in
            ``sequences/NN/predictions``; or a run's folder or ``labels.npz``. Scans without a label
            file are not scored.
        sequence: an open sequence with ground truth, or a path.
        radius: metres; for a map.
        name: for tables and recordings; by default the name of the file or folder, without suffix.
        key: name of the array with the labels, for ``.npz`` files of scans that contain several.
        out: folder for the files of the run; None writes none.
        record: as for ``run``.
        threads: for kernels; None for all cores.
        review: a file with decisions, which the ground truth follows; it is the ground truth of a
            sequence without any.
        command: what the user typed, for the record.
        progress: called with a phase, the number of frames done and their total.
        options: how to open the sequence: see ``Options``.

    Returns:
        The result, with ``scoring`` ``nn`` (``mask`` for labels), without runtime, and with a
        section ``source``.

    Raises:
        UsageError: for a sequence without ground truth, an invalid radius, name or key, or an
            ``out`` whose files would overwrite the map or labels.
        DataError: for data that cannot be read, a map without points, labels of another sequence or
            for another number of points, or files that cannot be written.
    """
    check_keywords(score, options)
    folder = None if out is None else Path(out)
    opened = open_source(sequence, SequenceOptions.of(**options), folder=folder, progress=progress)
    if not opened.has_labels and review is None:
        raise UsageError(
            f"{opened.name} has no ground truth, so nothing can be scored on it. "
            "Give a sequence with labels: gt_cloud.pcd, labels/*.label or label_02/*.txt (see "
            "'dynaviz info SEQ'), or decisions with --review"
        )
    external = read_external(map, opened, radius=radius, name=name, key=key)
    result = score_external(
        external,
        opened,
        out=folder,
        record=record,
        threads=threads,
        review=review,
        command=command,
        progress=progress,
    )
    for remark in result.sections.source.remarks if result.sections.source else ():
        warnings.warn(remark, stacklevel=2)
    return result


def compare(
    *recordings: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    review: str | os.PathLike[str] | None = None,
    card: str | os.PathLike[str] | None = None,
    progress: Progress = silent,
) -> Comparison:
    """Compare runs on the same points, from their recordings alone.

    Args:
        recordings: two or more ``run.rrd``; each is compared with the first.
        out: where to write a recording that shows them side by side; None writes none.
        review: a file with decisions, which the ground truth of all runs follows; then the sequence
            of the first run is read, too.
        card: a Markdown file to write: the verdict, what differs, and each object or surface that
            changed, with a strip of pictures as a PNG file next to it; None writes none.
        progress: called with a phase, the number of recordings done and their total.

    Returns:
        The comparison; printing it shows tables.

    Raises:
        UsageError: for fewer than two recordings, too many, an ``out`` that is one of them, or a
            ``card`` whose name does not end in ``.md``.
        DataError: for recordings that cannot be read or compared (``recordings/README.md``).
    """
    from dynaviz.reports import change_card
    from dynaviz.views.compare.compare import Compared

    if card is not None:
        change_card.checked(card)

    truth = None if review is None else truths(open_run(recordings[0]), review, progress)
    compared = Compared(recordings, out, progress, truth)
    if card is not None:
        change_card.write_card(card, compared.comparison, compared.recordings, progress)
    compared.write(progress)
    return compared.comparison
