"""The file that a recording is written to, with and without pipes."""

from __future__ import annotations

import contextlib
import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dynaviz.views.pipe import PipeWriter


def test_every_byte_reaches_the_file(tmp_path: Path) -> None:
    content = np.random.default_rng(0).bytes(5_000_000)
    with (
        contextlib.closing(PipeWriter(tmp_path / "file")) as writer,
        open(writer.inlet, "wb", buffering=0) as inlet,
    ):
        for start in range(0, len(content), 700_000):
            inlet.write(content[start : start + 700_000])
            writer.settle()
            assert (tmp_path / "file").stat().st_size == min(start + 700_000, len(content))
    assert (tmp_path / "file").read_bytes() == content


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_raises_an_error_and_does_not_block() -> None:
    writer = PipeWriter(Path("/dev/full"))
    with open(writer.inlet, "wb", buffering=0) as inlet:
        for _ in range(40):  # more than the capacity of the pipe
            inlet.write(bytes(100_000))
    with pytest.raises(OSError, match=os.strerror(errno.ENOSPC)):
        writer.settle()
    with pytest.raises(OSError, match=os.strerror(errno.ENOSPC)):
        writer.close()
    writer.close()


WITHOUT_PIPES = """
import sys
import rerun  # the Linux build of a package it needs imports resource
for name in ("fcntl", "termios", "resource"):
    sys.modules[name] = None  # importing it raises an ImportError, as on Windows
sys.path[:0] = {folders!r}
import dynaviz as dv
from dynaviz.views.pipe import PIPES
from dynaviz.views.read.reader import RunRecording
from helpers.worlds import room

assert not PIPES
result = dv.run("octomap", room(3, 300), out={out!r}, settings=("resolution=0.5",))
recording = RunRecording({out!r} + "/run.rrd")
assert recording.result.labels_sha256 == result.labels_sha256
assert result.runtime.peak_rss_mb is None
assert len(list(recording.answers())) == len(list(recording.drawn())) == 3
dv.compare(recording.path, recording.path, out={out!r} + "/compare.rrd")
"""


@pytest.mark.slow
def test_without_the_modules_of_linux_a_run_is_recorded(tmp_path: Path) -> None:
    code = WITHOUT_PIPES.format(folders=[str(Path(__file__).parents[1])], out=str(tmp_path / "out"))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert {"run.rrd", "compare.rrd", "result.json"} <= {
        path.name for path in (tmp_path / "out").iterdir()
    }
