"""Checks of the poses alone: known pose faults, and their signs in the trajectory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations

import numpy as np

from dynaviz.arrays import F64
from dynaviz.diagnosis.finding import SHOWN, Confidence, Finding
from dynaviz.sources.hypotheses.views import Pose, angle
from dynaviz.spatial import geometry

# Camera axes (x right, y down, z forward) in the lidar frame (x forward, y left, z up).
T_LIDAR_CAMERA = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])

ORDER = "quaternion order"  # name of the finding
MAX_TILT = 45.0  # degrees between the sensor's z axis and the world's


def swapped(T: F64, order: tuple[int, ...]) -> F64:
    """The pose with the components of its quaternion (w, x, y, z) in another order."""
    return _swapped(T.tobytes(), order).copy()


@lru_cache(4096)  # the same few poses are interpreted again and again
def _swapped(pose: bytes, order: tuple[int, ...]) -> F64:
    T = np.frombuffer(pose).reshape(4, 4)
    return geometry.pose(T[:3, 3], geometry.quaternion(T[:3, :3])[list(order)])


def camera(T: F64) -> F64:
    """A camera pose with camera axes, converted to lidar axes."""
    return T_LIDAR_CAMERA @ T @ geometry.inverse(T_LIDAR_CAMERA)


@dataclass(frozen=True)
class PoseFault:
    """A common mistake in poses.

    Attributes:
        name: name of the finding.
        problem: what is wrong with the poses, in words.
        fix: how to fix it, a sentence.
        correct: the correct pose T_world_sensor, given the faulty one.
        reading: what the numbers are, in a few words; empty if the name says it.
    """

    name: str
    problem: str
    fix: str
    correct: Pose
    reading: str = ""


_INVERT = "Invert each pose, numpy.linalg.inv(T), to give the sensor's position in the world"
_CAMERA = ("Convert each pose on both sides: T_lidar_cam @ T @ T_cam_lidar, with the calibration "
"of camera and lidar. "
           "KITTI's layout with calib.txt (semantickitti:PATH) does this")  # fmt: skip
_CAMERA_AXES = (
    "Multiply each pose by the calibration on the right only: T_world_lidar = T_world_cam @ "
    "T_cam_lidar"
)
INVERTED = PoseFault(
    "poses inverted", "poses are T_sensor_world, not T_world_sensor", _INVERT, geometry.inverse
)
CAMERA = PoseFault(
    "poses of a camera",
    "poses are a camera's (z forward, y down), not the lidar's",
    _CAMERA,
    camera,
)
CAMERA_AXES = PoseFault(
    "poses of a camera",
    "poses have the axes of a camera (z forward, y down)",
    _CAMERA_AXES,
    lambda T: T @ geometry.inverse(T_LIDAR_CAMERA),
)


def _order(
    order: tuple[int, ...], problem: str = "the components of quaternions are in another order"
) -> PoseFault:
    """Quaternions of which the components w x y z were read at these positions of w x y z."""
    held = ["q" + "wxyz"[order.index(k)] for k in (1, 2, 3, 0)]
    reading = " ".join(held)
    fix = (
        f"Swap the components: those read as qx qy qz qw hold {reading}. "
        "A TUM file has x y z qx qy qz qw, VIEWPOINT has tx ty tz qw qx qy qz"
    )
    return PoseFault(ORDER, problem, fix, lambda T: swapped(T, order), reading)


W_LAST = _order((3, 0, 1, 2), "quaternions were written as x y z w, but read as w x y z")
W_FIRST = _order((1, 2, 3, 0), "quaternions were written as w x y z, but read as x y z w")
_NED = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
NED = PoseFault(
    "poses in NED",
    "poses are in a world north-east-down, of a sensor with axes forward-right-down",
    "Convert each pose on both sides: M @ T @ diag(1, -1, -1, 1), with M = [[0, 1, 0, 0], [1, 0, "
    "0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]",
    lambda T: _NED @ T @ np.diag([1.0, -1.0, -1.0, 1.0]),
)
_OTHERS = map(
    _order, sorted({*permutations(range(4))} - {(0, 1, 2, 3), (3, 0, 1, 2), (1, 2, 3, 0)})
)
FAULTS = (INVERTED, CAMERA, CAMERA_AXES, W_LAST, W_FIRST, NED, *_OTHERS)


def jumps(
    positions: Sequence[int], indices: Sequence[int], poses: Sequence[F64]
) -> Iterator[Finding]:
    """Find steps and turns that are much larger than their neighbours."""
    T = np.array(poses)
    between = geometry.compose(geometry.inverse(T[:-1]), T[1:])
    follows = np.diff(positions) == 1
    ticks = np.maximum(np.diff(indices), 1) / max(float(np.median(np.diff(indices))), 1)
    steps = np.linalg.norm(between[:, :3, 3], axis=1) / np.maximum(ticks, 1)
    turns = np.array([angle(M) for M in between]) / np.maximum(ticks, 1)
    jumped = []
    for k in map(int, np.flatnonzero(follows)):
        near = [n for n in range(max(k - 5, 0), min(k + 6, len(steps))) if n != k and follows[n]]
        if len(near) < 2:
            continue
        step = np.median(steps[near])
        turn = np.median(turns[near])
        if steps[k] > 3 * step + 0.5 or turns[k] > 3 * turn + 8:
            jumped.append((k, step, turn))
    if jumped:
        k, step, turn = max(
            jumped, key=lambda b: (steps[b[0]] > 3 * b[1] + 0.5, steps[b[0]], turns[b[0]])
        )
        problem = (
            f"the pose jumps by {steps[k]:.1f} m and {turns[k]:.0f} degrees at frame "
            f"{indices[k + 1]}; "
            f"the median of nearby steps is {step:.2f} m and {turn:.1f} degrees"
        )
        fix = (
            "Fix the trajectory there, or clean the parts before and after it separately with "
            "--frames A:B"
        )
        frames = tuple(indices[b[0] + 1] for b in jumped)
        yield Finding("poses jump", Confidence.LIKELY, problem, fix, frames[:SHOWN], len(frames))


def identical(poses: Sequence[F64], posed: bool = True) -> str | None:
    """A sentence if all poses are the same; None if they differ.

    Args:
        poses: (4, 4) float64 each, metres.
        posed: whether the sequence has any.
    """
    if not posed:
        return "no poses were found"
    if not all(np.allclose(pose, poses[0], atol=1e-6) for pose in poses):
        return None
    return (
        "all poses are zero (the identity)"
        if np.allclose(poses[0], np.eye(4), atol=1e-6)
        else "all poses are the same"
    )


def backwards(T: F64) -> str | None:
    """Evidence for a sensor that faces backwards and tilts as it turns: x y z w read as w x y z.

    None if absent.
    """
    corrected = np.array([W_LAST.correct(pose) for pose in T])
    if facing(T) < -0.9 and facing(corrected) > 0.9 and tilt_of(T, 90) > tilt_of(corrected, 90) + 3:
        return (
            f"the sensor faces backwards and tilts as it turns, by up to {tilt_of(T, 90):.0f} "
            "degrees"
        )
    return None


def tilt_of(T: F64, percent: float = 50) -> float:
    """Percentile over all poses of the angle between the sensor's z axis and the
    world's, degrees.
    """
    return float(np.percentile(np.degrees(np.arccos(np.clip(T[:, 2, 2], -1, 1))), percent))


def facing(T: F64) -> float:
    """Median cosine between the x axis and the direction of travel; 0 for a stationary sensor.

    Long ways, between frames that are far apart, are left out: they cut corners.
    """
    steps = np.diff(T[:, :3, 3], axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    moving = lengths > 0.02
    if not moving.any():
        return 0.0
    moving &= lengths <= 5 * np.median(lengths[moving])
    return float(np.median((steps[moving] * T[:-1, :3, 0][moving]).sum(1) / lengths[moving]))
