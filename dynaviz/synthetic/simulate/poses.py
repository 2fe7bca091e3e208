"""Errors of the poses that a mapping system gives.

Slow errors, drift with the distance, jitter of each frame.
"""

from __future__ import annotations

import numpy as np

from dynaviz.arrays import F64
from dynaviz.spatial import geometry
from dynaviz.synthetic.simulate.effects import Effects


def slow_errors(rng: np.random.Generator, frames: int, noise: tuple[float, float]) -> F64:
    """(frames, 4, 4) pose errors that drift like those of a SLAM system.

    Each keeps 0.8 of the previous one.

    Args:
        rng: random numbers.
        frames: number of frames.
        noise: standard deviations, metres and degrees.
    """
    steps = rng.normal(size=(frames, 6))
    for k in range(1, frames):
        steps[k] = 0.8 * steps[k - 1] + 0.6 * steps[k]
    return transforms(noise[0] * steps[:, :3], np.radians(noise[1]) * steps[:, 3:])


def transforms(shifts: F64, turns: F64) -> F64:
    """(N, 4, 4) transforms of (N, 3) shifts in metres and (N, 3) rotation vectors in radians."""
    from scipy.spatial.transform import Rotation

    T = np.tile(np.eye(4), (len(shifts), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    T[:, :3, 3] = shifts
    return T


def drift(rng: np.random.Generator, poses: F64, effects: Effects) -> F64:
    """(frames, 4, 4) errors that grow as those of an odometry without loop closure.

    Each step of the odometry has an error whose variance grows with the length of the step; later
    poses inherit it.

    Args:
        rng: random numbers.
        poses: (frames, 4, 4) float64, metres: true poses.
        effects: gives the standard deviations after 100 m.
    """
    noise = rng.normal(size=(len(poses), 6))
    lengths = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0, prepend=poses[:1, :3, 3]), axis=1)
    scale = np.sqrt(lengths / 100.0)[:, None]
    steps = transforms(
        effects.drift_m * scale * noise[:, :3], np.radians(effects.drift_deg) * scale * noise[:, 3:]
    )
    errors = np.tile(np.eye(4), (len(poses), 1, 1))
    for k in range(1, len(poses)):
        moved = geometry.compose(geometry.inverse(poses[k - 1]), poses[k])
        errors[k] = geometry.compose(
            geometry.compose(geometry.compose(geometry.inverse(moved), errors[k - 1]), moved),
            steps[k],
        )
    return errors


def jitter(rng: np.random.Generator, frames: int, effects: Effects) -> F64:
    """(frames, 4, 4) errors that are independent from frame to frame, as scan-to-map matching
    leaves them.
    """
    noise = rng.normal(size=(frames, 6))
    return transforms(
        effects.jitter_m * noise[:, :3], np.radians(effects.jitter_deg) * noise[:, 3:]
    )
