"""Poses where there are none: odometries, which are plug-ins (entry point group ``dynaviz.odometries``)."""

from dynaviz.sources.odometry.contract import Odometry
from dynaviz.sources.odometry.estimate import EstimatedPoses, estimate

__all__ = ["EstimatedPoses", "Odometry", "estimate"]
