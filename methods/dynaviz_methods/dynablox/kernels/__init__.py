"""Kernels of Dynablox, loaded on first use."""
