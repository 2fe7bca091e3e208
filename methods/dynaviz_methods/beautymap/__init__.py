"""BeautyMap: the method, its map of columns, and its kernels."""

from dynaviz_methods.beautymap.method import BeautyMap, BeautyMapParams

__all__ = ["BeautyMap", "BeautyMapParams"]
