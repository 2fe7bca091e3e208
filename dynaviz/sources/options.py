"""How a sequence is opened: one set of options for the command line and for Python."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, TypedDict, Unpack

from dynaviz.contracts.options import option
from dynaviz.errors import UsageError

Frames = str | slice | range | tuple[int | None, int | None]
"""Frames of a drive: ``A:B``, ``slice(A, B)``, ``range(A, B)`` or ``(A, B)``, positions as in a
Python slice; a slice and a range may have a step."""


class SequenceKeywords(TypedDict, total=False):
    """The keyword arguments of Python functions that open a sequence; see ``SequenceOptions``."""

    frames: Frames | None
    stride: int
    sensor: str | None
    poses: str | os.PathLike[str] | None
    points_in: str | None
    deskew: bool | None
    extrinsic: str | None
    refine_poses: bool


@dataclass(frozen=True)
class SequenceOptions:
    """How to open a sequence.

    Every verb that opens one takes all of these, under the same names.
    """

    frames: str | None = field(
        default=None,
        metadata=option(
            "Use only these frames, as in a Python slice.",
            more="'A:B', (A, B), slice(A, B) or range(A, B).",
            metavar="A:B",
            accepts="Frames | None",
        ),
    )
    stride: int = field(default=1, metadata=option("Use every N-th frame.", metavar="N"))
    sensor: str | None = field(
        default=None,
        metadata=option(
            "Sensor, if the data do not define it; see 'dynaviz list sensors'.",
            more="A name, or a TOML file. It also replaces one that the data state wrongly.",
            metavar="NAME|FILE.toml",
        ),
    )
    poses: str | None = field(
        default=None,
        metadata=option(
            "Sensor poses: a KITTI, TUM or CSV file, or an odometry that estimates them. For a bag "
            "also a topic or TF frame.",
            more="Estimated poses are kept in the folder of the run, or in recordings/SEQUENCE. "
            "For scans given as arrays also an array, (frames, 4, 4).",
            metavar="FILE|small-gicp",
            accepts="str | os.PathLike[str] | None",
        ),
    )
    points_in: str | None = field(
        default=None,
        metadata=option(
            "Coordinate frame of the stored points. [default: sensor]",
            more="For folders, bags and arrays: 'sensor' or 'world'.",
            typed=Literal["sensor", "world"] | None,
        ),
    )
    deskew: bool | None = field(
        default=None,
        metadata=option(
            "Compensate the motion during each sweep. [default: deskew]",
            more="For bags whose points have times.",
            flags=("--deskew/--no-deskew",),
        ),
    )
    extrinsic: str | None = field(
        default=None,
        metadata=option(
            "Pose of the lidar on the vehicle, or a file with it, if the poses are those of the "
            "vehicle.",
            more="In metres and degrees; for folders, bags and arrays.",
            metavar="X,Y,Z,ROLL,PITCH,YAW",
        ),
    )
    refine_poses: bool = field(
        default=False,
        metadata=option(
            "Register each scan to the scans around it to refine its pose.",
            more="Needs open3d. The poses are kept in the folder of the run as poses_refined.csv.",
            flags=("--refine-poses",),
        ),
    )

    @classmethod
    def of(cls, **keywords: Unpack[SequenceKeywords]) -> SequenceOptions:
        """From keyword arguments, where a path may be any path-like object."""
        given: dict[str, Any] = dict(keywords)
        for name in ("poses", "extrinsic", "sensor"):
            if isinstance(given.get(name), os.PathLike):
                given[name] = os.fspath(given[name])
        if not isinstance(given.get("frames"), str | None):
            (given["frames"], step) = _frames_and_step(given["frames"])
            if step != 1 and given.get("stride", 1) != 1:
                raise UsageError(
                    f"stride = {given['stride']}: the frames have the step {step} already. Give one"
                )
            given["stride"] = step if step != 1 else given.get("stride", 1)
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


def _frames_and_step(frames: Any) -> tuple[str, int]:
    """The frames of a slice, a range or a pair as ``A:B``, and their step.

    Raises:
        UsageError: for anything else.
    """
    if isinstance(frames, slice | range):
        ends = (frames.start, frames.stop)
        step = 1 if frames.step is None else frames.step
    elif isinstance(frames, tuple | list) and len(frames) == 2:
        ends = tuple(frames)
        step = 1
    else:
        raise UsageError(
            f"frames = {frames!r}: give 'A:B', (A, B), slice(A, B) or range(A, B), positions as "
            "in a Python slice"
        )
    if not all(end is None or isinstance(end, int) for end in (*ends, step)):
        raise UsageError(f"frames = {frames!r}: positions of frames are whole numbers")
    return ":".join("" if end is None else str(end) for end in ends), step
