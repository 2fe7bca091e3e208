"""Open anything as one sequence: a path, several drives, or arrays; with estimated poses if that is asked for."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable
from typing import Any

from dynaviz.contracts.scan import Sequence, select_frames
from dynaviz.contracts.sensors import load_sensor
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.drives import Drives
from dynaviz.sources.datasets.in_memory import ArraySequence
from dynaviz.sources.odometry.estimated import is_odometry, open_estimated
from dynaviz.sources.options import SequenceOptions


def open_source(source: str | os.PathLike[str] | Iterable[Any], options: SequenceOptions) -> Sequence:
    """Open a path, a list of paths (drives in one world frame), or a list of ``(points, pose)``.

    Raises:
        DataError, UsageError, MissingDependency: as ``dynaviz.open``.
    """
    sensor = load_sensor(options.sensor) if options.sensor else None
    frames, stride = options.frames, options.stride
    if isinstance(source, list | tuple) and source and all(isinstance(each, str | os.PathLike) for each in source):
        whole = dataclasses.replace(options, frames=None, stride=1)
        return select_frames(Drives.of([open_source(each, whole) for each in source]), frames, stride)
    if not isinstance(source, str | os.PathLike):
        return select_frames(ArraySequence.of(source, options.points_in), frames, stride, sensor)
    if options.poses is not None and is_odometry(poses := os.fspath(options.poses)):
        sequence, _ = open_estimated(os.fspath(source), poses, None, frames, **options.of_format)
        return select_frames(sequence, None, stride, sensor)
    sequence = open_sequence(os.fspath(source), poses=options.poses, **options.of_format)
    return select_frames(sequence, frames, stride, sensor)
