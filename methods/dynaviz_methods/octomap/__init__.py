"""OctoMap: the method, its filters of the ground and of outliers, and its kernels."""

from dynaviz_methods.octomap.method import OctoMap, OctoMapG, OctoMapGF, OctoMapParams

__all__ = ["OctoMap", "OctoMapG", "OctoMapGF", "OctoMapParams"]
