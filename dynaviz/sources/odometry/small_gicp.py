"""VGICP (Koide et al., ICRA 2021) of the package ``small-gicp``.

Registers planes of a sweep to planes of a local map.

Sensors with few rows see the ground as rings that are metres apart. Registration of points to
points moves the rings onto those of the sweeps before, and tilts the sensor; registration of planes
does not.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from dynaviz.arrays import F64
from dynaviz.errors import MissingDependency
from dynaviz.spatial import geometry
from dynaviz.spatial.motion import deskewed_to_middle

# metres; edge of the voxels that thin out sweeps
FINEST = 0.05
COARSEST = 0.1
DENSE = 50_000  # points; sweeps with more are thinned out with edges twice as long
MAP = 5  # edge of the voxels of the map, in edges of those that thin out sweeps
NEIGHBOURS = 30  # points from which a plane is estimated: from two rows or more
# metres; points of the vehicle move with the sensor
NEAREST = (0.5, 2.0)
FARTHEST = 100.0
LONGEST = 2.0  # metres from a point to the mean of its voxel in the map
FEWEST = 100  # points of a sweep that is registered
ITERATIONS = 30


class SmallGicp:
    """VGICP of the package ``small-gicp`` with a constant velocity model, in one thread.

    Voxels of the map that no sweep has met for 100 sweeps are forgotten.
    """

    reference: ClassVar[float] = 0.5
    package: ClassVar[str] = "small-gicp"

    def __init__(self, reach: float) -> None:
        try:
            import small_gicp
        except ModuleNotFoundError:
            raise MissingDependency(
                "estimating poses needs small-gicp. Install it with: pip install small-gicp, or "
                "give poses "
                "with --poses FILE"
            ) from None
        self._gicp: Any = small_gicp
        self._edge = float(np.clip(reach / 250, FINEST, COARSEST))
        self._nearest = float(np.clip(reach / 15, *NEAREST))
        self._map = small_gicp.GaussianVoxelMap(MAP * self._edge)
        self._pose: F64 = np.eye(4)
        self._step: F64 = np.eye(4)
        self._begun = False

    def register(self, points: F64, times: F64 | None) -> F64:
        """As ``Odometry``."""
        if times is not None and len(times):
            points = deskewed_to_middle(points, times, self._step)
        ranges = np.sqrt((points * points).sum(1))
        points = points[(ranges > self._nearest) & (ranges < FARTHEST)]
        pose = geometry.compose(self._pose, self._step)
        if len(points) >= FEWEST:
            edge = self._edge * (2 if len(points) > DENSE else 1)
            sweep, _ = self._gicp.preprocess_points(points, edge, NEIGHBOURS, 1)
            if self._map.size():
                pose = self._registered(sweep, pose)
                self._step = geometry.compose(geometry.inverse(self._pose), pose)
            self._map.insert(sweep, pose)
        self._pose = pose
        return pose.copy()

    def _registered(self, sweep: Any, predicted: F64) -> F64:
        """The pose of a sweep. Its rotation is normalised.

        Small errors would grow from sweep to sweep.
        """
        found = self._gicp.align(
            self._map,
            sweep,
            predicted,
            max_correspondence_distance=LONGEST,
            num_threads=1,
            max_iterations=ITERATIONS,
        )
        T = np.array(found.T_target_source, np.float64)
        return geometry.pose(T[:3, 3], geometry.quaternion(T[:3, :3]))
