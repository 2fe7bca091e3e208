"""The sequences of a bench: opened under the names of the plan; scenes are simulated first."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from dynaviz.benchmarking.plan import SequenceSpec
from dynaviz.contracts.params import read_toml
from dynaviz.errors import DataError
from dynaviz.sources.drive import Drive
from dynaviz.sources.opening import open_source
from dynaviz.synthetic.simulate.presets import PRESETS


def open_spec(source: SequenceSpec) -> Drive:
    """Open a sequence of a bench, under its name in the plan.

    Raises:
        DataError, UsageError: as ``dynaviz.open``.
    """
    return open_source(source.path, source.options.without_refinement).renamed(source.name)


def placed(source: SequenceSpec, out: Path) -> SequenceSpec:
    """The source with its path.

    For a scene the path to simulate it to, in the bench folder ``out``.
    """
    return (
        replace(source, path=str((out / "sequences" / source.name).resolve()))
        if source.scene
        else source
    )


def simulated(source: SequenceSpec, progress: Callable[[int, int], None]) -> None:
    """Simulate a scene, unless it is already there.

    Raises:
        DataError: if it cannot be written, or the folder contains something else.
    """
    from dynaviz.synthetic.simulate.write import VERSION, simulate

    folder = Path(source.path)
    frames = source.sweeps or PRESETS[source.scene].frames
    if folder.exists():
        facts = read_toml(folder / "sequence.toml")
        wanted = {
            "preset": source.scene,
            "frames": frames,
            "seed": source.seed,
            "generator": VERSION,
        }
        if all(facts.get(key) == value for key, value in wanted.items()):
            return
        if "generator" not in facts:
            raise DataError(
                folder,
                "not a simulated scene",
                hint="Remove the folder, or give the sequence another name",
            )
        shutil.rmtree(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    simulate(source.scene, folder, int(frames), source.seed, progress)
