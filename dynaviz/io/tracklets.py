"""KITTI raw's ``tracklet_labels.xml``: boxes with track ids, in the lidar frame."""

from __future__ import annotations

import os
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from dynaviz.arrays import F64
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file

_HINT = "Copy the file again"


@dataclass(frozen=True, slots=True, eq=False)
class Tracklet:
    """An object over time.

    Attributes:
        kind: ``Car``, ``Pedestrian`` ...
        size: height, width, length, metres.
        first: number of the first frame.
        poses: (frames, 4) float64: centre of the bottom face in metres, sensor frame, and yaw about z in radians.
    """

    kind: str
    size: tuple[float, float, float]
    first: int
    poses: F64


def read_tracklets(path: str | os.PathLike[str]) -> list[Tracklet]:
    """Read all tracklets of a drive.

    Raises:
        DataError: if the file cannot be read, is not XML, or contains an invalid tracklet.
    """
    with open_file(path, _HINT) as file:
        try:
            root = ElementTree.parse(file).getroot()
        except ElementTree.ParseError as error:
            raise DataError(path, "not valid XML", at=f"line {error.position[0]}", hint=_HINT) from None
        except (LookupError, ValueError) as error:  # an unknown encoding, or one that the parser does not support
            raise DataError(path, f"not valid XML ({error})", at="line 1", hint=_HINT) from None
    tracklets = root.find("tracklets")
    if tracklets is None:
        raise DataError(path, "the element <tracklets> is missing", hint=_HINT)
    return [_tracklet(path, number, item) for number, item in enumerate(tracklets.findall("item"))]


def _tracklet(path: str | os.PathLike[str], number: int, item: ElementTree.Element) -> Tracklet:
    try:
        height, width, length = (float(item.findtext(name, "")) for name in "hwl")
        poses = [
            [float(pose.findtext(name, "")) for name in ("tx", "ty", "tz", "rz")]
            for pose in item.iterfind("poses/item")
        ]
        kind, first = item.findtext("objectType", ""), int(item.findtext("first_frame", ""))
        if not np.isfinite([height, width, length, *(x for pose in poses for x in pose)]).all():
            raise ValueError("not finite")
    except ValueError:
        problem = "a number is missing or not finite: h, w, l, first_frame, or tx, ty, tz, rz of a pose"
        raise DataError(path, problem, at=f"tracklet {number}", hint=_HINT) from None
    return Tracklet(kind, (height, width, length), first, np.array(poses, np.float64).reshape(-1, 4))
