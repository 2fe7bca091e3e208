"""Kernels of several methods, loaded on first use."""
