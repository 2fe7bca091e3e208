"""How a lidar is mounted on the vehicle whose poses are given: the hypothesis of ``--extrinsic``.

The motion of the sensor between two scans, found by registration, and that of the vehicle, from
the poses, are the same motion seen from two frames. A few such motions, and the ground that the
scans see, determine the mount: what they do not determine is taken to be zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Any

import numpy as np

from dynaviz.arrays import F64
from dynaviz.sources.hypotheses.registration import register
from dynaviz.sources.hypotheses.views import ScanView, Surface, to_z
from dynaviz.spatial import geometry
from dynaviz.spatial.sensor_height import ground_plane

# standard deviations of what is compared
ROTATION = 0.005  # radians
TRANSLATION = 0.05  # metres
LEVEL = 0.03  # radians of the ground
LEVER = 5.0  # metres of the lever arm
DETERMINED = 3.0  # inverse variance, 1 / square metres, from which motions determine it
SEEN = 0.4  # share of cells around the sensor that show ground
POINTS = 3000  # of a scan that are registered
FEWEST = 2  # motions
FITS = 3.0  # standard deviations of a motion, median, of a mount that explains them


@dataclass(frozen=True)
class SensorMotion:
    """A motion between two scans.

    Attributes:
        given: (4, 4) of the vehicle, by the poses; seen: (4, 4) of the sensor, by registration.
        up: (3,) normal of the ground in the sensor frame; None if it is not seen.
        attitude: (3, 3) rotation of the vehicle in the world.
    """

    given: F64
    seen: F64
    up: F64 | None
    attitude: F64


def estimate_mount(pairs: Sequence[tuple[ScanView, ScanView]]) -> F64 | None:
    """T_vehicle_lidar (4, 4), metres, that explains the motions best; None if none does.

    Args:
        pairs: of scans between which the sensor moves by up to some metres; their points were
            placed by the given poses.
    """
    motions = [found for a, b in pairs if (found := _motion(a, b)) is not None]
    if len(motions) < FEWEST or not any(_moves(each) for each in motions):
        return None
    starts = sorted(quarter_turns(), key=lambda R: _error(R, motions))[:4]
    fits = [_fit(R, motions, np.eye(3)) for R in starts]
    best = min(range(len(fits)), key=lambda k: fits[k].cost)
    start = starts[best]
    arms = _determined(fits[best].jac)
    x = _fit(start, motions, arms).x
    motion = _residuals(x, start, motions, arms)[: 6 * len(motions)].reshape(-1, 6)
    if float(np.median(np.abs(motion).max(1))) > FITS:
        return None
    T = np.eye(4)
    T[:3, :3] = _rotation(x[:3]) @ start
    T[:3, 3] = arms @ x[3:]
    return T


def as_option(T: F64) -> str:
    """The text of ``--extrinsic`` for a mount, rounded to centimetres and tenths of a degree."""
    from scipy.spatial.transform import Rotation

    yaw, pitch, roll = Rotation.from_matrix(T[:3, :3]).as_euler("ZYX", degrees=True)
    place = [f"{round(float(each), 2) + 0.0:.2f}" for each in T[:3, 3]]
    turns = [f"{round(float(each), 1) + 0.0:.1f}" for each in (roll, pitch, yaw)]
    return ",".join([*place, *turns])


def ground_normal(points: F64) -> F64 | None:
    """(3,) normal of the ground, upwards, in the frame of the points (N, 3) from the sensor.

    None if no side of the sensor shows a ground.
    """
    best = SEEN
    found = None
    for axis in np.concatenate([np.eye(3), -np.eye(3)]):
        R = to_z(axis)
        _, share, normal = ground_plane(points @ R.T)
        if share > best:
            best = share
            found = R.T @ normal
    return found


def _motion(a: ScanView, b: ScanView) -> SensorMotion | None:
    """None if the scans cannot be registered."""
    given = geometry.inverse(a.T) @ b.T
    here = geometry.apply(geometry.inverse(a.T), a.points)
    there = geometry.apply(geometry.inverse(b.T), b.points)
    there = there[:: 1 + len(there) // POINTS]
    surface = Surface(here)
    guesses = [np.eye(4), *(_turned(R, given) for R in _usual())]
    guesses.sort(key=lambda T: -surface.overlap(geometry.apply(T, there[::3])))
    tried = []
    for guess in guesses[:2]:
        T = register(surface, geometry.apply(guess, there)) @ guess
        tried.append((surface.overlap(geometry.apply(T, there)), T))
    overlap, seen = max(tried, key=lambda row: row[0])
    if overlap < 0.3:
        return None
    local = geometry.apply(geometry.inverse(a.T), a.sample)
    return SensorMotion(given, seen, ground_normal(local), a.T[:3, :3])


def _moves(motion: SensorMotion) -> bool:
    return bool(np.linalg.norm(motion.given[:3, 3]) > 0.1)


def _turned(R: F64, given: F64) -> F64:
    """The motion of a sensor that is turned on the vehicle."""
    T = given.copy()
    T[:3, :3] = R.T @ given[:3, :3] @ R
    T[:3, 3] = R.T @ given[:3, 3]
    return T


def _usual() -> list[F64]:
    """Turns about the vertical axis, upright and upside down."""
    back = np.diag([1.0, -1.0, -1.0])
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turns = [np.linalg.matrix_power(quarter, k) for k in range(4)]
    return [*turns, *(turn @ back for turn in turns)]


def quarter_turns() -> Iterator[F64]:
    """All 24 rotations that turn axes into axes, the identity first."""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            R = np.zeros((3, 3))
            R[range(3), order] = signs
            if np.linalg.det(R) > 0:
                yield R


def _fit(start: F64, motions: Sequence[SensorMotion], arms: F64) -> Any:
    from scipy.optimize import least_squares

    begin = np.zeros(3 + arms.shape[1])
    return least_squares(_residuals, begin, args=(start, motions, arms), loss="soft_l1")


def _determined(jacobian: F64) -> F64:
    """(3, K): directions in which the motions determine the lever arm."""
    rows = jacobian[:-3]
    information = rows.T @ rows
    turns = information[:3, :3] + 1e-9 * np.eye(3)
    across = information[:3, 3:]
    arm = information[3:, 3:] - across.T @ np.linalg.solve(turns, across)
    known, axes = np.linalg.eigh(arm)
    found: F64 = axes[:, known > DETERMINED]
    return found


def _error(R: F64, motions: Sequence[SensorMotion]) -> float:
    rows = np.abs(_residuals(np.zeros(3), R, motions, np.zeros((3, 0))))
    return float(np.minimum(rows, 20.0).sum())


def _residuals(x: F64, start: F64, motions: Sequence[SensorMotion], arms: F64) -> F64:
    """Differences of the motions, six each, then of the ground, then of the lever arm."""
    R = _rotation(x[:3]) @ start
    arm = arms @ x[3:]
    rows = []
    level = []
    for each in motions:
        turn = R.T @ each.given[:3, :3] @ R
        rows.append(_vector(each.seen[:3, :3].T @ turn) / ROTATION)
        shift = R @ each.seen[:3, 3] + arm - each.given[:3, :3] @ arm - each.given[:3, 3]
        rows.append(shift / TRANSLATION)
        if each.up is not None:
            up = each.attitude @ R @ each.up
            level.append((up - np.array([0.0, 0.0, 1.0])) / LEVEL)
    found: F64 = np.concatenate([*rows, *level, arm / LEVER])
    return found


def _rotation(vector: F64) -> F64:
    from scipy.spatial.transform import Rotation

    R: F64 = Rotation.from_rotvec(vector).as_matrix()
    return R


def _vector(R: F64) -> F64:
    from scipy.spatial.transform import Rotation

    found: F64 = Rotation.from_matrix(R).as_rotvec()
    return found
