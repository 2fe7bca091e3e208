"""FreeDOM: the method, its map of clear space, and its kernels."""

from dynaviz_methods.freedom.method import Freedom, FreedomParams

__all__ = ["Freedom", "FreedomParams"]
