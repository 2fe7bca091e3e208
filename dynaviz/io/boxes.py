"""KITTI tracking's ``label_02`` files: one line per box and frame, with track ids."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file

_HINT = "Each line needs a frame, a track, a type and at least 14 numbers"
REGION = "DontCare"


@dataclass(frozen=True, slots=True)
class TrackBox:
    """An object in a frame, or an unlabelled image region (``kind`` DontCare, without a 3-D extent).

    Attributes:
        frame, track: as in the file; track is -1 for a region.
        kind: ``Car``, ``Pedestrian`` ...
        rectangle: left, top, right, bottom in the image of camera 2, pixels.
        size: height, width, length, metres.
        bottom: (x, y, z) of the centre of its bottom face, metres, rectified camera frame (x right, y down, z forward).
        yaw: rotation about the camera's y axis, radians.
    """

    frame: int
    track: int
    kind: str
    rectangle: tuple[float, float, float, float]
    size: tuple[float, float, float]
    bottom: tuple[float, float, float]
    yaw: float


def read_boxes(path: str | os.PathLike[str]) -> list[TrackBox]:
    """Read all boxes and regions of a sequence, in file order.

    Raises:
        DataError: if the file cannot be read or a line is not a valid box.
    """
    boxes = []
    with open_file(path, _HINT) as file:
        for number, line in enumerate(file, 1):
            try:
                boxes.append(_parse_box(line.decode("latin-1").split()))
            except (ValueError, OverflowError, IndexError):
                raise DataError(path, "not a valid box", at=f"line {number}", hint=_HINT) from None
    return boxes


def _parse_box(words: list[str]) -> TrackBox:
    frame, track = (int(np.int32(int(word))) for word in words[:2])
    numbers = [float(word) for word in words[6:17]]
    if not np.isfinite(numbers).all():
        raise ValueError("a number is not finite")
    left, top, right, bottom, height, width, length, x, y, z, yaw = numbers
    return TrackBox(frame, track, words[2], (left, top, right, bottom), (height, width, length), (x, y, z), yaw)
