from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def kitti_tracking_0012(shared: Path, tmp_path_factory) -> Path:
    """The real sequence in the benchmark's layout, unpacked once for all tests."""
    out = tmp_path_factory.mktemp("real")
    subprocess.run([sys.executable, shared / "data/unpack.py", out], check=True, stdout=subprocess.DEVNULL)
    return out / "unified/kitti_tracking_0012"
