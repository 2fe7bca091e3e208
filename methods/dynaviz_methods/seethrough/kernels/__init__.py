"""Kernels of SeeThrough, loaded on first use."""
