"""Write simulated sequences in the public benchmark's layout."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from dynaviz.contracts.sensors import load_sensor
from dynaviz.io.benchmark import BenchmarkWriter
from dynaviz.synthetic.simulate.classes import BY_EFFECTS, CLASS_NAMES
from dynaviz.synthetic.simulate.options import Chosen
from dynaviz.synthetic.simulate.parallel import sweeps

VERSION = 1  # increase whenever the same preset and seed give different points


def simulate(
    preset: str,
    out: Path,
    frames: int | None = None,
    seed: int | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Write a simulated sequence.

    Scans in the world frame, one labelled cloud of all scans, and ``sequence.toml``.

    The same preset, frames and seed give the same bytes. The folder is written completely or not at
    all.

    Args:
        preset: a name in ``PRESETS``, with options if needed:
            ``street_hdl64?jitter_m=0.03&brushing=6``.
        out: folder to create; it must not exist yet.
        frames: number of sweeps; None for that of the options or the preset's default.
        seed: random seed; each seed gives another scene of the same kind. None for that of the
            options, or 0.
        progress: called with the number of finished sweeps and the total.

    Raises:
        UsageError: for an unknown preset or option, a negative seed, or a number of frames below 1
            or beyond the sensor's route.
        DataError: if ``out`` exists or cannot be written.
    """
    chosen = Chosen.parse(preset, frames, seed)
    out = Path(out)
    preset_ = chosen.preset
    frames = chosen.frames
    seed = chosen.seed
    merged = bool(load_sensor(preset_.sensor).mounts)
    with BenchmarkWriter(out) as writer:
        for sweep in sweeps(preset_, frames, seed):
            lidar = sweep.lidar if merged else None
            writer.append(sweep.index, sweep.points, sweep.T_world_sensor, sweep.intensity, lidar)
            writer.append_truth(sweep.points, sweep.labels, sweep.kinds, sweep.instances)
            progress(sweep.index + 1, frames)
        facts: dict[str, Any] = {"name": out.name, "title": preset_.title, "preset": preset_.name}
        facts |= {"sensor": preset_.sensor, "seed": seed, "frames": frames}
        facts |= {"rate": load_sensor(preset_.sensor).rate, "generator": VERSION}
        names = {
            k: name for k, name in CLASS_NAMES.items() if chosen.effects or k not in BY_EFFECTS
        }
        writer.describe(facts | chosen.effects, names)
    return out
