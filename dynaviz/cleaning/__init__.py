"""From raw data to a clean map: open anything, estimate poses if there are none, run a method, write the map."""

from __future__ import annotations

import os
import shlex
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz import api
from dynaviz.arrays import U8
from dynaviz.cleaning.cleaned import Cleaned
from dynaviz.cleaning.doubt import doubt_of
from dynaviz.cleaning.trajectory import UsedPoses
from dynaviz.contracts.scan import Sequence, SequenceSlice, select_frames
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.engine.cleaned_map import Judgement, MapFile, check_voxel_size, region_is_empty, write_maps
from dynaviz.engine.region import Region
from dynaviz.errors import NoPoses, UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.io.maps import check_map_path
from dynaviz.progress import Progress, silent
from dynaviz.scores.result import RecordMode, Result
from dynaviz.sources.odometry.estimate import EstimatedPoses
from dynaviz.sources.odometry.estimated import DEFAULT, is_odometry, open_estimated
from dynaviz.sources.sensing import estimate_sensor, sentence

__all__ = ["BEST", "Cleaned", "clean"]

AUTOWARE = "autoware"  # a layout of divided maps
BEST = "seethrough"
"""The method with the best mean rank over all data sets (``docs/methods``)."""


def clean(
    sequence: Sequence | str | os.PathLike[str] | Any,
    out: str | os.PathLike[str],
    *,
    method: str = BEST,
    region: str | None = None,
    voxel_size: float | None = None,
    tiles: str | float | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    keep_dynamic: str | os.PathLike[str] | None = None,
    mark: bool = False,
    drop_unposed: bool = False,
    frames: str | None = None,
    stride: int = 1,
    poses: str | os.PathLike[str] | None = None,
    refine_poses: bool = False,
    points_in: str | None = None,
    deskew: bool | None = None,
    extrinsic: str | None = None,
    sensor: str | None = None,
    preset: str | None = None,
    config: str | os.PathLike[str] | None = None,
    settings: Any = (),
    record: RecordMode | str = "errors",
    threads: int | None = None,
    command: str = "",
    progress: Progress = silent,
) -> Cleaned:
    """Clean a map.

    Args:
        sequence: an open sequence, a path, or a list of ``(points, pose)``.
        out: the map: PCD, PLY, LAS, LAZ or NPZ, by its suffix; a folder for Autoware's divided map. The other
            files of the run are written to a folder next to it, ``clean_run`` for ``clean.laz``.
        method: its name.
        region: ``X0,Y0,X1,Y1`` or ``X0,Y0,Z0,X1,Y1,Z1`` in the coordinates of the map, or a file with the corners of
            a polygon: the map contains only the points inside. The method sees all points.
        voxel_size: metres: the map contains one point per voxel, the first one.
        tiles: edge of the squares into which the map is divided, metres, for drives of any length (``dynaviz.run``).
            If ``out`` has a suffix, a folder without it receives a file for each square, and ``tiles.json``; otherwise
            ``out`` is Autoware's divided map, PCD files of 20 m x 20 m with metadata. ``autoware`` writes the latter
            from a run without tiles.
        workers, scheduler: who runs the tiles, as for ``dynaviz.run``.
        keep_dynamic: file for the removed points, in any of the formats.
        mark: delete no points. The map has all of them, with the attributes ``dynamic`` (0 static, 1 dynamic, 2 not
            judged) and ``reason`` (code of the method; ``Cleaned.to_dict`` has the legend).
        drop_unposed: leave out points that no pose covers, such as those of a merged map outside the trajectory. They
            are kept otherwise, without judgement, if their place in the world is known.
        frames, stride, points_in, deskew, extrinsic, sensor: as for ``dynaviz.open``.
        poses: as for ``dynaviz.open``; None estimates poses with small-gicp if the sequence has none.
        preset, config, settings, record, threads, command, progress, refine_poses: as for ``dynaviz.run``.

    Returns:
        What was done; printing it shows a summary. ``Cleaned.result`` is the result of the run.

    Raises:
        UsageError, DataError, MissingDependency: as ``open`` and ``run``.
    """
    size = _tile_size(tiles)
    removed = None if keep_dynamic is None else Path(keep_dynamic)
    files = _files(Path(out), region, voxel_size, tiles is not None, size, removed, mark)
    folder = run_folder(Path(out))
    estimated, source = None, os.fspath(sequence) if isinstance(sequence, str | os.PathLike) else "SEQ"
    if isinstance(sequence, str | os.PathLike):
        options = {"points_in": points_in, "deskew": deskew, "extrinsic": extrinsic}
        given = None if poses is None else os.fspath(poses)
        sequence, estimated = _open(source, given, folder, frames, options, progress)
        sequence = select_frames(sequence, None if estimated else frames, stride)
    else:
        opened = sequence if isinstance(sequence, Sequence) else api.open(sequence, points_in=points_in)
        sequence = select_frames(opened, frames, stride)
    sequence = select_frames(sequence, sensor=load_sensor(sensor) if sensor else None)
    if (limit := files[0].region) is not None and region_is_empty(sequence, limit):
        hint = "Give it in the coordinates of the map: 'dynaviz info' shows their extent"
        raise UsageError(f"--region {region}: contains no point of {sequence.name}. {hint}")
    result = api.run(
        method,
        sequence,
        out=folder,
        record=record,
        preset=preset,
        config=config,
        settings=settings,
        refine_poses=refine_poses,
        threads=threads,
        tiles=size,
        workers=workers,
        scheduler=scheduler,
        command=command or shlex.join(["dynaviz.clean", sequence.name]),
        progress=progress,
        maps=False,
    )
    used: Sequence = result.answers.sequence  # with refined poses, if they were
    judgement, followed = Judgement(result.labels, _reasons(folder, result) if mark else None), UsedPoses(used)
    maps, account = write_maps(used, judgement, files, progress, drop_unposed, followed.add)
    trajectory = folder / "trajectory.csv"
    written = followed.write(trajectory)
    sensor = sentence(estimate_sensor(sequence)) if sequence.sensor.name == Sensor().name else ""
    whole: Sequence = sequence
    while isinstance(whole, SequenceSlice):
        whole = whole.whole
    facts = getattr(whole, "facts", {})
    in_world = facts.get("points in", "").startswith("world")
    words = shlex.split(command) or ["dynaviz", "clean", source, "-o", os.fspath(out)]
    doubt = doubt_of(result, account, source, words, estimated is None, in_world)
    cleaned = Cleaned(
        result=replace(result, account=account),
        maps=tuple(maps),
        folder=folder,
        poses=estimated,
        facts=facts,
        sensor=sensor,
        doubt=doubt,
        trajectory=trajectory if written else None,
        marked=mark,
    )
    cleaned.result.save(folder / "result.json")  # with the account of the map
    write_atomic(folder / "summary.md", cleaned.markdown().encode())
    return cleaned


