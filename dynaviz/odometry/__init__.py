"""Poses where there are none: odometries, which are plug-ins (entry point group ``dynaviz.odometries``)."""

from dynaviz.odometry.contract import Odometry
from dynaviz.odometry.estimate import EstimatedPoses, estimate

__all__ = ["EstimatedPoses", "Odometry", "estimate"]
