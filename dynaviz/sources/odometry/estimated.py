"""Open a sequence with poses that an odometry estimates."""

from __future__ import annotations

import dataclasses
import inspect
import warnings
from pathlib import Path

from dynaviz.contracts import registry
from dynaviz.contracts.scan import Sequence
from dynaviz.errors import DataError, MissingDependency, UsageError
from dynaviz.progress import Progress, silent
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.pose_matching import NO_POSES
from dynaviz.sources.drive import Drive
from dynaviz.sources.odometry.estimate import PosesDoNotHold, estimate
from dynaviz.sources.odometry.reposed import poses_for
from dynaviz.sources.options import SequenceOptions
from dynaviz.sources.origin import EstimatedPoses

DEFAULT = "small-gicp"
SECOND = "kiss-icp"  # tried if the poses of the first do not hold


def is_odometry(poses: str) -> bool:
    """Whether a source of poses is the name of an odometry, and not a file of that name."""
    known = {handle.name for handle in registry.handles("odometries")}
    return poses in known and not Path(poses).exists()


def estimate_poses(
    source: str | Sequence,
    odometry: str,
    folder: Path | None,
    options: SequenceOptions,
    progress: Progress = silent,
) -> EstimatedPoses:
    """Estimate the poses of the chosen frames of a sequence, or find those of an earlier call.

    Args:
        source: as for ``dynaviz.sources.datasets.open_sequence``, or a sequence in memory.
        odometry: its name.
        folder: where to keep the poses; None for ``recordings/SEQUENCE``.
        options: which frames, and how to read them. Bags are deskewed with the poses found.
        progress: called after each sweep.

    Raises:
        UsageError, DataError, MissingDependency: as ``open_sequence`` and ``estimate``.
    """
    if options.points_in == "world":
        raise UsageError(
            f"--poses {odometry}: needs points in the sensor frame, not --points-in world"
        )
    if options.extrinsic is not None:
        raise UsageError(
            f"--poses {odometry}: estimates the poses of the lidar itself; leave out --extrinsic"
        )
    own = _with_fixed_poses(source, options)
    raw = (_raw(source, options) if own is None else own).select(options.frames)
    compensate = own is None and options.deskew is not False
    place = Path("recordings") / raw.name if folder is None else folder
    try:
        return estimate(odometry, raw, place, compensate, progress)
    except PosesDoNotHold as error:
        if odometry == SECOND:
            raise
        return _second_try(error, raw, place, compensate, progress)


def _second_try(
    error: PosesDoNotHold, raw: Sequence, place: Path, compensate: bool, progress: Progress
) -> EstimatedPoses:
    """Estimate poses with the other odometry; the error says what became of both."""
    try:
        return estimate(SECOND, raw, place, compensate, progress)
    except MissingDependency:
        raise error from None
    except PosesDoNotHold as other:
        problem = f"{error.problem}; neither do those of {SECOND}: {other.problem}"
        raise PosesDoNotHold(error.path, problem, hint=error.hint) from None


def with_estimated(source: str | Sequence, file: Path, options: SequenceOptions) -> Drive:
    """The chosen frames of a sequence with the poses of a file that ``estimate_poses`` wrote.

    The stride is left out.

    Args:
        source, options: as for ``estimate_poses``.
        file: the poses.
    """
    if (own := _with_fixed_poses(source, options)) is not None:
        chosen = own.select(options.frames)
        return chosen.with_poses(poses_for(chosen, file))
    assert isinstance(source, str)
    frames = len(_raw(source, options).select(options.frames))
    with warnings.catch_warnings():
        # the frames that were not selected
        warnings.filterwarnings("ignore", message=".*are skipped")
        opened = open_sequence(source, poses=str(file), **options.of_format)
    # The pose at the end of the last sweep may cover the stamp of the sweep after it.
    chosen = opened.select(f":{frames}" if len(opened) > frames else None)
    # The frames that were not selected have no poses because nobody asked for them.
    return dataclasses.replace(chosen, selected=chosen.selected or options.frames is not None)


def _with_fixed_poses(source: str | Sequence, options: SequenceOptions) -> Drive | None:
    """The sequence with its own poses; None if its format reads poses from a file."""
    if not isinstance(source, str):
        return Drive.of(source)
    try:
        own = open_sequence(source, **options.of_format)
    except DataError:
        return None
    return (
        None if "poses" in inspect.signature(getattr(own.reader, "open", _raw)).parameters else own
    )


def _raw(source: str | Sequence, options: SequenceOptions) -> Drive:
    """The sequence with each scan in its own frame."""
    assert isinstance(source, str)
    return open_sequence(source, poses=NO_POSES, **options.of_format)
