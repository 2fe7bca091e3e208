"""Kernels of FreeDOM, loaded on first use."""
