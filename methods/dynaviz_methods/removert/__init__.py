"""Removert: the method."""

from dynaviz_methods.removert.method import Removert, RemovertParams

__all__ = ["Removert", "RemovertParams"]
