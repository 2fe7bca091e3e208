"""Labels from boxes with track ids: what the data sets of driving cars have instead of a label for each point."""

from __future__ import annotations

from collections.abc import Collection, Container, Iterable
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, Bool, Intp
from dynaviz.datasets.truth import Truth
from dynaviz.scan import Label

MOVING = 0.5  # metres a second over its life, from which a track is dynamic
SLACK = 0.05  # metres by which a box is grown, for its sides are drawn tight
RIM = 0.25  # metres around a moving box in which nobody knows
FEET = 0.12  # metres at the bottom of the grown box that are ground


@dataclass(frozen=True, slots=True, eq=False)
class OrientedBox:
    """An object in a frame.

    Attributes:
        track: the object's number, from 1 on; the same in all frames.
        kind: the number of its class, from 1 on; 0 where the data set's class has none.
        T_frame_box: (4, 4) float64, metres. The box's frame has its origin in the middle of the bottom, x along the
            length, z up; the other frame is that of the points.
        size: length, width, height, metres.
        guessed: nobody drew it in this frame; where it moves, its points are unlabelled.
    """

    track: int
    kind: int
    T_frame_box: F64
    size: tuple[float, float, float]
    guessed: bool = False


def moving_tracks(sightings: Iterable[tuple[int, float, F64]], speed: float = MOVING) -> frozenset[int]:
    """Tracks that end elsewhere than they begin: faster than ``speed`` over their life.

    Args:
        sightings: track, time in seconds, and position (3,) float64, metres, world frame; in the order of time.
        speed: metres a second.
    """
    first: dict[int, tuple[float, F64]] = {}
    last: dict[int, tuple[float, F64]] = {}
    for track, seconds, position in sightings:
        first.setdefault(track, (seconds, position))
        last[track] = seconds, position
    moving = set()
    for track, (start, origin) in first.items():
        end, goal = last[track]
        if np.sqrt(((goal - origin) ** 2).sum()) > speed * (end - start):
            moving.add(track)
    return frozenset(moving)


def track_facts(tracks: Collection[int], moving: Collection[int]) -> dict[str, str]:
    """What is worth telling of all tracks of a sequence."""
    return {"objects with boxes": f"{len(tracks):,}, of which {len(moving):,} move"} if tracks else {}


def boxed_truth(points: F64, boxes: Iterable[OrientedBox], moving: Container[int], known: Bool | None = None) -> Truth:
    """Truth of a frame's points: dynamic in moving boxes, unlabelled around them, static elsewhere.

    Args:
        points: (N, 3) float64, metres, in the frame of the boxes; those that are not finite are in no box.
        boxes: all objects of the frame, moving or not.
        moving: tracks that move.
        known: (N,) bool, where somebody looked for objects; all else is unlabelled. Default: everywhere.
    """
    n = len(points)
    classes, instances = np.zeros(n, np.uint16), np.zeros(n, np.int32)
    rim, dynamic = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    for box in boxes:
        rows, local = _near(points, box)
        inside = rows[_inside(local, box, SLACK, FEET)]
        if box.kind:
            classes[inside], instances[inside] = box.kind, box.track
        if box.track in moving:
            rim[rows[_inside(local, box, RIM)]] = True
            if not box.guessed:
                dynamic[inside] = True
    labels = np.full(n, Label.STATIC, np.uint8)
    if known is not None:
        labels[~known] = Label.UNLABELLED
    labels[rim] = Label.UNLABELLED
    labels[dynamic] = Label.DYNAMIC
    return Truth(labels, classes, instances)


def _near(points: F64, box: OrientedBox) -> tuple[Intp, F64]:
    """Rows of points that may lie in a box or its rim, and (rows, 3) where they are in its frame."""
    origin, axes = box.T_frame_box[:3, 3], box.T_frame_box[:3, :3]
    reach = sum(box.size) + 2 * RIM  # more than to any corner
    rows = np.flatnonzero(np.abs(points[:, 0] - origin[0]) < reach)
    rows = rows[np.abs(points[rows, 1] - origin[1]) < reach]
    x, y, z = (points[rows, axis] - origin[axis] for axis in range(3))
    return rows, np.stack([axes[0, k] * x + axes[1, k] * y + axes[2, k] * z for k in range(3)], axis=1)


def _inside(local: F64, box: OrientedBox, margin: float, feet: float = 0.0) -> Bool:
    """Which points in the box's frame lie in it, grown by a margin, but for its feet."""
    length, width, height = box.size
    along, across, up = local.T
    inside: Bool = (np.abs(along) < length / 2 + margin) & (np.abs(across) < width / 2 + margin)
    inside &= (up > feet - margin) & (up < height + margin)
    return inside
