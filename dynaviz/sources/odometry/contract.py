"""The contract of odometries, which estimate the pose of each sweep from its points and the sweeps before."""

from __future__ import annotations

from typing import ClassVar, Protocol

from dynaviz.arrays import F64


class Odometry(Protocol):
    """Estimates poses, one sweep after the other.

    Attributes:
        reference: time in the sweep to which its pose refers, for sweeps whose points have times: 0 for the first
            point, 1 for the last.
        package: the distribution that implements it, whose version is part of the cache's key.

    Args:
        reach: metres: range within which most points lie.

    Raises:
        MissingDependency: if the package is not installed.
    """

    reference: ClassVar[float]
    package: ClassVar[str]

    def __init__(self, reach: float) -> None: ...

    def register(self, points: F64, times: F64 | None) -> F64:
        """Estimate the pose of the next sweep.

        Args:
            points: (N, 3) float64, metres, sensor frame, each at its own time; finite.
            times: (N,) float64, seconds; when each point was measured. None if the sweep is already compensated for
                motion, or the times are unknown.

        Returns:
            (4, 4) float64, metres: the pose in the frame of the first sweep.
        """
        ...