def _reasons(folder: Path, result: Result) -> Iterator[U8]:
    """(N,) uint8 for each frame: the codes in the ``labels.npz`` of a run, which is read piece by piece."""
    with zipfile.ZipFile(folder / "labels.npz") as archive, archive.open("reasons.npy") as file:
        np.lib.format.read_magic(file)
        np.lib.format.read_array_header_1_0(file)
        for labels in result.labels:
            yield np.frombuffer(file.read(len(labels)), np.uint8)


def run_folder(out: Path) -> Path:
    """The folder for the files of the run that writes a map."""
    return out.with_name(f"{out.stem}_run")


def _tile_size(tiles: str | float | None) -> float | None:
    """The edge of the tiles of a run, metres; None for a run without tiles."""
    if tiles is None or tiles == AUTOWARE:
        return None
    try:
        return float(tiles)
    except ValueError:
        raise UsageError(f"--tiles {tiles}: give metres, or {AUTOWARE}") from None


def _files(
    out: Path,
    region: str | None,
    voxel_size: float | None,
    divided: bool,
    size: float | None,
    removed: Path | None,
    mark: bool,
) -> list[MapFile]:
    """The maps to write; all options are checked before anything is read."""
    by_tile = size is not None and bool(out.suffix)  # a file per tile of the run, otherwise Autoware's layout
    if by_tile or not divided:
        check_map_path(out)
    elif out.suffix or out.is_file():
        raise UsageError(f"{out}: a divided map is a folder. Give a name without a suffix, such as -o {out.stem}")
    if by_tile and out.with_suffix("").is_file():
        raise UsageError(f"{out.with_suffix('')}: is a file, but the tiles need a folder of this name. Give another -o")
    check_voxel_size(voxel_size)
    if mark and voxel_size is not None:
        raise UsageError("--mark keeps all points, but --voxel-size one per voxel. Give one of the two")
    parsed = None if region is None else Region.parse(region)
    if by_tile:
        map_ = MapFile(out.with_suffix(""), False, False, size, out.suffix, parsed, voxel_size, mark)
    else:
        map_ = MapFile(out, tiled=divided, region=parsed, voxel_size=voxel_size, marked=mark)
    files = [map_]
    if removed is not None:
        check_map_path(removed)
        if removed.resolve() == out.resolve():
            raise UsageError(f"--keep-dynamic {removed}: is the map itself. Give another file")
        files.append(MapFile(removed, removed=True, region=parsed))
    return files


def _open(
    text: str, poses: str | None, folder: Path, frames: str | None, options: dict[str, Any], progress: Progress
) -> tuple[Sequence, EstimatedPoses | None]:
    """The sequence; with estimated poses if they are requested, or it has none."""
    if poses is not None and is_odometry(poses):
        return open_estimated(text, poses, folder, frames, progress, **options)
    try:
        opened = api.open(text, poses=poses, **options)
        if poses is not None or not _without_poses(opened):
            return opened, None
    except NoPoses:
        if poses is not None:
            raise
    return open_estimated(text, DEFAULT, folder, frames, progress, **options)


def _without_poses(sequence: Sequence) -> bool:
    """Whether several scans have the identity as pose, as programs write that know no poses."""
    some = {0, len(sequence) // 2, len(sequence) - 1}
    return len(some) > 1 and all(np.array_equal(sequence[k].T_world_sensor, np.eye(4)) for k in some)
