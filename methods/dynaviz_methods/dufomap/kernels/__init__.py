"""Kernels of DUFOMap, loaded on first use."""
