"""The lidar as the scans show it.

Range noise, drop-outs, range limits, and the rays that have no return.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, Intp
from dynaviz.contracts.scan import Scan, Sequence
from dynaviz.contracts.sensors import Sensor
from dynaviz.spatial import geometry
from dynaviz.synthetic.implants.pattern import Pattern, Rings

SAMPLES = 8  # scans, evenly spaced over the sequence
PATCHES = 1500  # local planes per scan
NEIGHBOURS = 40  # points of a plane
LIDARS = 4  # at most, in one scan
DEFAULT_NOISE = 0.02  # metres


@dataclass(frozen=True, eq=False)
class Mount:
    """One lidar of a scan: its pose T_sensor_lidar (4, 4) and its pattern, None if not regular."""

    T_sensor_lidar: F64
    pattern: Pattern | None = None


@dataclass(frozen=True, eq=False)
class LidarModel:
    """What the scans show about the lidar.

    Attributes:
        range_noise: standard deviation of the range, metres.
        drop_out: share of rays that lose their return on a surface.
        min_range, max_range: metres.
        mounts: the lidars that were merged into one scan.
    """

    range_noise: float
    drop_out: float
    min_range: float
    max_range: float
    mounts: tuple[Mount, ...]

    @property
    def sky_rays(self) -> bool:
        """Whether the rays without a return are known."""
        return all(mount.pattern for mount in self.mounts)

    @classmethod
    def measure(cls, sequence: Sequence) -> LidarModel:
        """Measure the lidar on a few scans of a sequence.

        The numbers are rounded, so they repeat on every machine.
        """
        chosen = np.unique(np.linspace(0, len(sequence) - 1, SAMPLES).round().astype(int))
        scans = [sequence[int(position)] for position in chosen]
        mounts = _mounts(scans, sequence.sensor)
        ranges = np.concatenate([ranges_of(scan) for scan in scans])
        ranges = ranges[np.isfinite(ranges) & (ranges > 0)]
        rings = [
            found
            for scan in scans
            for mount, (_, local) in zip(mounts, _by_mount(scan, mounts), strict=True)
            if mount.pattern and (found := mount.pattern.rings(local))
        ]
        noise = np.concatenate([plane_noise(scan) for scan in scans])
        median = (
            float(np.median(noise))
            if len(noise) >= 50
            else sequence.sensor.range_noise or DEFAULT_NOISE
        )
        return cls(
            range_noise=round(median, 3),
            drop_out=round(drop_outs(rings), 3),
            min_range=sequence.sensor.min_range,
            max_range=round(float(ranges.max()), 1) if len(ranges) else 0.0,
            mounts=mounts,
        )

    def missing_rays(self, scan: Scan) -> tuple[F64, F64, Intp]:
        """The rays of a scan without a return.

        Returns:
            (K, 3) unit directions in the world frame; (K,) metres up to which each ray is free;
            (K,) row of the point measured before each, with the same origin.
        """
        directions = [np.empty((0, 3))]
        limits = [np.empty(0)]
        rows_before = [np.empty(0, np.intp)]
        for mount, (rows, local) in zip(self.mounts, _by_mount(scan, self.mounts), strict=True):
            rings = mount.pattern.rings(local) if mount.pattern and self.sky_rays else None
            if mount.pattern is None or rings is None or not rings.regular:
                continue
            T_world_lidar = geometry.compose(scan.T_world_sensor, mount.T_sensor_lidar)
            missing, limit, before = mount.pattern.missing(rings)
            directions.append(geometry.apply(T_world_lidar, missing) - T_world_lidar[:3, 3])
            limits.append(limit)
            rows_before.append(rows[before])
        return np.concatenate(directions), np.concatenate(limits), np.concatenate(rows_before)


def ranges_of(scan: Scan) -> F64:
    """(N,) float64: metres from the origin of its ray to each point."""
    x, y, z = (scan.points.astype(np.float64) - scan.origins).T
    distances: F64 = np.sqrt(x * x + y * y + z * z)
    return distances


def plane_noise(scan: Scan) -> F64:
    """Range noise in metres on patches of a scan that are flat and not seen at a grazing angle.

    A plane is fitted to the neighbours of random points. The deviation along the normal, divided by
    the cosine of the angle of incidence, is the deviation along the ray.
    """
    from scipy.spatial import cKDTree

    distances = ranges_of(scan)
    usable = np.flatnonzero((distances > 2) & (distances < 30))
    if len(usable) < 10 * NEIGHBOURS:
        return np.empty(0)
    points = scan.points[usable].astype(np.float64) - scan.position
    chosen = np.random.default_rng(0).choice(len(points), min(PATCHES, len(points)), replace=False)
    _, near = cKDTree(points).query(points[chosen], NEIGHBOURS)
    patch = points[near] - points[near].mean(1, keepdims=True)
    values, vectors = np.linalg.eigh((patch[:, :, :, None] * patch[:, :, None, :]).mean(1))
    rays = (
        scan.points[usable[chosen]] - np.broadcast_to(scan.origins, (len(scan), 3))[usable[chosen]]
    ).T
    normal = vectors[:, :, 0].T
    facing = np.abs((rays * normal).sum(0)) / distances[usable[chosen]]
    flat = (
        (values[:, 1] > 0.1 * values[:, 2]) & (values[:, 0] < 0.03 * values[:, 1]) & (facing > 0.3)
    )
    deviation = np.sqrt(np.maximum(values[:, 0], 0) * NEIGHBOURS / (NEIGHBOURS - 3))
    noise: F64 = (deviation / np.maximum(facing, 0.3))[flat]
    return noise


def drop_outs(rings: list[Rings]) -> float:
    """Share of missing returns on surfaces.

    Gaps of one or two rays whose ends have the same range within 3 %.
    """
    lost = returned = 0
    for ring in rings:
        missing = np.rint(ring.gap / ring.step) - 1
        same = np.abs(ring.range[ring.next] / ring.range - 1) < 0.03
        lost += int(missing[same & (missing >= 1) & (missing <= 2)].sum())
        returned += int(same.sum())
    return lost / (lost + returned) if returned else 0.0


def _mounts(scans: list[Scan], sensor: Sensor) -> tuple[Mount, ...]:
    """The lidars of a sequence.

    Those of the sensor if it merges several, otherwise one per origin of rays.
    """
    from dynaviz.synthetic.simulate.lidar import mounts as known_mounts

    if sensor.mounts:
        poses = known_mounts(sensor)
    else:
        origins = [
            geometry.apply(geometry.inverse(scan.T_world_sensor), scan.origins) for scan in scans
        ]
        places = np.unique(np.concatenate([np.unique(o.round(2), axis=0) for o in origins]), axis=0)
        if len(places) > LIDARS:  # the origins move during the sweep
            places = places.mean(0, keepdims=True)
        poses = [np.eye(4) for _ in places]
        for T, place in zip(poses, places, strict=True):
            T[:3, 3] = place
    mounts = [Mount(T) for T in poses]
    local = [[points for _, points in _by_mount(scan, mounts)] for scan in scans]
    return tuple(
        Mount(mount.T_sensor_lidar, Pattern.infer([points[number] for points in local]))
        for number, mount in enumerate(mounts)
    )


def _by_mount(scan: Scan, mounts: Iterable[Mount]) -> list[tuple[Intp, F64]]:
    """For each lidar the rows of its points, and their offsets from the origins of their rays in
    the lidar's frame.
    """
    poses = [geometry.compose(scan.T_world_sensor, mount.T_sensor_lidar) for mount in mounts]
    distances = np.stack([np.abs(scan.origins - T[:3, 3]).max(1) for T in poses])
    nearest = np.broadcast_to(distances.argmin(0), len(scan))
    finite = np.isfinite(scan.points).all(1)
    found = []
    for number, T in enumerate(poses):
        rows = np.flatnonzero((nearest == number) & finite)
        start = scan.origins if len(scan.origins) == 1 else scan.origins[rows]
        T_lidar_world = np.eye(4)
        T_lidar_world[:3, :3] = T[:3, :3].T
        found.append((rows, geometry.apply(T_lidar_world, scan.points[rows] - start)))
    return found
