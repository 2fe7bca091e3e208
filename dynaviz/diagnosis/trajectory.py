"""What poses tell by themselves: faults that they may have, and signs of them in the trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from dynaviz.arrays import F64
from dynaviz.diagnosis.finding import SHOWN, Confidence, Finding
from dynaviz.spatial import geometry

STEEP = 45.0  # degrees between the sensor's z axis and the world's

# Axes of a camera (x right, y down, z forward) in a lidar's frame (x forward, y left, z up).
T_LIDAR_CAMERA = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])

Pose = Callable[[F64], F64]


def swapped(T: F64, order: tuple[int, int, int, int]) -> F64:
    """The pose with the numbers of its quaternion (w, x, y, z) in another order."""
    return geometry.pose(T[:3, 3], geometry.quaternion(T[:3, :3])[list(order)])


def camera(T: F64) -> F64:
    """A pose of and in axes of a camera, in those of a lidar."""
    return T_LIDAR_CAMERA @ T @ geometry.inverse(T_LIDAR_CAMERA)


_INVERT = "Give the inverse of each pose, numpy.linalg.inv(T): the sensor's place in the world"
_CAMERA = ("Turn the poses into the lidar's: T_world_lidar = T_world_camera @ T_camera_lidar; KITTI's layout with "
           "calib.txt (semantickitti:PATH) does so")  # fmt: skip
_QUATERNION = "Swap the order: VIEWPOINT has tx ty tz qw qx qy qz, a TUM file x y z qx qy qz qw"
FAULTS: tuple[tuple[str, str, str, Pose], ...] = (
    ("poses inverted", "poses are T_sensor_world, not T_world_sensor", _INVERT, geometry.inverse),
    ("poses of a camera", "poses are a camera's (z forward, y down), not the lidar's", _CAMERA, camera),
    ("poses of a camera", "poses have the axes of a camera (z forward, y down)", _CAMERA,
     lambda T: T @ geometry.inverse(T_LIDAR_CAMERA)),
    ("quaternion order", "quaternions were written as x y z w, but read as w x y z", _QUATERNION,
     lambda T: swapped(T, (3, 0, 1, 2))),
    ("quaternion order", "quaternions were written as w x y z, but read as x y z w", _QUATERNION,
     lambda T: swapped(T, (1, 2, 3, 0))),
)  # fmt: skip


def jumps(positions: Sequence[int], indices: Sequence[int], poses: Sequence[F64]) -> Iterator[Finding]:
    """Steps and turns far beyond those around them."""
    T = np.array(poses)
    between = geometry.compose(geometry.inverse(T[:-1]), T[1:])
    follows = np.diff(positions) == 1
    ticks = np.maximum(np.diff(indices), 1) / max(float(np.median(np.diff(indices))), 1)
    steps = np.linalg.norm(between[:, :3, 3], axis=1) / np.maximum(ticks, 1)
    turns = np.array([angle(M) for M in between]) / np.maximum(ticks, 1)
    bad = []
    for k in map(int, np.flatnonzero(follows)):
        near = [n for n in range(max(k - 5, 0), min(k + 6, len(steps))) if n != k and follows[n]]
        if len(near) < 2:
            continue
        step, turn = np.median(steps[near]), np.median(turns[near])
        if steps[k] > 3 * step + 0.5 or turns[k] > 3 * turn + 8:
            bad.append((k, step, turn))
    if bad:
        k, step, turn = max(bad, key=lambda b: (steps[b[0]] > 3 * b[1] + 0.5, steps[b[0]], turns[b[0]]))
        what = (
            f"the pose jumps by {steps[k]:.1f} m and {turns[k]:.0f} degrees at frame {indices[k + 1]}; "
            f"around it a step has {step:.2f} m and {turn:.1f} degrees"
        )
        mend = "Mend the trajectory there, or clean the parts before and after apart with --frames A:B"
        frames = tuple(indices[b[0] + 1] for b in bad)
        yield Finding("poses jump", Confidence.LIKELY, what, mend, frames[:SHOWN], len(frames))


def standing(poses: Sequence[F64]) -> str | None:
    """In words, that all poses are the same; None where they are not."""
    if not all(np.allclose(pose, poses[0], atol=1e-6) for pose in poses):
        return None
    return (
        "all poses are zero (the identity)" if np.allclose(poses[0], np.eye(4), atol=1e-6) else "all poses are the same"
    )


def upright(poses: Sequence[F64]) -> Iterator[Finding]:
    """A sensor that lies on its side, or a drive straight up: axes were mixed up."""
    T = np.array(poses)
    tilt = _tilt(T)
    if tilt > STEEP:
        for name, what, mend, f in FAULTS[1:]:
            if (other := _tilt(np.array([f(pose) for pose in poses]))) < 20:
                said = f"{what}: the sensor is tilted by {tilt:.0f} degrees, read so by {other:.0f}"
                yield Finding(name, Confidence.LIKELY, said, mend)
                return
        said = f"the sensor's z axis is tilted by {tilt:.0f} degrees against the world's"
        mend = "Turn the world so that z is up; a sensor mounted like this is fine, but no method finds ground so"
        yield Finding("tilted", Confidence.PERHAPS, said, mend)
        return
    extent = np.ptp(T[:, :3, 3], axis=0)
    if extent[2] > 2.0 and extent[2] > 2 * np.hypot(*extent[:2]):
        name, what, mend, _ = FAULTS[1]
        said = f"{what}: the sensor climbs {extent[2]:.1f} m while it moves {np.hypot(*extent[:2]):.1f} m sideways"
        yield Finding(name, Confidence.LIKELY, said, mend)
        return
    yield from _backwards(T)


def _backwards(T: F64) -> Iterator[Finding]:
    """Facing against the way of travel, and level the more, the less it turned: x y z w read as w x y z."""
    other = np.array([swapped(pose, (3, 0, 1, 2)) for pose in T])
    if _facing(T) < -0.9 and _facing(other) > 0.9 and _tilt(T, 90) > _tilt(other, 90) + 3:
        name, what, mend, _ = FAULTS[3]
        said = f"{what}: the sensor faces backwards and tilts as it turns, by up to {_tilt(T, 90):.0f} degrees"
        yield Finding(name, Confidence.LIKELY, said, mend)


def _tilt(T: F64, percent: float = 50) -> float:
    """Degrees between z axes, over all poses."""
    return float(np.percentile(np.degrees(np.arccos(np.clip(T[:, 2, 2], -1, 1))), percent))


def _facing(T: F64) -> float:
    """Cosine between the x axis and the way of travel; 0 for a sensor that stands."""
    way = np.diff(T[:, :3, 3], axis=0)
    far = np.linalg.norm(way, axis=1)
    moving = far > 0.02
    if not moving.any():
        return 0.0
    return float(np.median((way[moving] * T[:-1, :3, 0][moving]).sum(1) / far[moving]))


def angle(T: F64) -> float:
    """Degrees of a rotation."""
    return float(np.degrees(np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1))))
