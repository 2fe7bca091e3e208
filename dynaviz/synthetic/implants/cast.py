"""Put movers into one scan, ray by ray."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynaviz.arrays import F32, F64, I32, I64, U8, U16, Bool, Intp
from dynaviz.contracts.scan import Label, Scan
from dynaviz.spatial.scan_ground import EDGE, NEAR, ScanGround
from dynaviz.synthetic.implants.implant_scene import CLASS_NAMES, CLASSES, Implant, ImplantScene
from dynaviz.synthetic.implants.lidar_model import LidarModel, ranges_of
from dynaviz.synthetic.ray_caster import RayCaster
from dynaviz.synthetic.simulate.shapes import Mesh

GRAZING = 0.05  # cosine between ray and surface normal below which nothing returns


@dataclass(frozen=True, eq=False)
class RayHits:
    """The nearest mover along some rays; all arrays (N,).

    Attributes:
        range: float64, metres; infinite if no mover is hit.
        mover: int64, its position in the list of targets; -1 if none is hit.
        facing: float64, cosine between ray and surface normal.
    """

    range: F64
    mover: I64
    facing: F64


@dataclass(frozen=True, eq=False)
class Target:
    """A mover during one scan.

    Attributes:
        mesh: at the time of the scan, metres, relative to the sensor's position.
        kind: its class number.
        instance: its instance number.
        velocity: (3,) float64, m/s, during the sweep.
    """

    mesh: Mesh
    kind: int
    instance: int
    velocity: F64


def implant(scan: Scan, scene: ImplantScene, lidar: LidarModel, static: Bool | None = None) -> Scan:
    """Put the movers of a scene into a scan.

    A ray that meets a mover before its own return gets the mover's return, with range noise, or
    loses its return: with the drop-out rate, at a grazing angle, or outside the range limits of the
    lidar. Rays without a return that meet a mover add points at the end. All other points keep
    their values and their order. If points have times, each ray meets the movers where they are at
    that time.

    Args:
        scan: a scan, with or without ground truth.
        scene: the movers.
        lidar: range limits, and the rays without a return.
        static: (N,) bool: points that count as static if they have no label of their own.

    Returns:
        The scan with labels; implanted points have the class numbers of ``CLASSES`` and the mover's
        instance.
    """
    targets = _targets(scan, scene)
    rng = np.random.default_rng([scene.seed, 3, scan.index])
    kind = np.array([target.kind for target in targets], np.uint16)
    instance = np.array([target.instance for target in targets], np.int32)

    own = ranges_of(scan)
    start = np.broadcast_to(scan.origins - scan.position, (len(scan), 3))
    with np.errstate(divide="ignore", invalid="ignore"):
        towards = (scan.points - scan.origins) / own[:, None]
    times = np.zeros(len(scan)) if scan.times is None else scan.times.astype(np.float64)
    hits = cast(targets, start, towards, np.where(np.isfinite(own), own, 0.0), times)
    rows = np.flatnonzero(hits.mover >= 0)
    measured, returned = _measure(_rows(hits, rows), scene, lidar, rng)
    points = scan.points.copy()
    points[rows] = (start[rows] + towards[rows] * measured[:, None] + scan.position).astype(
        np.float32
    )
    kept = np.ones(len(scan), np.bool_)
    kept[rows] = returned

    directions, limits, before = lidar.missing_rays(scan)
    sky = cast(targets if scene.sky_rays else [], start[before], directions, limits, times[before])
    met = np.flatnonzero(sky.mover >= 0)
    distance, seen = _measure(_rows(sky, met), scene, lidar, rng)
    added = met[seen]
    source = before[added]
    new = (start[source] + directions[added] * distance[seen, None] + scan.position).astype(
        np.float32
    )

    labels, classes, instances = _truth(scan, static)
    labels[rows] = Label.DYNAMIC
    classes[rows] = kind[hits.mover[rows]]
    instances[rows] = instance[hits.mover[rows]]
    mover = sky.mover[added]
    return replace(
        scan,
        points=np.concatenate([points[kept], new]),
        labels=np.concatenate([labels[kept], np.full(len(new), Label.DYNAMIC, np.uint8)]),
        classes=np.concatenate([classes[kept], kind[mover]]),
        instances=np.concatenate([instances[kept], instance[mover]]),
        origins=np.concatenate([scan.origins[kept], scan.origins[source]])
        if len(scan.origins) > 1
        else scan.origins,
        times=None
        if scan.times is None
        else np.concatenate([scan.times[kept], scan.times[source]]),
        class_names={**scan.class_names, **CLASS_NAMES},
    )


def _targets(scan: Scan, scene: ImplantScene) -> list[Target]:
    """The movers that are present at the time of a scan."""
    time = scene.time(scan)
    found = []
    during = (
        (0.0, 0.0) if scan.times is None or not len(scan) else (scan.times.min(), scan.times.max())
    )
    ground = ScanGround.of(scan.points, scan.position)
    for mover in scene.movers:
        if (mesh := grounded(mover, time, ground, scan.position)) is not None:
            velocity = mover.velocity(time + float(during[0]), time + float(during[1]))
            mesh = Mesh(mesh.vertices - scan.position, mesh.triangles)
            found.append(Target(mesh, CLASSES[mover.kind], mover.instance, velocity))
    return found


def grounded(mover: Implant, time: float, ground: ScanGround, position: F64) -> Mesh | None:
    """A mover at a time in seconds, world frame, raised or lowered to the ground that a scan shows.

    None if absent.

    By the median height of its path above this ground, near the sensor, at ``position`` (3,),
    metres. So it stands on the road of each scan, though poses drift in height.
    """
    if (mesh := mover.mesh(time)) is None:
        return None
    cells = np.floor(mover.path[:, :2] / EDGE).astype(np.int64) - ground.first
    near = np.hypot(*(mover.path[:, :2] - position[:2]).T) < NEAR
    near &= ((cells >= 0) & (cells < len(ground.number))).all(1)
    near[near] = ground.number[tuple(cells[near].T)] > 0
    if not near.any():
        return mesh
    above = np.median(ground.heights(mover.path[near].astype(np.float32)))
    return Mesh(mesh.vertices - (0.0, 0.0, float(above)), mesh.triangles)


def cast(targets: list[Target], origins: F64, directions: F64, limits: F64, times: F64) -> RayHits:
    """Find the nearest mover along rays (N, 3), unit directions, closer than the limits (N,) in
    metres.

    A ray meets a mover in motion where a ray whose origin moves the opposite way meets it at rest.
    Origins and meshes are near zero, so float32 is exact to less than a millimetre.
    """
    found = RayHits(
        np.full(len(origins), np.inf), np.full(len(origins), -1, np.int64), np.zeros(len(origins))
    )
    if not targets or not len(origins):
        return found
    for number, target in enumerate(targets):
        start = origins - times[:, None] * target.velocity
        rows = np.flatnonzero(
            _may_hit(target.mesh, start, directions, np.minimum(limits, found.range))
        )
        if not len(rows):
            continue
        rays: F32 = np.concatenate([start[rows], directions[rows]], axis=1).astype(np.float32)
        distance, facing, _ = RayCaster([target.mesh]).cast(rays)
        near = (distance < limits[rows]) & (distance < found.range[rows])
        rows = rows[near]
        found.range[rows] = distance[near]
        found.mover[rows] = number
        found.facing[rows] = facing[near]
    return found


def _may_hit(mesh: Mesh, origins: F64, directions: F64, limits: F64) -> Bool:
    """(N,) bool: rays that pass through the bounding sphere of a mesh within their limits."""
    low, high = mesh.bounds
    radius = float(np.sqrt(((high - low) ** 2).sum())) / 2 + 0.05
    (cx, cy, cz) = ((low + high) / 2 - origins).T
    (dx, dy, dz) = directions.T
    along = cx * dx + cy * dy + cz * dz
    aside = cx * cx + cy * cy + cz * cz - along * along
    may: Bool = (aside <= radius * radius) & (along > -radius) & (along - radius < limits)
    return may


def _rows(hits: RayHits, rows: Intp) -> RayHits:
    return RayHits(hits.range[rows], hits.mover[rows], hits.facing[rows])


def _measure(
    hits: RayHits, scene: ImplantScene, lidar: LidarModel, rng: np.random.Generator
) -> tuple[F64, Bool]:
    """Range with noise, metres, and whether the ray returns."""
    distance = hits.range + rng.normal(0, scene.range_noise, len(hits.range))
    returned = (rng.random(len(hits.range)) >= scene.drop_out) & (hits.facing > GRAZING)
    returned &= (distance >= lidar.min_range) & (distance <= lidar.max_range)
    return distance, returned


def _truth(scan: Scan, static: Bool | None) -> tuple[U8, U16, I32]:
    """Labels, classes and instances of the scan's own points, as writable copies."""
    labels = (
        np.full(len(scan), Label.UNLABELLED, np.uint8)
        if scan.labels is None
        else scan.labels.copy()
    )
    if static is not None:
        labels[static & (labels == Label.UNLABELLED)] = Label.STATIC
    classes = np.zeros(len(scan), np.uint16) if scan.classes is None else scan.classes.copy()
    instances = np.zeros(len(scan), np.int32) if scan.instances is None else scan.instances.copy()
    return labels, classes, instances
