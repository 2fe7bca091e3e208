"""SeeThrough: its ground, its grid, what places inherit, and the method."""

from dynaviz_methods.seethrough.method import REASONS, REMOVED, SeeThrough, SeeThroughParams

__all__ = ["REASONS", "REMOVED", "SeeThrough", "SeeThroughParams"]
