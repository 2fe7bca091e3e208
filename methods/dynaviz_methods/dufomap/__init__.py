"""DUFOMap: the method, its void voxels, and its kernels."""

from dynaviz_methods.dufomap.method import DufoMap, DufoMapParams

__all__ = ["DufoMap", "DufoMapParams"]
