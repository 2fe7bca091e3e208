"""Open anything as one sequence that knows where it came from, and open the sequence of a run
again.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from dynaviz.contracts.scan import Sequence
from dynaviz.contracts.sensors import load_sensor
from dynaviz.errors import NoPoses, UsageError
from dynaviz.progress import Progress, silent
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.drives import Drives
from dynaviz.sources.datasets.in_memory import ArraySequence, with_given_poses, without_poses
from dynaviz.sources.datasets.pose_matching import NO_POSES
from dynaviz.sources.drive import Drive
from dynaviz.sources.odometry.estimated import DEFAULT, estimate_poses, is_odometry, with_estimated
from dynaviz.sources.odometry.refine import refine, refined_before
from dynaviz.sources.options import SequenceOptions
from dynaviz.sources.origin import Origin

Source = Sequence | str | os.PathLike[str] | Iterable[Any]
"""An open sequence, a path, paths of drives in one world frame, or scans as ``(points, pose)``."""


def open_source(
    source: Source,
    options: SequenceOptions,
    *,
    folder: Path | None = None,
    estimate_missing: bool = False,
    progress: Progress = silent,
) -> Drive:
    """Open a path, a list of paths (drives in one world frame), or a list of ``(points, pose)``.

    Or select frames.

    Args:
        source: what to open.
        options: how to open it.
        folder: where estimated and refined poses are kept; None for ``recordings/SEQUENCE``, and no
            file of refined poses.
        estimate_missing: estimate poses if the source has none.
        progress: called while poses are estimated or refined.

    Raises:
        DataError, UsageError, MissingDependency: as ``dynaviz.open``.
    """
    if isinstance(source, Sequence):
        return _reselected(source, options, folder, progress)
    places = _places(source)
    if options.poses is not None and not isinstance(options.poses, str):
        if places:
            raise UsageError(
                "poses: an array fits scans given as arrays. Give a file, or scans with their poses"
            )
        source = with_given_poses(source, options.poses)
        options = dataclasses.replace(options, poses=None)
    odometry = options.poses if options.poses is not None and is_odometry(options.poses) else None
    own = dataclasses.replace(options, poses=None) if odometry else options
    whole: Drive | None = None
    try:
        if odometry is None:
            whole = _read(source, places, own)
            if estimate_missing and options.poses is None and without_poses(whole):
                odometry = DEFAULT
                whole = None
    except NoPoses:
        if not estimate_missing or options.poses is not None:
            raise
        odometry = DEFAULT
    estimated = None
    if odometry is not None:
        if len(places) > 1:
            raise UsageError(
                f"--poses {odometry}: several drives need poses in one world frame. Clean them one "
                "by one"
            )
        text = (
            places[0] if places else _read(source, places, dataclasses.replace(own, poses=NO_POSES))
        )
        estimated = estimate_poses(text, odometry, folder, options, progress)
        whole = with_estimated(text, estimated.file, options)
        opened = _selected(whole, dataclasses.replace(options, frames=None))
    else:
        assert whole is not None
        opened = _selected(whole, options)
    origin = Origin(
        sources=tuple(places),
        absolute=tuple(map(absolute, places)),
        format=opened.reader.format,
        options=dataclasses.replace(_anchored(options), refine_poses=False),
        odometry=f"{estimated.odometry} {estimated.version}" if estimated else "",
        poses_file=_relative(estimated.file, folder) if estimated else "",
        name=opened.name,
        sensor=opened.sensor,
    )
    found = dataclasses.replace(opened, provenance=origin, estimated=estimated)
    return refine(found, folder, progress) if options.refine_poses else found


def reopened(
    origin: Origin,
    folder: Path | None = None,
    at: str | os.PathLike[str] | None = None,
    progress: Progress = silent,
) -> Drive:
    """Open the sequence of a run again: the same frames and poses, bit for bit.

    Args:
        origin: of the run.
        folder: of the run, with estimated or refined poses; None if it had none.
        at: path of the data, if they moved.
        progress: called while poses are refined, which is done again if their file is missing.

    Raises:
        UsageError: if the origin names no source, and no path is given.
        DataError: for data that cannot be read.
    """
    pairs = zip(origin.absolute, origin.sources, strict=True)
    # The path as it was given serves if only that exists, as after a project moved with its data.
    places = [
        given if not Path(path).exists() and Path(given).exists() else path for path, given in pairs
    ]
    if at is not None:
        places = [os.fspath(at)]
    if not places:
        raise UsageError("the run was made from data in memory")
    source = places if len(places) > 1 else places[0]
    if origin.odometry:
        file = Path(origin.poses_file)
        file = file if folder is None or not (folder / file.name).is_file() else folder / file.name
        whole = with_estimated(places[0], file, origin.options)
        opened = _selected(whole, dataclasses.replace(origin.options, frames=None))
    else:
        opened = _selected(_read(source, places, origin.options), origin.options)
    chosen = range(len(opened)) if origin.positions is None else range(*origin.positions)
    found = opened.chosen(chosen).renamed(origin.name or opened.name)
    found = dataclasses.replace(found, sensor=origin.sensor or opened.sensor)
    if origin.refined:
        found = (refined_before(found, folder) if folder else None) or refine(found, None, progress)
    return dataclasses.replace(found, provenance=origin)


def absolute(text: str, base: Path = Path()) -> str:
    """A source with an absolute path.

    A ``FORMAT:`` prefix is kept, and URLs and simulated scenes stay as they are.
    """
    prefix, colon, rest = text.partition(":")
    if not colon or not prefix.isidentifier() or (base / text).exists():
        return os.path.abspath(base / text)
    if prefix == "simulate" or rest.startswith("//"):
        return text
    return (
        f"{prefix}:{absolute(rest, base)}"
        if ":" in rest
        else f"{prefix}:{os.path.abspath(base / rest)}"
    )


def _reselected(
    sequence: Sequence, options: SequenceOptions, folder: Path | None, progress: Progress
) -> Drive:
    """An open sequence with selected frames, another sensor, or refined poses."""
    names = ("poses", "points_in", "deskew", "extrinsic")
    if late := [name for name in names if getattr(options, name) is not None]:
        raise UsageError(
            f"{', '.join(late)}: the sequence is already open. Give this to dynaviz.open"
        )
    chosen = _selected(Drive.of(sequence), options)
    return refine(chosen, folder, progress) if options.refine_poses else chosen


def _places(source: Source) -> list[str]:
    """The paths of a source; none for scans in memory."""
    if isinstance(source, str | os.PathLike):
        return [os.fspath(source)]
    if (
        isinstance(source, list | tuple)
        and source
        and all(isinstance(each, str | os.PathLike) for each in source)
    ):
        return [os.fspath(each) for each in source]
    return []


def _read(source: Source, places: list[str], options: SequenceOptions) -> Drive:
    """All frames of a source."""
    if not places:
        assert not isinstance(source, str | os.PathLike | Sequence)
        arrays = ArraySequence.of(
            source, options.points_in, options.poses, options.extrinsic, options.deskew
        )
        return Drive.of(arrays)
    drives = [open_sequence(place, poses=options.poses, **options.of_format) for place in places]
    return drives[0] if len(drives) == 1 else Drive.of(Drives.of(drives))


def _selected(whole: Drive, options: SequenceOptions) -> Drive:
    """The frames of the options, with their sensor."""
    chosen = whole.select(options.frames, options.stride)
    return chosen.with_sensor(load_sensor(options.sensor)) if options.sensor else chosen


def _anchored(options: SequenceOptions) -> SequenceOptions:
    """The options with absolute paths of files."""
    changed = {
        name: os.path.abspath(value)
        for name in ("poses", "extrinsic", "sensor")
        if (value := getattr(options, name)) is not None and Path(value).is_file()
    }
    return dataclasses.replace(options, **changed)


def _relative(file: Path, folder: Path | None) -> str:
    return file.name if folder is not None and file.parent == folder else os.path.abspath(file)
