"""The public DUFOMap program (``pip install dufomap``) as a method of dynaviz.

An example of wrapping another program as a method, in a package of its own. It needs this file, one
line in ``pyproject.toml``, and

    pip install ./examples/dufomap_wheel
    dynaviz run dufomap_wheel PATH --set d_p=2
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dynaviz.contracts.method import Context, Labels, MethodInfo, Reason
from dynaviz.contracts.probe import Scalar, State
from dynaviz.contracts.scan import Scan


@dataclass(frozen=True)
class Params:
    """Each field is a parameter for ``--set d_s=0.3``, presets and ``dynaviz list``.

    Attributes:
        resolution: edge of a voxel, metres.
        d_s: distance in front of a point that counts as hit, metres.
        d_p: distance from unknown space, in voxels, within which no voxel is void.
        min_range: points nearer to the sensor are not integrated, metres.
        max_range: points farther from the sensor are not integrated, metres.
    """

    resolution: float = 0.1
    d_s: float = 0.2
    d_p: int = 1
    min_range: float = 0.2
    max_range: float = 50.0

    def __post_init__(self) -> None:
        # The user sees this message as written: state what to give.
        if not self.resolution > 0:
            raise ValueError(f"resolution = {self.resolution}: give a number above 0")
        if not (self.d_s >= 0 and self.d_p >= 0):
            raise ValueError(f"d_s = {self.d_s}, d_p = {self.d_p}: give numbers of 0 or more")


class DufoMapWheel:
    """The C++ implementation of DUFOMap by its authors."""

    info: ClassVar[MethodInfo] = MethodInfo(
        name="dufomap_wheel",
        title="DUFOMap (public program)",
        paper="Duberg, Zhang et al., RA-L 2024",
        reasons=(  # by code
            Reason("void_seen", "removed: its voxel was void in some scan"),
            Reason("never_void", "kept: its voxel was not void in any scan"),
            Reason("not_finite", "kept unjudged"),
        ),
        emits=(
            State("integrated", Scalar, "Number of points of this scan within the range limits"),
        ),
    )
    Params: ClassVar[type[Any]] = Params

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Start with an empty map.

        Import the program here, not at the top, so that ``dynaviz list`` stays fast.
        """
        from dufomap import dufomap

        self._probe = context.probe
        # On several threads, the program's labels vary between runs; the conformance kit detects
        # this.
        self._program = dufomap(
            self.params.resolution, self.params.d_s, self.params.d_p, num_threads=1
        )

    def observe(self, scan: Scan) -> None:
        """Integrate the points within range, from each ray origin (several only for merged
        sensors).
        """
        integrated = 0
        places = np.unique(scan.origins, axis=0)
        for place in places:
            points = scan.points[(scan.origins == place).all(1)] if len(places) > 1 else scan.points
            points = points[np.isfinite(points).all(1)]
            ranges = np.linalg.norm(points - place, axis=1)
            points = points[(ranges > self.params.min_range) & (ranges < self.params.max_range)]
            integrated += len(points)
            if len(points):
                T_world_sensor = scan.T_world_sensor.copy()
                T_world_sensor[:3, 3] = place
                # points are in the world frame
                self._program.run(points, T_world_sensor, cloud_transform=False)
        self._probe.emit("integrated", Scalar(integrated))

    def label(self, scan: Scan) -> Labels:
        """Label points dynamic if their voxel was ever void; reasons index ``info.reasons``."""
        dynamic = np.zeros(len(scan), np.bool_)
        finite = np.isfinite(scan.points).all(1)
        if finite.any():
            dynamic[finite] = self._program.segment(
                scan.points[finite], scan.T_world_sensor, cloud_transform=False
            )
        reasons = np.where(dynamic, 0, 1).astype(np.uint8)
        reasons[~finite] = 2
        return Labels(dynamic, reasons)
