"""Kernels of HMM-MOS, loaded on first use."""
