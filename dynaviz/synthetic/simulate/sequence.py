"""A simulated sequence without files.

``simulate:street_hdl64?frames=20&jitter_m=0.03`` opens one.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from dynaviz.arrays import F64
from dynaviz.contracts.reader import Reader
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.spatial import geometry
from dynaviz.synthetic.simulate.classes import CLASS_NAMES
from dynaviz.synthetic.simulate.options import Chosen
from dynaviz.synthetic.simulate.recording import SceneRecorder, SimulatedSweep, build


class SimulatedSequence(Reader):
    """A preset whose sweeps are simulated when they are read.

    Reading a frame twice gives the same arrays.

    The scans are those that ``dynaviz simulate`` writes. To run several methods on the same scene,
    write it once.

    Args:
        chosen: preset with its effects, number of frames and seed.
    """

    layout: ClassVar[str] = (
        "a simulated scene: simulate:street_hdl64?frames=20&seed=3&jitter_m=0.03"
    )
    nested: ClassVar[bool] = True
    exact: ClassVar[bool] = True

    def __init__(self, chosen: Chosen) -> None:
        self.chosen = chosen

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Never: only the prefix opens a simulated scene."""
        return False

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open ``PRESET?frames=20&seed=3&jitter_m=0.03``.

        Raises:
            UsageError: for an unknown preset or option, or an invalid value.
        """
        return cls(Chosen.parse(str(path)))

    @property
    def name(self) -> str:
        """The preset, and the options that differ from it."""
        seed = f"-seed{self.chosen.seed}" if self.chosen.seed else ""
        return self.chosen.text.replace("?", "-").replace("&", "-").replace("=", "-") + seed

    @property
    def sensor(self) -> Sensor:
        """The sensor of the preset."""
        return load_sensor(self.chosen.preset.sensor)

    @property
    def has_labels(self) -> bool:
        """Always: the ground truth is exact."""
        return True

    @property
    def facts(self) -> Mapping[str, str]:
        """The effects that are switched on, for ``dynaviz info``."""
        active = self.chosen.preset.effects.active
        return (
            {"effects": ", ".join(f"{name} {value:g}" for name, value in active.items())}
            if active
            else {}
        )

    @cached_property
    def _recorder(self) -> SceneRecorder:
        preset = self.chosen.preset
        frames = self.chosen.frames
        seed = self.chosen.seed
        return SceneRecorder(build(preset, frames, seed), preset, frames, seed)

    def __len__(self) -> int:
        return self.chosen.frames

    def __getitem__(self, position: int) -> Scan:
        sweep = self._recorder.sweep(range(len(self))[position])
        return Scan(
            index=sweep.index,
            points=sweep.points,
            T_world_sensor=sweep.T_world_sensor,
            stamp_ns=round(sweep.time * 1e9),
            labels=sweep.labels,
            classes=sweep.kinds,
            instances=sweep.instances,
            origins=self._origins(sweep),
            class_names=CLASS_NAMES,
        )

    def _origins(self, sweep: SimulatedSweep) -> F64:
        """Origins of the rays as the pose of the frame places them.

        Also a deskewed sweep names one pose only.
        """
        if not self.sensor.mounts:
            return sweep.T_world_sensor[None, :3, 3]
        mounts = np.array([mount[:3] for mount in self.sensor.mounts])
        return geometry.apply(sweep.T_world_sensor, mounts)[sweep.lidar]
