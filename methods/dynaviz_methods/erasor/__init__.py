"""ERASOR: the method, its polar bins, and its kernels."""

from dynaviz_methods.erasor.method import Erasor, ErasorParams

__all__ = ["Erasor", "ErasorParams"]
