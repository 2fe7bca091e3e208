"""Benchmarks: methods x sequences x parameter sets, one folder per cell, resumed after an
interruption.

Private: other packages do not import it.
"""
