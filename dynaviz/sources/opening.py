"""Open anything as one sequence that knows where it came from, and open the sequence of a run
again.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from dynaviz.contracts.scan import Sequence, SequenceSlice, base_of, select_frames
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.errors import NoPoses, UsageError
from dynaviz.progress import Progress, silent
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.drives import Drives
from dynaviz.sources.datasets.in_memory import ArraySequence, with_given_poses, without_poses
from dynaviz.sources.datasets.pose_matching import NO_POSES
from dynaviz.sources.odometry.estimate import EstimatedPoses
from dynaviz.sources.odometry.estimated import DEFAULT, estimate_poses, is_odometry, with_estimated
from dynaviz.sources.odometry.refine import RefinedSequence, refine, refined_before
from dynaviz.sources.options import SequenceOptions
from dynaviz.sources.origin import Origin

Source = Sequence | str | os.PathLike[str] | Iterable[Any]
"""An open sequence, a path, paths of drives in one world frame, or scans as ``(points, pose)``."""


_UNKNOWN = Origin()


@dataclass(frozen=True)
class OpenedSequence(SequenceSlice):
    """A sequence that knows where it came from.

    Attributes:
        provenance: enough to open it again.
        estimated: the poses that an odometry estimated; None for given poses.
    """

    provenance: Origin = _UNKNOWN
    estimated: EstimatedPoses | None = None


def open_source(
    source: Source,
    options: SequenceOptions,
    *,
    folder: Path | None = None,
    estimate_missing: bool = False,
    progress: Progress = silent,
) -> OpenedSequence:
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
    whole: Sequence | None = None
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
        format=type(base_of(opened)).__name__,
        options=dataclasses.replace(_anchored(options), refine_poses=False),
        odometry=f"{estimated.odometry} {estimated.version}" if estimated else "",
        poses_file=_relative(estimated.file, folder) if estimated else "",
    )
    found = OpenedSequence(
        opened.whole, opened.positions, opened.sensor, opened.name, origin, estimated
    )
    return refined(found, folder, progress) if options.refine_poses else found


def refined(sequence: Sequence, folder: Path | None, progress: Progress = silent) -> OpenedSequence:
    """The sequence with refined poses, which are kept in the folder."""
    better = refine(sequence, folder, progress)
    return _known(better, sequence, msgspec.structs.replace(provenance(sequence), refined=True))


def _known(found: Sequence, opened: Sequence, origin: Origin) -> OpenedSequence:
    """All frames of a sequence, with the estimated poses of the opened one that it was made of."""
    estimated = next(
        (each.estimated for each in _layers(opened) if isinstance(each, OpenedSequence)), None
    )
    return OpenedSequence(found, range(len(found)), found.sensor, found.name, origin, estimated)


def provenance(sequence: Sequence) -> Origin:
    """Where a sequence came from, also if frames of it were selected, or its sensor or name
    replaced, after opening.

    A sequence that was not opened by dynaviz has an origin without sources.
    """
    positions = range(len(sequence))
    origin = Origin(format=type(base_of(sequence)).__name__)
    known = Sensor()
    total = len(sequence)
    for layer in _layers(sequence):
        if isinstance(layer, OpenedSequence):
            origin = layer.provenance
            known = layer.sensor
            total = len(layer)
            if (inner := origin.positions) is not None:
                positions = range(*inner)[positions.start : positions.stop : positions.step]
                total = -1
            break
        if isinstance(layer, SequenceSlice):
            positions = layer.positions[positions.start : positions.stop : positions.step]
            total = len(layer.whole)
    used = sequence.sensor
    names = [each.name for each in dataclasses.fields(Sensor)]
    changed = [
        name for name in names if getattr(known, name) is None and getattr(used, name) is not None
    ]
    chosen = (
        None if positions == range(total) else (positions.start, positions.stop, positions.step)
    )
    return msgspec.structs.replace(
        origin,
        positions=chosen,
        name=sequence.name,
        sensor=used,
        estimated=(*origin.estimated, *changed),
    )


def reopened(
    origin: Origin,
    folder: Path | None = None,
    at: str | os.PathLike[str] | None = None,
    progress: Progress = silent,
) -> OpenedSequence:
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
    sensor = origin.sensor or opened.sensor
    found: Sequence = SequenceSlice(opened, chosen, sensor, origin.name or opened.name)
    if origin.refined:
        found = (refined_before(found, folder) if folder else None) or refine(found, None, progress)
    return OpenedSequence(found, range(len(found)), sensor, found.name, origin)


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
) -> OpenedSequence:
    """An open sequence with selected frames, another sensor, or refined poses."""
    names = ("poses", "points_in", "deskew", "extrinsic")
    if late := [name for name in names if getattr(options, name) is not None]:
        raise UsageError(
            f"{', '.join(late)}: the sequence is already open. Give this to dynaviz.open"
        )
    chosen = _selected(sequence, options)
    return (
        refined(chosen, folder, progress)
        if options.refine_poses
        else _known(chosen, chosen, provenance(chosen))
    )


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


def _read(source: Source, places: list[str], options: SequenceOptions) -> Sequence:
    """All frames of a source."""
    if not places:
        assert not isinstance(source, str | os.PathLike | Sequence)
        return ArraySequence.of(
            source, options.points_in, options.poses, options.extrinsic, options.deskew
        )
    drives = [open_sequence(place, poses=options.poses, **options.of_format) for place in places]
    return drives[0] if len(drives) == 1 else Drives.of(drives)


def _selected(whole: Sequence, options: SequenceOptions) -> SequenceSlice:
    """The frames of the options, with their sensor."""
    sensor = load_sensor(options.sensor) if options.sensor else whole.sensor
    found = select_frames(whole, options.frames, options.stride, sensor)
    assert isinstance(found, SequenceSlice)  # because a sensor is given
    return found


def _anchored(options: SequenceOptions) -> SequenceOptions:
    """The options with absolute paths of files."""
    changed = {
        name: os.path.abspath(value)
        for name in ("poses", "extrinsic", "sensor")
        if (value := getattr(options, name)) is not None and Path(value).is_file()
    }
    return dataclasses.replace(options, **changed)


def _layers(sequence: Sequence) -> Iterable[Sequence]:
    """A sequence and the sequences below its selections and refined poses, outermost first."""
    yield sequence
    while isinstance(sequence, SequenceSlice | RefinedSequence):
        sequence = sequence.whole
        yield sequence


def _relative(file: Path, folder: Path | None) -> str:
    return file.name if folder is not None and file.parent == folder else os.path.abspath(file)
