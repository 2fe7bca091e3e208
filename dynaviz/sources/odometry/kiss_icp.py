"""KISS-ICP (Vizzo et al., RA-L 2023).

Point-to-point registration to a local map, with a constant velocity model.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from dynaviz.arrays import F64
from dynaviz.errors import MissingDependency
from dynaviz.spatial.motion import deskewed_to_middle

# metres; bounds of the range that is used
LONGEST = 100.0
SHORTEST = 20.0


class KissIcp:
    """KISS-ICP of the package ``kiss-icp``, with its parameters for the given range.

    It runs in one thread: sums in several threads differ from run to run.

    Sweeps are deskewed to their middle, not by KISS-ICP to their end: the speed is unknown in the
    first sweeps, and what they place in the map is right for their middle on average. Deskewed to
    the end, all later sweeps would be half a sweep's way apart from it.
    """

    reference: ClassVar[float] = 0.5
    package: ClassVar[str] = "kiss-icp"

    def __init__(self, reach: float) -> None:
        try:
            from kiss_icp.config import KISSConfig
            from kiss_icp.kiss_icp import KissICP
        except ModuleNotFoundError:
            raise MissingDependency(
                "estimating poses needs KISS-ICP. Install it with: pip install kiss-icp, or give "
                "poses with "
                "--poses FILE"
            ) from None
        config: Any = KISSConfig()
        config.data.max_range = float(np.clip(2 * reach, SHORTEST, LONGEST))
        config.data.deskew = False
        config.mapping.voxel_size = config.data.max_range / 100.0
        config.registration.max_num_threads = 1
        self._kiss: Any = KissICP(config)

    def register(self, points: F64, times: F64 | None) -> F64:
        """As ``Odometry``."""
        if times is not None and len(times):
            points = deskewed_to_middle(points, times, np.array(self._kiss.last_delta, np.float64))
        self._kiss.register_frame(points, np.empty(0))
        pose: F64 = np.array(self._kiss.last_pose, np.float64)
        return pose
