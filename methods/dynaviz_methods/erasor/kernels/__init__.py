"""Kernels of ERASOR, loaded on first use."""
