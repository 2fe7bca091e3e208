"""The sequences of a bench: opened under their names there, scenes simulated first."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from dynaviz import api
from dynaviz.benchmarking.plan import SequenceSpec
from dynaviz.errors import DataError
from dynaviz.params import read_toml
from dynaviz.scan import Sequence, SequenceSlice
from dynaviz.simulate.presets import PRESETS


def open_source(source: SequenceSpec) -> Sequence:
    """Open a sequence of a bench, under its name there.

    Raises:
        DataError, UsageError: as ``dynaviz.open``.
    """
    frames = None if source.scene else source.frames
    opened = api.open(
        source.path,
        frames=str(frames) if frames else None,
        stride=source.stride,
        sensor=source.sensor,
        poses=source.poses,
        points_in=source.points_in,
        deskew=source.deskew,
    )
    return SequenceSlice(opened, range(len(opened)), opened.sensor, source.name)


def placed(source: SequenceSpec, out: Path) -> SequenceSpec:
    """A source with the path where it is, or will be simulated, for a bench in ``out``."""
    return replace(source, path=str((out / "sequences" / source.name).resolve())) if source.scene else source


def simulated(source: SequenceSpec, progress: Callable[[int, int], None]) -> None:
    """Write a scene to its place, unless it is there.

    Raises:
        DataError: where it cannot be written, or something else is in its place.
    """
    from dynaviz.simulate.recording import VERSION, simulate

    folder, frames = Path(source.path), source.frames or PRESETS[source.scene].frames
    if folder.exists():
        facts = read_toml(folder / "sequence.toml")
        wanted = {"preset": source.scene, "frames": frames, "seed": source.seed, "generator": VERSION}
        if all(facts.get(key) == value for key, value in wanted.items()):
            return
        if "generator" not in facts:
            raise DataError(folder, "is no simulated scene", hint="Remove it, or give the sequence another name")
        shutil.rmtree(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    simulate(source.scene, folder, int(frames), source.seed, progress)
