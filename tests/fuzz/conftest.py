"""The little sequences of the data sets' own tests."""

from test_argoverse2 import log
from test_kitti import odometry, training
from test_kitti_raw import drive
from test_nuscenes import root

__all__ = ["drive", "log", "odometry", "root", "training"]
