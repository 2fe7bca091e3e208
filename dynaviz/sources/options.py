"""How a sequence is opened: one set of options for the command line and for Python."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class SequenceOptions:
    """How to open a sequence. Every verb that opens one takes all of these, under the same names.

    Attributes:
        frames: ``A:B``, positions as in a Python slice.
        stride: use every N-th frame.
        sensor: name of the sensor, if the data do not name it or are wrong (``dynaviz list sensors``), or a TOML file.
        poses: for folders of scans and for bags: a file with the sensor's poses (KITTI, TUM, CSV); for bags also a
            topic, or the TF frame to use as the world frame. For every format: ``small-gicp`` or another odometry,
            which estimates them once and keeps them in the folder of the run, or in ``recordings/SEQUENCE``.
        points_in: for folders and bags: ``sensor`` or ``world``, the frame of the stored points.
        deskew: for bags: False disables motion compensation of sweeps whose points have times.
        extrinsic: for folders and bags whose poses are those of a vehicle: the pose of the lidar on it,
            ``X,Y,Z,ROLL,PITCH,YAW`` in metres and degrees, or a file with one pose.
        refine_poses: register each scan to the scans around it (open3d), and use the refined poses. They are kept in
            the folder of the run as ``poses_refined.csv``.
    """

    frames: str | None = None
    stride: int = 1
    sensor: str | None = None
    poses: str | os.PathLike[str] | None = None
    points_in: str | None = None
    deskew: bool | None = None
    extrinsic: str | None = None
    refine_poses: bool = False

    def __post_init__(self) -> None:
        if self.poses is not None:
            object.__setattr__(self, "poses", os.fspath(self.poses))

    @property
    def of_format(self) -> dict[str, Any]:
        """The options that the reader of a format may take."""
        return {"points_in": self.points_in, "deskew": self.deskew, "extrinsic": self.extrinsic}
