"""The Python interface, which the command line uses, too: open a sequence, run a method on it, score a map, compare."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, cast, get_args

import msgspec

from dynaviz.contracts import params, registry
from dynaviz.contracts.attributes import origin_of
from dynaviz.contracts.probe import SILENT, Probe
from dynaviz.contracts.scan import Sequence
from dynaviz.engine.external import RADIUS, read_external
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.engine.needs import suited
from dynaviz.engine.outputs import FILES, LabelsFile, MapFiles, RemoveStaleOutputs, write_summary
from dynaviz.engine.source_check import SourceCheck, source_check
from dynaviz.errors import UsageError
from dynaviz.io.lock import locked
from dynaviz.progress import Progress, silent
from dynaviz.runs.tiles.counts import TileCounts
from dynaviz.runs.tiles.run import TileOptions, label_tiles
from dynaviz.scores.comparison.summary import Comparison
from dynaviz.scores.result import RecordMode, Result
from dynaviz.sources.odometry.refine import refine
from dynaviz.sources.opening import open_source
from dynaviz.sources.options import SequenceOptions
from dynaviz.sources.origin import PoseFinding
from dynaviz.views.record.quota import parse_bytes

Record = Literal[RecordMode, "none"]


def open(
    path: str | os.PathLike[str] | Iterable[Any],
    *,
    frames: str | None = None,
    stride: int = 1,
    sensor: str | None = None,
    poses: str | os.PathLike[str] | None = None,
    points_in: str | None = None,
    deskew: bool | None = None,
    extrinsic: str | None = None,
) -> Sequence:
    """Open a sequence of any known format.

    Args:
        path: a folder or a bag. The format is detected; a prefix forces it (``semantickitti:PATH``). A list of
            paths opens several drives in one world frame as one sequence. Or a list of ``(points, pose)`` or
            ``(points, pose, stamp)``: (N, 3 or more) metres in the sensor frame, (4, 4), ns.
        frames: ``A:B``, positions as in a Python slice.
        stride: use every N-th frame.
        sensor: name of the sensor, if the data do not name it or are wrong (``dynaviz list sensors``), or a TOML file.
        poses: for folders of scans and for bags: a file with the sensor's poses (KITTI, TUM, CSV); for bags also a
            topic, or the TF frame to use as the world frame. For every format: ``small-gicp`` or another odometry,
            which estimates them once and keeps them in ``recordings/SEQUENCE``.
        points_in: for folders and bags: ``sensor`` or ``world``, the frame of the stored points.
        deskew: for bags: False disables motion compensation of sweeps whose points have times.
        extrinsic: for folders and bags whose poses are those of a vehicle: the pose of the lidar on it,
            ``X,Y,Z,ROLL,PITCH,YAW`` in metres and degrees, or a file with one pose.

    Raises:
        DataError: if the path contains no known format.
        UsageError: for invalid frames or sensors, or options that the format does not support.
    """
    options = SequenceOptions(frames, stride, sensor, poses, points_in, deskew, extrinsic)
    return open_source(path, options)


def run(
    method: str,
    sequence: Sequence | str | os.PathLike[str] | Iterable[Any],
    *,
    out: str | os.PathLike[str] | None = None,
    record: Record | str | os.PathLike[str] = "errors",
    view: bool = False,
    preset: str | None = None,
    config: str | os.PathLike[str] | None = None,
    settings: Iterable[str] | Mapping[str, Any] = (),
    online: bool | None = None,
    seed: int | None = None,
    refine_poses: bool = False,
    variant: str = "",
    threads: int | None = None,
    tiles: float | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    record_budget: int | str | None = None,
    maps: bool = True,
    command: str = "",
    progress: Progress = silent,
) -> Result:
    """Run a method on a sequence and score it.

    Args:
        method: its name (``dynaviz list methods``).
        sequence: an open sequence, a path, or a list of ``(points, pose)``.
        out: folder for the files of the run; None writes none.
        record: how much the recording ``run.rrd`` in ``out`` contains (``recordings/README.md``); or the path of an
            ``.rrd`` file, which records in the mode ``errors``, with or without ``out``.
        view: show the run in a viewer while it is running.
        preset, config, settings: layers of parameters (``dynaviz.contracts.params.resolve``); settings may be a
            dictionary.
        online: label each scan right after it was observed, instead of after all scans.
        seed: for all randomness in the method.
        refine_poses: register each scan to the scans around it (open3d), and run with the refined poses. They are kept
            in ``out`` as ``poses_refined.csv``; the result states in ``pose_refinement`` how far they moved.
        variant: a short name for the parameter set, for tables.
        threads: for kernels; None for all cores.
        tiles: edge of the squares into which the map is divided, metres; None runs it as a whole. Needs ``out``. An
            interrupted run continues with the tiles that are missing.
        workers: number of tiles that run at a time, each in its own process.
        scheduler: address of a Dask scheduler whose workers run the tiles instead.
        record_budget: size of the recordings together, bytes or text such as ``2GB``: states are left out first, then
            drawn points; the labels of all points are always recorded. None for any size.
        maps: write ``static_map.pcd`` and ``dynamic_points.pcd``.
        command: what the user typed, for the record.
        progress: called with a phase, the number of frames or tiles done and their total.

    Returns:
        The result; printing it shows a table.

    Raises:
        UsageError: for an unknown method, an invalid parameter or record mode.
        DataError: for data that cannot be read, files that cannot be written, or a folder that another process writes
            into.
    """
    if not isinstance(sequence, Sequence):
        sequence = open(sequence)
    if seed is not None and seed < 0:
        raise UsageError(f"seed = {seed}: give 0 or a positive number")
    kind = registry.load("methods", method)
    resolved = params.resolve(kind, preset, config, settings)
    findings = _pose_findings(sequence)
    sequence = suited(kind, resolved.params, sequence)
    folder = None if out is None else Path(out)
    if refine_poses:
        sequence = refine(sequence, folder, progress)
    spec = RunSpec(
        labeller=kind(resolved.params),
        sequence=sequence,
        params=resolved.params,
        metrics=tuple(metric(kind.info) for metric in registry.loadable("metrics").values()),
        online=bool(online if online is not None else resolved.online),
        seed=seed if seed is not None else resolved.seed or 0,
        variant=variant,
        preset=preset,
        parameter_origins=resolved.source,
        threads=threads,
        command=command,
        pose_findings=findings,
    )
    recording, mode = _recording(record, folder)
    if view and recording is None:
        raise UsageError("view needs a recording: give out=FOLDER or record=FILE.rrd, and not record=none")
    budget = parse_bytes(record_budget) if isinstance(record_budget, str) else record_budget
    if tiles is not None:
        options = TileOptions(tiles, workers, scheduler, budget)
        result = _run_tiles(folder, recording, mode, spec, options, progress, maps)
    elif workers != 1 or scheduler:
        raise UsageError("workers and scheduler run tiles: give tiles=METRES, too")
    else:
        result = _run_into(folder, recording, mode, spec, view, progress, maps=maps, budget=budget)
    _warn_of_size(recording, result, budget)
    return result


def score(
    map: str | os.PathLike[str],
    sequence: Sequence | str | os.PathLike[str],
    *,
    radius: float = RADIUS,
    name: str | None = None,
    key: str | None = None,
    out: str | os.PathLike[str] | None = None,
    record: Record | str | os.PathLike[str] = "errors",
    threads: int | None = None,
    command: str = "",
    progress: Progress = silent,
) -> Result:
    """Score what another program wrote: a cleaned map, or labels of each scan.

    A point of the sequence counts as removed if the nearest point of the map is farther than the radius, or if its
    label says so. Anything unusual raises a warning, and is listed in the section ``source`` under ``remarks``.

    Args:
        map: the cleaned map (PCD, PLY, LAS, LAZ, NPY), in metres, in the world frame of the sequence; or a folder with
            labels of each scan (``000000.label``, ``.npy`` or ``.npz``, ``dynaviz.io.scan_labels``), directly, in
            ``predictions`` or in ``sequences/NN/predictions``; or a run's folder or ``labels.npz``. Scans without a
            label file are not scored.
        sequence: an open sequence with ground truth, or a path.
        radius: metres; for a map.
        name: for tables and recordings; by default the name of the file or folder, without suffix.
        key: name of the array with the labels, for ``.npz`` files of scans that contain several.
        out: folder for the files of the run; None writes none.
        record: as for ``run``.
        threads: for kernels; None for all cores.
        command: what the user typed, for the record.
        progress: called with a phase, the number of frames done and their total.

    Returns:
        The result, with ``scoring`` ``nn`` (``mask`` for labels), without runtime, and with a section ``source``.

    Raises:
        UsageError: for a sequence without ground truth, an invalid radius, name or key, or an ``out`` whose files would
            overwrite the map or labels.
        DataError: for data that cannot be read, a map without points, labels of another sequence or for another number
            of points, or files that cannot be written.
    """
    if not isinstance(sequence, Sequence):
        sequence = open(sequence)
    if not sequence.has_labels:
        raise UsageError(
            f"{sequence.name} has no ground truth, so nothing can be scored on it. "
            "Give a sequence with labels: gt_cloud.pcd, labels/*.label or label_02/*.txt (see 'dynaviz info SEQ')"
        )
    folder = None if out is None else Path(out)
    recording, mode = _recording(record, folder)
    external = read_external(map, sequence, radius=radius, name=name, key=key)
    if folder is not None and folder.resolve() in _overwritten(external.path):
        raise UsageError(f"the files of the run would overwrite {external.path}: give another folder than {folder}")
    spec = RunSpec(
        labeller=external,
        sequence=sequence,
        params=external.params,
        metrics=tuple(metric(external.info) for metric in registry.loadable("metrics").values()),
        threads=threads,
        command=command,
        scoring=external.scoring,
    )
    result = _run_into(folder, recording, mode, spec, False, progress, source_check(external))
    for remark in result.sections.source.remarks if result.sections.source else ():
        warnings.warn(remark, stacklevel=2)
    return result


def compare(
    *recordings: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    progress: Progress = silent,
) -> Comparison:
    """Compare runs on the same points, from their recordings alone.

    Args:
        recordings: two or more ``run.rrd``; each is compared with the first.
        out: where to write a recording that shows them side by side; None writes none.
        progress: called with a phase, the number of recordings done and their total.

    Returns:
        The comparison; printing it shows tables.

    Raises:
        UsageError: for fewer than two recordings, too many, or an ``out`` that is one of them.
        DataError: for recordings that cannot be read or compared (``recordings/README.md``).
    """
    from dynaviz.views.compare.compare import compare as compare_recordings

    return compare_recordings(recordings, out, progress)


def _overwritten(path: Path) -> list[Path]:
    """Folders in which the files of a run would overwrite, or mix with, this file or folder."""
    return [path.resolve()] if path.is_dir() else [path.resolve().parent] if path.name in FILES else []


def _pose_findings(sequence: Sequence) -> tuple[PoseFinding, ...]:
    """What is likely wrong with poses or points, with a warning. Data sets with ground truth are taken to be right."""
    if sequence.has_labels:
        return ()
    from dynaviz.diagnosis import quick_check

    findings = tuple(quick_check(sequence))
    for each in findings:
        warnings.warn(f"{sequence.name}: {each}. 'dynaviz doctor' examines all frames", stacklevel=3)
    return findings


def _warn_of_size(recording: Path | None, result: Result, budget: int | None) -> None:
    """Warn if the recordings are larger than their budget."""
    if recording is None or budget is None:
        return
    paths = [recording]
    if tiling := result.sections.tiling:
        folders = [f"tiles/{tile.column}_{tile.row}" for tile in tiling.tile]
        paths += [recording.parent / name for name in ("overview.rrd", *(f"{folder}/run.rrd" for folder in folders))]
    sizes = [path.stat().st_size for path in paths if path.is_file()]
    if sum(sizes) > budget:
        files = "the recording has" if len(sizes) == 1 else f"{len(sizes)} recordings have"
        problem = f"{files} {sum(sizes) / 1e6:.1f} MB, more than the budget of {budget / 1e6:.1f} MB"
        warnings.warn(f"{problem}: labels, maps and cases are always recorded", stacklevel=3)


def _recording(record: str | os.PathLike[str], folder: Path | None) -> tuple[Path | None, RecordMode]:
    """Path and mode of the recording."""
    if Path(record).suffix == ".rrd":
        return Path(record), "errors"
    if record not in get_args(Record):
        raise UsageError(f"record = {record}: give {', '.join(get_args(Record))}, or the path of an .rrd file")
    return (None if folder is None or record == "none" else folder / "run.rrd"), cast(RecordMode, record)


def _run_into(
    folder: Path | None,
    recording: Path | None,
    mode: RecordMode,
    spec: RunSpec,
    view: bool,
    progress: Progress,
    check: SourceCheck | None = None,
    maps: bool = True,
    budget: int | None = None,
) -> Result:
    """Run and write all files; each appears only when it is complete, ``result.json`` last."""
    with locked(folder, spec.command) if folder else contextlib.nullcontext():
        result = _run_and_record(folder, recording, mode, spec, view, progress, check, maps, budget)
        if folder is not None:
            write_summary(folder, spec, result)
            result = replace(result, answers=replace(result.answers, folder=folder))
    return result


def _run_tiles(
    folder: Path | None,
    recording: Path | None,
    mode: RecordMode,
    spec: RunSpec,
    options: TileOptions,
    progress: Progress,
    maps: bool,
) -> Result:
    """Run every tile, then score and record the labels of all as those of one run."""
    if folder is None:
        raise UsageError("tiles need out=FOLDER, which keeps the answers of finished tiles")
    drawn = recording is not None and mode != "scores"
    share = options.budget and options.budget // 2  # of the recordings of tiles, and of that of the whole run
    with locked(folder, spec.command):
        labeller = label_tiles(
            folder,
            type(spec.labeller),
            spec.params,
            spec.sequence,
            replace(options, budget=share if drawn else None),
            online=spec.online,
            seed=spec.seed,
            record=mode if drawn else None,
            progress=progress,
        )
        whole, counts = replace(spec, labeller=labeller, summary=labeller.summary), TileCounts(options.size)
        others: list[Listener] = [counts]
        if drawn:
            from dynaviz.views.record.overview import Overview

            others.append(Overview(folder / "overview.rrd", counts))
        budget = share if drawn else options.budget
        result = _run_and_record(folder, recording, mode, whole, False, progress, None, maps, budget, others)
        tiling = msgspec.structs.replace(labeller.tiling, tile=counts.rows())
        sections = msgspec.structs.replace(result.sections, tiling=tiling)
        result = replace(result, sections=sections, runtime=labeller.runtime)
        write_summary(folder, whole, result)
    return result


def _run_and_record(
    folder: Path | None,
    recording: Path | None,
    mode: RecordMode,
    spec: RunSpec,
    view: bool,
    progress: Progress,
    check: SourceCheck | None,
    maps: bool = True,
    budget: int | None = None,
    others: Iterable[Listener] = (),
) -> Result:
    """Run and write labels, maps and the recording."""
    probe: Probe = SILENT
    recorder = None
    with contextlib.ExitStack() as stack:
        listeners: list[Listener] = [*others, *([check] if check else [])]
        if folder is not None:
            listeners.append(RemoveStaleOutputs(folder, recording, maps))
            listeners.append(stack.enter_context(LabelsFile(folder)))
            if maps:
                listeners.append(stack.enter_context(MapFiles(folder, origin_of(spec.sequence))))
        if recording is not None:
            from dynaviz.views.record.recorder import Recorder

            recorder = stack.enter_context(Recorder(recording, mode, live=view, budget=budget))
            listeners.append(recorder)
            probe = SILENT if mode == "scores" else recorder  # it shows no states, so the runtime stays honest
        result = execute(spec, listeners, probe, progress, check.section if check else None)
    return replace(result, recording_sha256=recorder.sha256(), record=mode) if recorder else result
