"""Open a sequence with poses that an odometry estimates."""

from __future__ import annotations

import inspect
import warnings
from pathlib import Path
from typing import Any

from dynaviz.contracts import registry
from dynaviz.contracts.scan import Sequence, select_frames
from dynaviz.errors import DataError, UsageError
from dynaviz.progress import Progress, silent
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.pose_matching import NO_POSES
from dynaviz.sources.odometry.estimate import EstimatedPoses, estimate
from dynaviz.sources.odometry.reposed import ReposedSequence

DEFAULT = "small-gicp"


def is_odometry(poses: str) -> bool:
    """Whether a source of poses is the name of an odometry, and not a file of that name."""
    known = {handle.name for handle in registry.handles("odometries")}
    return poses in known and not Path(poses).exists()


def open_estimated(
    text: str,
    odometry: str = DEFAULT,
    folder: Path | None = None,
    frames: str | None = None,
    progress: Progress = silent,
    **options: Any,
) -> tuple[Sequence, EstimatedPoses]:
    """Open a sequence with estimated poses. Bags are deskewed with them.

    Args:
        text: as for ``dynaviz.sources.datasets.open_sequence``.
        odometry: its name.
        folder: where to keep the poses; None for ``recordings/SEQUENCE``.
        frames: ``A:B``, the frames to use.
        progress: called after each sweep.
        options: ``points_in`` and ``deskew`` as for ``dynaviz.open``.

    Raises:
        UsageError, DataError, MissingDependency: as ``open_sequence`` and ``estimate``.
    """
    if options.get("points_in") == "world":
        raise UsageError(f"--poses {odometry}: needs points in the sensor frame, not --points-in world")
    if options.pop("extrinsic", None) is not None:
        raise UsageError(f"--poses {odometry}: estimates the poses of the lidar itself; leave out --extrinsic")
    own = _with_own_poses(text, options)
    if own is not None and not _accepts_poses(own):
        own = select_frames(own, frames)
        found = estimate(odometry, own, _folder(folder, own), False, progress)
        return ReposedSequence.read(own, found.file), found
    whole = open_sequence(text, poses=NO_POSES, **options)
    raw = select_frames(whole, frames)
    compensate = options.get("deskew") is not False
    found = estimate(odometry, raw, _folder(folder, raw), compensate, progress)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*are skipped")  # the frames that were not selected
        opened = open_sequence(text, poses=str(found.file), **options)
    # The pose at the end of the last sweep may cover the stamp of the sweep after it.
    return select_frames(opened, f":{len(raw)}" if len(opened) > len(raw) else None), found


def _with_own_poses(text: str, options: dict[str, Any]) -> Sequence | None:
    """The sequence with its own poses; None if it has none."""
    try:
        return open_sequence(text, **options)
    except DataError:
        return None


def _accepts_poses(sequence: Sequence) -> bool:
    """Whether the format of a sequence can be opened with other poses."""
    return "poses" in inspect.signature(getattr(type(sequence), "open", _with_own_poses)).parameters


def _folder(folder: Path | None, sequence: Sequence) -> Path:
    return Path("recordings") / sequence.name if folder is None else folder
