"""What scripts and the command line share: open a sequence, run a method on it, keep the files."""

from __future__ import annotations

import contextlib
import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Literal, cast, get_args

from dynaviz import params as layers
from dynaviz import registry
from dynaviz.comparison.summary import Comparison
from dynaviz.datasets import open_sequence
from dynaviz.engine import external as scoring
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.engine.outputs import FILES, LabelsFile, MapFiles, RemoveStaleOutputs, write_summary
from dynaviz.errors import UsageError
from dynaviz.method import Method
from dynaviz.probe import SILENT, Probe
from dynaviz.progress import Progress, silent
from dynaviz.results.result import RecordMode, Result
from dynaviz.scan import Sequence, select_frames
from dynaviz.sensors import load_sensor

Record = Literal[RecordMode, "none"]


def open(
    path: str | os.PathLike[str],
    *,
    frames: str | None = None,
    stride: int = 1,
    sensor: str | None = None,
    poses: str | os.PathLike[str] | None = None,
    points_in: str | None = None,
    deskew: bool | None = None,
) -> Sequence:
    """Open a sequence of any known format.

    Args:
        path: a folder or a bag; the format is guessed, or forced with a prefix (``semantickitti:PATH``).
        frames: ``A:B``, positions as in a Python slice.
        stride: every how manieth frame.
        sensor: name of the sensor, where the data do not tell or are wrong (``dynaviz list sensors``).
        poses: for folders of scans and for bags: a file of the sensor's poses (KITTI, TUM, CSV); for bags also a topic
            or the TF frame that is the world.
        points_in: for the same: ``sensor`` or ``world``, the frame of the points as they are stored.
        deskew: for bags: False leaves each sweep as it is, although its points have times.

    Raises:
        DataError: where nothing known is at the path.
        UsageError: for frames or a sensor that do not exist, or options that the format does not take.
    """
    named = None if poses is None else os.fspath(poses)
    sequence = open_sequence(os.fspath(path), poses=named, points_in=points_in, deskew=deskew)
    return select_frames(sequence, frames, stride, load_sensor(sensor) if sensor else None)


def run(
    method: str,
    sequence: Sequence | str | os.PathLike[str],
    *,
    out: str | os.PathLike[str] | None = None,
    record: Record | str | os.PathLike[str] = "errors",
    view: bool = False,
    preset: str | None = None,
    config: str | os.PathLike[str] | None = None,
    settings: tuple[str, ...] = (),
    online: bool | None = None,
    seed: int | None = None,
    variant: str = "",
    threads: int | None = None,
    command: str = "",
    progress: Progress = silent,
) -> Result:
    """Run a method on a sequence and score it.

    Args:
        method: its name (``dynaviz list methods``).
        sequence: an open sequence, or a path.
        out: folder for the files of the run; None writes none.
        record: how much the recording ``run.rrd`` in ``out`` holds (``recordings/README.md``), or the path of an
            ``.rrd`` file for one with what is wrong, with or without ``out``.
        view: show the run in a viewer while it goes on.
        preset, config, settings: layers of parameters (``dynaviz.params.resolve``).
        online: ask for each scan's labels right after it was observed, not after all.
        seed: for everything random in the method.
        variant: a short name for the parameters, for tables.
        threads: for kernels; None for all cores.
        command: what the user typed, for the record.
        progress: called with a phase, and how many frames of how many are done.

    Returns:
        The result; printing it shows a table.

    Raises:
        UsageError: for a method, parameter or way to record that does not exist.
        DataError: for data that cannot be read, or files that cannot be written.
    """
    if not isinstance(sequence, Sequence):
        sequence = open(sequence)
    if seed is not None and seed < 0:
        raise UsageError(f"seed = {seed}: give 0 or a positive number")
    kind = registry.load("methods", method)
    resolved = layers.resolve(kind, preset, config, settings)
    metrics = tuple(metric(kind.info) for metric in registry.loadable("metrics").values())
    this = RunSpec(
        method=kind(resolved.params),
        sequence=sequence,
        params=resolved.params,
        metrics=metrics,
        online=bool(online if online is not None else resolved.online),
        seed=seed if seed is not None else resolved.seed or 0,
        variant=variant,
        threads=threads,
        command=command,
    )
    folder = None if out is None else Path(out)
    recording, mode = _recording(record, folder)
    if view and recording is None:
        raise UsageError("view shows the recording of a run: give out=FOLDER or record=FILE.rrd, and not record=none")
    return _run_into(folder, recording, mode, this, view, progress)


