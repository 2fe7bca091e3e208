"""Poses where there are none.

Odometries, which are plug-ins (entry point group ``dynaviz.odometries``).
"""

from dynaviz.sources.odometry.estimate import Odometry, estimate
from dynaviz.sources.origin import EstimatedPoses

__all__ = ["EstimatedPoses", "Odometry", "estimate"]
