"""Dynablox: the method, its map of free space, and its kernels."""

from dynaviz_methods.dynablox.method import Dynablox, DynabloxParams

__all__ = ["Dynablox", "DynabloxParams"]
