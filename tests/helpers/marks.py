"""Marks for tests of kernels; ``boundscheck`` and ``plain`` are described in pyproject.toml."""

from __future__ import annotations

import os

import pytest

compiled_only = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT", "0") != "0",
    reason="kernels convert NaN to an integer, which is an error in plain Python",
)
