"""KITTI raw's ``tracklet_labels.xml``: boxes with tracks, in the frame of the laser scanner."""

from __future__ import annotations

import os
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from dynaviz.arrays import F64
from dynaviz.errors import DataError
from dynaviz.io.atomic import opened

_HINT = "Copy the file again"


@dataclass(frozen=True, slots=True, eq=False)
class Tracklet:
    """An object over time.

    Attributes:
        kind: ``Car``, ``Pedestrian`` ...
        size: height, width, length, metres.
        first: number of the first frame.
        places: (frames, 4) float64: the middle of the bottom in metres, sensor frame, and the yaw about z in radians.
    """

    kind: str
    size: tuple[float, float, float]
    first: int
    places: F64


def read_tracklets(path: str | os.PathLike[str]) -> list[Tracklet]:
    """Read all tracklets of a drive.

    Raises:
        DataError: for a file that cannot be read, is no XML, or holds something that is no tracklet.
    """
    with opened(path, _HINT) as file:
        try:
            root = ElementTree.parse(file).getroot()
        except ElementTree.ParseError as error:
            raise DataError(path, "is no whole XML file", at=f"line {error.position[0]}", hint=_HINT) from None
    tracklets = root.find("tracklets")
    if tracklets is None:
        raise DataError(path, "has no tracklets", hint=_HINT)
    return [_tracklet(path, number, item) for number, item in enumerate(tracklets.findall("item"))]


def _tracklet(path: str | os.PathLike[str], number: int, item: ElementTree.Element) -> Tracklet:
    try:
        height, width, length = (float(item.findtext(name, "")) for name in "hwl")
        places = [
            [float(pose.findtext(name, "")) for name in ("tx", "ty", "tz", "rz")]
            for pose in item.iterfind("poses/item")
        ]
        kind, first = item.findtext("objectType", ""), int(item.findtext("first_frame", ""))
    except ValueError:
        problem = "lacks a number among h, w, l, first_frame, and tx, ty, tz, rz of its poses"
        raise DataError(path, problem, at=f"tracklet {number}", hint=_HINT) from None
    return Tracklet(kind, (height, width, length), first, np.array(places, np.float64).reshape(-1, 4))
