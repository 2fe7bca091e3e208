"""How a sequence is opened: one set of options for the command line and for Python."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, TypedDict, Unpack


class SequenceKeywords(TypedDict, total=False):
    """The keyword arguments of Python functions that open a sequence; see ``SequenceOptions``."""

    frames: str | None
    stride: int
    sensor: str | None
    poses: str | os.PathLike[str] | None
    points_in: str | None
    deskew: bool | None
    extrinsic: str | None
    refine_poses: bool


@dataclass(frozen=True)
class SequenceOptions:
    """How to open a sequence. Every verb that opens one takes all of these, under the same names.

    Attributes:
        frames: ``A:B``, positions as in a Python slice.
        stride: use every N-th frame.
        sensor: name of the sensor, if the data do not name it or are wrong (``dynaviz list
            sensors``), or a TOML file.
        poses: for folders of scans, bags and arrays: a file with the sensor's poses (KITTI, TUM,
            CSV); for bags also a topic, or the TF frame to use as the world frame. For every
            format: ``small-gicp`` or another odometry, which estimates them once and keeps them in
            the folder of the run, or in ``recordings/SEQUENCE``.
        points_in: for folders, bags and arrays: ``sensor`` or ``world``, the frame of the stored
            points.
        deskew: for bags: False disables motion compensation of sweeps whose points have times.
        extrinsic: for folders, bags and arrays whose poses are those of a vehicle: the pose of the
            lidar on it, ``X,Y,Z,ROLL,PITCH,YAW`` in metres and degrees, or a file with one pose.
        refine_poses: register each scan to the scans around it (open3d), and use the refined poses.
            They are kept in the folder of the run as ``poses_refined.csv``.
    """

    frames: str | None = None
    stride: int = 1
    sensor: str | None = None
    poses: str | None = None
    points_in: str | None = None
    deskew: bool | None = None
    extrinsic: str | None = None
    refine_poses: bool = False

    @classmethod
    def of(cls, **keywords: Unpack[SequenceKeywords]) -> SequenceOptions:
        """From keyword arguments, where a path may be any path-like object."""
        given: dict[str, Any] = dict(keywords)
        for name in ("poses", "extrinsic", "sensor"):
            if isinstance(given.get(name), os.PathLike):
                given[name] = os.fspath(given[name])
        return cls(**given)

    @property
    def without_refinement(self) -> SequenceOptions:
        """The options of a run that refines the poses itself."""
        return replace(self, refine_poses=False)

    @property
    def words(self) -> list[str]:
        """The options on the command line."""
        words: list[str] = []
        for each in fields(self):
            value = getattr(self, each.name)
            flag = f"--{each.name.replace('_', '-')}"
            if value is False and each.default is None:
                words.append(flag.replace("--", "--no-", 1))
            elif value != each.default:
                words += [flag] if value is True else [flag, str(value)]
        return words

    @property
    def of_format(self) -> Mapping[str, Any]:
        """The options that the reader of a format may take, apart from poses."""
        return {"points_in": self.points_in, "deskew": self.deskew, "extrinsic": self.extrinsic}
