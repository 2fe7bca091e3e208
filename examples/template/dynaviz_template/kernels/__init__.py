"""Kernels of the template, loaded on first use."""
