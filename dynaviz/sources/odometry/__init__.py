"""Poses where there are none.

Odometries, which are plug-ins (entry point group ``dynaviz.odometries``).
"""

from dynaviz.sources.odometry.estimate import EstimatedPoses, Odometry, estimate

__all__ = ["EstimatedPoses", "Odometry", "estimate"]
