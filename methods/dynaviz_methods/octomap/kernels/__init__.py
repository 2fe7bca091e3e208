"""Kernels of OctoMap, loaded on first use."""
