"""Scans prepared for comparison.

Downsampled points, surfaces, and the path of the sensor during the sweep.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property

import numpy as np

from dynaviz.arrays import F64, Intp
from dynaviz.contracts.scan import Scan
from dynaviz.spatial import geometry
from dynaviz.spatial.grid import voxel_downsample
from dynaviz.spatial.sensor_height import sensor_height

Pose = Callable[[F64], F64]

CELL = 0.4  # metres; voxel size for comparing scans
SAMPLE = 20_000  # points in which hidden ones are counted
REACH = 80.0  # metres from the median along each axis; farther points are too sparse
ON_SURFACE = 0.1  # metres; largest distance from a plane of a point that lies on it
# metres and degrees between the two scans of a pair
MIN_MOVE = 1.0
MIN_TURN = 5.0
MAX_APART = 40  # frames between the two scans of a pair
MIN_POINTS = 50  # downsampled points that a scan needs to be compared
SWEEP = 0.1  # seconds; duration of a sweep, at most, if frames have times
NEIGHBOUR = 5  # frames to a neighbour that shows the speed
LONGEST = 1.5  # metres; the sensor's way during half a sweep, at most


class ScanView:
    """A downsampled scan for comparison.

    Args:
        scan: the scan.
        around: (2, 4, 4) float64, metres: given poses one sweep before and one after the scan; None
            if it stands still.

    Attributes:
        index: number of the frame.
        T: (4, 4) float64, metres: the given pose.
        stamp: the frame's time, nanoseconds, or None.
        points: (N, 3) float64, metres, given world frame: one point per voxel of ``CELL``.
        sample: (M, 3) float64, metres, given world frame: up to ``SAMPLE`` random points, with the
            density of the scan.
    """

    def __init__(self, scan: Scan, around: F64 | None = None) -> None:
        self.index = scan.index
        self.T = scan.T_world_sensor
        self.stamp = scan.stamp_ns
        self._around = np.empty((0, 4, 4)) if around is None else around
        xyz = scan.points[np.isfinite(scan.points).all(1)]
        middle = np.median(xyz, axis=0) if len(xyz) else np.zeros(3)
        xyz = xyz[(np.abs(xyz - middle) < REACH).all(1)]
        xyz = xyz[np.random.default_rng(0).permutation(len(xyz))]
        self.sample = xyz[:SAMPLE].astype(np.float64)
        local = xyz - middle
        chosen, _ = voxel_downsample(local.astype(np.float32, copy=False), CELL)
        self.points = local[chosen].astype(np.float64) + middle

    @cached_property
    def surface(self) -> Surface:
        """The surfaces on which the points lie."""
        return Surface(self.points)

    def path(self, pose: Pose) -> F64:
        """Positions of the sensor during the sweep, (K, 3) metres, the frame's own first.

        The points of a sweep are measured while the sensor moves, and the pose may be that of any
        moment of the sweep.

        Args:
            pose: T_world_sensor, from a given pose.
        """
        here = pose(self.T)[:3, 3]
        ways = np.array([pose(T)[:3, 3] - here for T in self._around]).reshape(-1, 3)
        length = np.linalg.norm(ways, axis=1, keepdims=True)
        ways = ways * np.minimum(1.0, LONGEST / np.maximum(length, 1e-9))
        along: F64 = here + np.concatenate([np.zeros((1, 3)), ways, ways / 2])
        return along


class Surface:
    """A plane through each point and its 8 nearest neighbours.

    A plane is computed when it is first asked for.

    Args:
        points: (N, 3) float64, metres.
    """

    def __init__(self, points: F64) -> None:
        from scipy.spatial import cKDTree

        self.points = points
        self.tree = cKDTree(points)
        self._normals = np.zeros_like(points)
        self._known = np.zeros(len(points), np.bool_)

    def heights(self, points: F64) -> tuple[F64, F64]:
        """Signed height above the plane of the nearest point, (N,) metres, inf beyond 1 m, and its
        normal, (N, 3).
        """
        distances, nearest = self.tree.query(points, distance_upper_bound=1.0)
        found = np.isfinite(distances)
        row = np.where(found, nearest, 0)
        normals = self._normals_of(row)
        return np.where(found, ((points - self.points[row]) * normals).sum(1), np.inf), normals

    def _normals_of(self, rows: Intp) -> F64:
        """(K, 3): of the planes of some points, (K,)."""
        new = np.unique(rows[~self._known[rows]])
        if len(new):
            neighbours = self.tree.query(self.points[new], min(9, len(self.points)))[1]
            around = self.points[neighbours]
            centred = around - around.mean(1, keepdims=True)
            scatter = np.einsum("nki,nkj->nij", centred, centred)
            self._normals[new] = np.linalg.eigh(scatter)[1][:, :, 0]
            self._known[new] = True
        normals: F64 = self._normals[rows]
        return normals

    def overlap(self, points: F64) -> float:
        """Share of points that lie on the surfaces."""
        return float((np.abs(self.heights(points)[0]) < ON_SURFACE).mean())


def hidden(points: F64, path: F64, surfaces: F64 | None = None) -> float:
    """Share of points that lie well behind surfaces, seen from everywhere on a path.

    Bins of one degree.

    Args:
        points: (N, 3) float64, metres.
        path: (K, 3) float64, metres: positions of the sensor while it measured the points.
        surfaces: (M, 3) float64, metres: points on surfaces; None for the same points.
    """
    left = np.arange(len(points))
    for origin in path:
        cell, ranges = _bins(points[left], origin)
        others, distances = (cell, ranges) if surfaces is None else _bins(surfaces, origin)
        if surfaces is None and len(left) < len(points):
            others, distances = _bins(points, origin)
        nearest = np.full(361 * 181, np.inf)
        np.minimum.at(nearest, others, distances)
        left = left[ranges > 1.2 * nearest[cell] + 0.5]
        if not len(left):
            return 0.0
    return len(left) / max(len(points), 1)


def _bins(points: F64, origin: F64) -> tuple[Intp, F64]:
    """(N,) bin of one degree of each point seen from an origin, and its range, metres."""
    rays = points - origin
    ranges = np.maximum(np.sqrt((rays * rays).sum(1)), 1e-6)
    azimuth = np.degrees(np.arctan2(rays[:, 1], rays[:, 0])) + 180
    elevation = np.degrees(np.arcsin(np.clip(rays[:, 2] / ranges, -1, 1))) + 90
    return np.floor(azimuth).astype(np.intp) * 181 + np.floor(elevation).astype(np.intp), ranges


def pairs(
    positions: Sequence[int],
    poses: Sequence[F64],
    usable: Sequence[bool],
    number: int = 6,
    skipped: int = 0,
) -> list[tuple[int, int]]:
    """Pairs of scans over the whole sequence, apart by ``MIN_MOVE`` or ``MIN_TURN`` if possible.

    Args:
        positions, poses, usable: of the scans.
        number: of pairs, at most.
        skipped: rows to skip at the start, for other pairs of the same sequence.

    Returns:
        Pairs of rows of the arguments.
    """
    rows = [row for row, ok in enumerate(usable) if ok][skipped:]
    chosen: list[tuple[int, int]] = []
    if not rows:
        return chosen
    for k in np.unique(np.linspace(0, max(len(rows) - 2, 0), number).astype(int)):
        first = rows[k]
        last = None
        for row in rows[k + 1 :]:
            if positions[row] - positions[first] > MAX_APART:
                break
            last = row
            if apart(poses[first], poses[row]):
                break
        if last is not None:
            chosen.append((first, last))
    return chosen


def apart(a: F64, b: F64) -> bool:
    """Whether the sensor moved or turned enough between two poses for interpretations to differ."""
    T = geometry.inverse(a) @ b
    return bool(np.linalg.norm(T[:3, 3]) > MIN_MOVE or angle(T) > MIN_TURN)


def comparable(views: Iterable[ScanView]) -> bool:
    """Whether each scan has enough points to be compared."""
    return all(len(view.points) > MIN_POINTS for view in views)


def around(
    row: int, positions: Sequence[int], poses: Sequence[F64], stamps: Sequence[int | None]
) -> F64 | None:
    """Poses one sweep before and one after a scan, (2, 4, 4) metres, from the frames next to it.

    None without any.

    Only the positions are meaningful: they continue the way to the neighbouring frame at a constant
    speed.
    """
    found = []
    for other in (row - 1, row + 1):
        gap = abs(positions[other] - positions[row]) if 0 <= other < len(poses) else 0
        if not 0 < gap <= NEIGHBOUR:
            continue
        a = stamps[row]
        b = stamps[other]
        seconds = abs(a - b) / 1e9 if a is not None and b is not None else 0.0
        share = min(1.0, SWEEP / seconds) if seconds > 0 else 1.0 / gap
        T = poses[row].copy()
        T[:3, 3] += share * (poses[other][:3, 3] - T[:3, 3])
        found.append(T)
    if len(found) == 1:
        mirrored = poses[row].copy()
        mirrored[:3, 3] = 2 * mirrored[:3, 3] - found[0][:3, 3]
        found.append(mirrored)
    return np.array(found) if found else None


def ground_below(view: ScanView, up: F64, position: F64 | None = None) -> tuple[float, float]:
    """The ground of a scan around the sensor, if an axis of the world points up.

    Args:
        view: the scan.
        up: (3,) unit vector along an axis, world frame.
        position: (3,) metres: of the sensor; None for the given one.

    Returns:
        As from ``sensor_height``.
    """
    return sensor_height(
        (view.sample - (view.T[:3, 3] if position is None else position)) @ to_z(up).T
    )


def to_z(up: F64) -> F64:
    """Rotation that turns an axis of the world to z by the shortest way, (3, 3)."""
    z = np.array([0.0, 0.0, 1.0])
    if up @ z < -0.5:
        return np.diag([1.0, -1.0, -1.0])
    v = np.cross(up, z)
    K = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    R: F64 = np.eye(3) + K + K @ K
    return R


def angle(T: F64) -> float:
    """Rotation angle of a pose, degrees."""
    return float(np.degrees(np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1))))
