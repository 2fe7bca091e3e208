"""The file that a recording is written to."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from dynaviz.viz.pipe import PipeWriter


def test_a_tap_hands_on_every_byte(tmp_path: Path) -> None:
    content = np.random.default_rng(0).bytes(5_000_000)
    with PipeWriter(tmp_path / "file") as tap, open(tap.inlet, "wb", buffering=0) as inlet:
        for start in range(0, len(content), 700_000):
            inlet.write(content[start : start + 700_000])
            tap.settle()
            assert (tmp_path / "file").stat().st_size == min(start + 700_000, len(content))
    assert (tmp_path / "file").read_bytes() == content


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_tap_tells_of_a_full_disk_and_blocks_nobody() -> None:
    tap = PipeWriter(Path("/dev/full"))
    with open(tap.inlet, "wb", buffering=0) as inlet:
        for _ in range(40):  # more than the pipe holds
            inlet.write(bytes(100_000))
    with pytest.raises(OSError, match=os.strerror(errno.ENOSPC)):
        tap.settle()
    with pytest.raises(OSError, match=os.strerror(errno.ENOSPC)):
        tap.close()
    tap.close()
