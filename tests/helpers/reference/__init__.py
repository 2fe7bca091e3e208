"""Slow, simple implementations of the methods, point by point, for comparison."""