def score(
    map: str | os.PathLike[str],
    sequence: Sequence | str | os.PathLike[str],
    *,
    radius: float = scoring.RADIUS,
    name: str | None = None,
    out: str | os.PathLike[str] | None = None,
    record: Record | str | os.PathLike[str] = "errors",
    threads: int | None = None,
    command: str = "",
    progress: Progress = silent,
) -> Result:
    """Score a cleaned map that any other program wrote.

    A point of the sequence counts as removed if the nearest point of the map is farther than the radius.

    Args:
        map: the cleaned map (PCD, PLY, LAS, LAZ, NPY), in metres, in the world frame of the sequence; or the
            ``labels.npz`` of a run, which answers by index instead.
        sequence: an open sequence with ground truth, or a path.
        radius: metres.
        name: for tables and recordings; the map's file name without its suffix by default.
        out: folder for the files of the run; None writes none.
        record: as for ``run``.
        threads: for kernels; None for all cores.
        command: what the user typed, for the record.
        progress: called with a phase, and how many frames of how many are done.

    Returns:
        The result, with ``scoring`` ``nn`` (``mask`` for labels), no runtime, and a section ``source`` on the map. What
        is remarkable about the map is warned of, and stands there under ``remarks``.

    Raises:
        UsageError: for a sequence without ground truth, a radius or name that is none, or an ``out`` whose files would
            replace the map.
        DataError: for data that cannot be read, a map without points, labels of another sequence, or files that cannot
            be written.
    """
    if not isinstance(sequence, Sequence):
        sequence = open(sequence)
    if not sequence.has_labels:
        raise UsageError(
            f"{sequence.name} has no ground truth, so no map can be scored on it. "
            "Give a sequence with labels: gt_cloud.pcd, labels/*.label or label_02/*.txt ('dynaviz info SEQ' tells)"
        )
    folder = None if out is None else Path(out)
    recording, mode = _recording(record, folder)
    given = scoring.read_external(map, radius, name)
    if folder is not None and given.path.name in FILES and given.path.resolve().parent == folder.resolve():
        raise UsageError(f"{given.path} would be replaced by the files of the run: give another folder than {folder}")
    metrics = (scoring.SourceCheck(given), *(metric(given.info) for metric in registry.loadable("metrics").values()))
    this = RunSpec(
        method=cast(Method, given),
        sequence=sequence,
        params=given.params,
        metrics=metrics,
        threads=threads,
        command=command,
        scoring=given.scoring,
        external=True,
    )
    result = _run_into(folder, recording, mode, this, False, progress, first=scoring.ValidateInput(given))
    for remark in result.sections["source"]["remarks"]:
        warnings.warn(remark, stacklevel=2)
    return result


def compare(
    *recordings: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    progress: Progress = silent,
) -> Comparison:
    """Say what differs between runs on the same points, from their recordings alone.

    Args:
        recordings: two or more ``run.rrd``; each is compared with the first.
        out: where to write a recording that shows them side by side; None writes none.
        progress: called with a phase, and how many recordings of how many are done.

    Returns:
        The comparison; printing it shows tables.

    Raises:
        UsageError: for fewer than two recordings, too many, or an ``out`` that is one of them.
        DataError: for recordings that cannot be read or do not compare (``recordings/README.md``).
    """
    from dynaviz.viz.compare import compare as compare_recordings

    return compare_recordings(recordings, out, progress)


def _recording(record: str | os.PathLike[str], folder: Path | None) -> tuple[Path | None, RecordMode]:
    """Where the recording goes, and how much it holds."""
    if Path(record).suffix == ".rrd":
        return Path(record), "errors"
    if record not in get_args(Record):
        raise UsageError(f"record = {record}: give {', '.join(get_args(Record))}, or the path of an .rrd file")
    return (None if folder is None or record == "none" else folder / "run.rrd"), cast(RecordMode, record)


def _run_into(
    folder: Path | None,
    recording: Path | None,
    mode: RecordMode,
    this: RunSpec,
    view: bool,
    progress: Progress,
    first: Listener | None = None,
) -> Result:
    """Run with all files written; each appears only when it is whole, ``result.json`` last."""
    probe: Probe = SILENT
    recorder = None
    with contextlib.ExitStack() as stack:
        listeners: list[Listener] = [] if first is None else [first]
        if folder is not None:
            listeners.append(RemoveStaleOutputs(folder, recording))
            listeners += [stack.enter_context(kind(folder)) for kind in (LabelsFile, MapFiles)]
        if recording is not None:
            from dynaviz.viz.recorder import Recorder

            recorder = stack.enter_context(Recorder(recording, mode, live=view))
            listeners.append(recorder)
            probe = SILENT if mode == "scores" else recorder  # which shows no state, and leaves the runtime honest
        result = execute(this, listeners, probe, progress)
    if recorder:
        result = replace(result, recording_sha256=recorder.sha256(), record=mode)
    if folder is not None:
        write_summary(folder, this, result)
    return result
