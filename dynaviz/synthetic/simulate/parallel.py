"""Simulate a sequence in several processes, because the ray caster blocks the other threads of its
own.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from dynaviz.contracts.sensors import load_sensor
from dynaviz.errors import DynavizError
from dynaviz.synthetic.simulate.lidar import sweep_rays
from dynaviz.synthetic.simulate.presets import Preset
from dynaviz.synthetic.simulate.recording import SimulatedSweep, build, record_sweeps

PROCESSES = 4  # at most
WORTH = 5_000_000  # rays per process; fewer take little longer than the start of a process


def sweeps(preset: Preset, frames: int, seed: int) -> Iterator[SimulatedSweep]:
    """Simulate the sweeps in order, on several cores if they are many.

    The sweeps do not depend on how many.

    Raises:
        DynavizError: if a process dies.
    """
    rays = frames * len(sweep_rays(load_sensor(preset.sensor), 0, np.random.default_rng()).lidar)
    count = max(1, min(PROCESSES, os.cpu_count() or 1, rays // WORTH))
    with contextlib.ExitStack() as stack:
        shares = [range(first, frames, count) for first in range(count)]
        others = [
            stack.enter_context(_process(preset, frames, seed, share)) for share in shares[1:]
        ]
        own = record_sweeps(build(preset, frames, seed), preset, frames, seed, shares[0])
        streams = [own, *(_received(other) for other in others)]
        for index in range(frames):
            yield next(streams[index % count])


@contextlib.contextmanager
def _process(*share: Any) -> Iterator[subprocess.Popen[bytes]]:
    """A process that simulates a share of the sweeps; it ends with the block."""
    command = [sys.executable, "-P", "-m", "dynaviz.synthetic.simulate.worker"]
    # In a session of its own, so that Ctrl-C interrupts only the process that the user started.
    child = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=sys.platform != "win32",
    )
    try:
        assert child.stdin
        with contextlib.suppress(BrokenPipeError):  # it died; reading reports that
            child.stdin.write(pickle.dumps(share))
            child.stdin.close()
        yield child
    finally:
        child.kill()
        assert child.stdout
        child.stdout.close()
        child.wait()


def _received(child: subprocess.Popen[bytes]) -> Iterator[SimulatedSweep]:
    assert child.stdout
    while True:
        try:
            yield pickle.load(child.stdout)
        except (EOFError, pickle.UnpicklingError):
            raise DynavizError(
                f"a process of the simulation ended with exit code {child.wait()}. "
                "Memory may have run out: simulate fewer frames, or close other programs"
            ) from None
