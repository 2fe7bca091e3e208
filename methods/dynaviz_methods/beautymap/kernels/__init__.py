"""Kernels of BeautyMap, loaded on first use."""
