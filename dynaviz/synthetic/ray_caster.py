"""Cast rays against meshes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dynaviz.arrays import F32, F64, Intp
from dynaviz.spatial import open3d
from dynaviz.synthetic.simulate.shapes import Mesh

SMALL = 20_000  # rays; fewer are not worth a second thread


class RayCaster:
    """Meshes in the acceleration structure of open3d.

    Args:
        meshes: in metres, numbered in this order.

    Raises:
        MissingDependency: if open3d cannot be loaded.
    """

    def __init__(self, meshes: Iterable[Mesh]) -> None:
        o3d = open3d.load("ray casting")
        self._tensor = o3d.core.Tensor.from_numpy
        # so that the structure is the same on any machine
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        for mesh in meshes:
            vertices = mesh.vertices.astype(np.float32)
            triangles = mesh.triangles.astype(np.uint32)
            self._scene.add_triangles(self._tensor(vertices), self._tensor(triangles))

    def cast(self, rays: F32) -> tuple[F64, F64, Intp]:
        """The nearest surface along each ray.

        Args:
            rays: (N, 6) float32, origin in metres and direction of unit length.

        Returns:
            Three arrays (N,): the range in metres, the cosine between ray and surface normal from 0
            to 1, and the number of the mesh. Where nothing is hit, the range is infinite and the
            number too large.
        """
        found = self._scene.cast_rays(self._tensor(rays), nthreads=1 if len(rays) < SMALL else 0)
        facing = np.abs((found["primitive_normals"].numpy() * rays[:, 3:]).sum(1, dtype=np.float64))
        return (
            found["t_hit"].numpy().astype(np.float64),
            facing,
            found["geometry_ids"].numpy().astype(np.intp),
        )

    def clearance(self, points: F32) -> F32:
        """(N,) float32, metres: the distance from (N, 3) float32 points to the nearest surface."""
        distance: F32 = self._scene.compute_distance(self._tensor(points)).numpy()
        return distance
