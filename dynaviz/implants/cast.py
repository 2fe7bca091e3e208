"""Put movers into one scan, ray by ray."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynaviz.arrays import F32, F64, I32, I64, U8, U16, Bool, Intp
from dynaviz.implants.lidar import LidarModel, ranges_of
from dynaviz.implants.scene import CLASS_NAMES, CLASSES, ImplantScene
from dynaviz.scan import Label, Scan
from dynaviz.simulate.shapes import Mesh

GRAZING = 0.05  # cosine between ray and surface normal below which nothing returns


@dataclass(frozen=True, eq=False)
class Hits:
    """The nearest mover along some rays; all arrays (N,).

    Attributes:
        range: float64, metres; infinite if no mover is hit.
        mover: int64, its position in the list of meshes; -1 if none is hit.
        facing: float64, cosine between ray and surface normal.
    """

    range: F64
    mover: I64
    facing: F64


def implant(scan: Scan, scene: ImplantScene, lidar: LidarModel, static: Bool | None = None) -> Scan:
    """Put the movers of a scene into a scan.

    A ray that meets a mover before its own return gets the mover's return, with range noise, or loses its return: with
    the drop-out rate, at a grazing angle, or outside the range limits of the lidar. Rays without a return that meet a
    mover add points at the end. All other points keep their values and their order.

    Args:
        scan: a scan, with or without ground truth.
        scene: the movers.
        lidar: range limits, and the rays without a return.
        static: (N,) bool: points that count as static if they have no label of their own.

    Returns:
        The scan with labels; implanted points have the class numbers of ``CLASSES`` and the mover's instance.
    """
    time, base = scene.time(scan), scan.position
    present = [(mover, mesh) for mover in scene.implants if (mesh := mover.mesh(time)) is not None]
    meshes = [Mesh(mesh.vertices - base, mesh.triangles) for _, mesh in present]
    rng = np.random.default_rng([scene.seed, 3, scan.index])
    kind = np.array([CLASSES[mover.kind] for mover, _ in present], np.uint16)
    instance = np.array([mover.instance for mover, _ in present], np.int32)

    own = ranges_of(scan)
    start = np.broadcast_to(scan.origins - base, (len(scan), 3))
    with np.errstate(divide="ignore", invalid="ignore"):
        towards = (scan.points - scan.origins) / own[:, None]
    hits = cast(meshes, start, towards, np.where(np.isfinite(own), own, 0.0))
    rows = np.flatnonzero(hits.mover >= 0)
    measured, returned = _measure(_rows(hits, rows), scene, lidar, rng)
    points = scan.points.copy()
    points[rows] = (start[rows] + towards[rows] * measured[:, None] + base).astype(np.float32)
    kept = np.ones(len(scan), np.bool_)
    kept[rows] = returned

    origins, directions, limits = lidar.missing_rays(scan)
    sky = cast(meshes if scene.sky_rays else [], origins - base, directions, limits)
    met = np.flatnonzero(sky.mover >= 0)
    distance, seen = _measure(_rows(sky, met), scene, lidar, rng)
    added = met[seen]
    new = (origins[added] + directions[added] * distance[seen, None]).astype(np.float32)

    labels, classes, instances = _truth(scan, static)
    labels[rows], classes[rows], instances[rows] = Label.DYNAMIC, kind[hits.mover[rows]], instance[hits.mover[rows]]
    mover = sky.mover[added]
    rays = scan.origins
    if len(rays) > 1:
        rays = np.concatenate([rays[kept], origins[added]])
    return replace(
        scan,
        points=np.concatenate([points[kept], new]),
        labels=np.concatenate([labels[kept], np.full(len(new), Label.DYNAMIC, np.uint8)]),
        classes=np.concatenate([classes[kept], kind[mover]]),
        instances=np.concatenate([instances[kept], instance[mover]]),
        origins=rays,
        class_names={**scan.class_names, **CLASS_NAMES},
    )


def cast(meshes: list[Mesh], origins: F64, directions: F64, limits: F64) -> Hits:
    """Find the nearest mesh along rays (N, 3), unit directions, closer than the limits (N,) in metres.

    Origins and meshes are near zero, so float32 is exact to less than a millimetre.
    """
    found = Hits(np.full(len(origins), np.inf), np.full(len(origins), -1, np.int64), np.zeros(len(origins)))
    if not meshes or not len(origins):
        return found
    import open3d as o3d

    tensor = o3d.core.Tensor.from_numpy
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)  # so that the structure is the same on any machine
    for mesh in meshes:
        scene.add_triangles(tensor(mesh.vertices.astype(np.float32)), tensor(mesh.triangles.astype(np.uint32)))
    rows = np.flatnonzero(_may_hit(meshes, origins, directions, limits))
    rays: F32 = np.concatenate([origins[rows], directions[rows]], axis=1).astype(np.float32)
    answer = scene.cast_rays(tensor(rays))
    distance = answer["t_hit"].numpy().astype(np.float64)
    near = distance < limits[rows]
    rows = rows[near]
    found.range[rows] = distance[near]
    found.mover[rows] = answer["geometry_ids"].numpy()[near]
    found.facing[rows] = np.abs((answer["primitive_normals"].numpy() * rays[:, 3:]).sum(1, dtype=np.float64))[near]
    return found


def _may_hit(meshes: list[Mesh], origins: F64, directions: F64, limits: F64) -> Bool:
    """(N,) bool: rays that pass through the bounding sphere of a mesh within their limits."""
    (ox, oy, oz), (dx, dy, dz) = origins.T, directions.T
    may = np.zeros(len(origins), np.bool_)
    for mesh in meshes:
        low, high = mesh.bounds
        radius = float(np.sqrt(((high - low) ** 2).sum())) / 2 + 0.05
        x, y, z = (low + high) / 2
        cx, cy, cz = x - ox, y - oy, z - oz
        along = cx * dx + cy * dy + cz * dz
        aside = cx * cx + cy * cy + cz * cz - along * along
        may |= (aside <= radius * radius) & (along > -radius) & (along - radius < limits)
    return may


def _rows(hits: Hits, rows: Intp) -> Hits:
    return Hits(hits.range[rows], hits.mover[rows], hits.facing[rows])


def _measure(hits: Hits, scene: ImplantScene, lidar: LidarModel, rng: np.random.Generator) -> tuple[F64, Bool]:
    """Range with noise, metres, and whether the ray returns."""
    distance = hits.range + rng.normal(0, scene.range_noise, len(hits.range))
    returned = (rng.random(len(hits.range)) >= scene.drop_out) & (hits.facing > GRAZING)
    returned &= (distance >= lidar.min_range) & (distance <= lidar.max_range)
    return distance, returned


def _truth(scan: Scan, static: Bool | None) -> tuple[U8, U16, I32]:
    """Labels, classes and instances of the scan's own points, as writable copies."""
    labels = np.full(len(scan), Label.UNLABELLED, np.uint8) if scan.labels is None else scan.labels.copy()
    if static is not None:
        labels[static & (labels == Label.UNLABELLED)] = Label.STATIC
    classes = np.zeros(len(scan), np.uint16) if scan.classes is None else scan.classes.copy()
    instances = np.zeros(len(scan), np.int32) if scan.instances is None else scan.instances.copy()
    return labels, classes, instances
