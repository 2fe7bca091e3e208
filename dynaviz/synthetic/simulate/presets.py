"""Named presets of simulated scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from dynaviz.synthetic.simulate.effects import Effects


@dataclass(frozen=True)
class Preset:
    """A scene, a sensor and the accuracy of its poses.

    Attributes:
        name: name on the command line.
        title: short description.
        scene: ``street``, ``square`` or ``hall``.
        sensor: name of a sensor file.
        frames: default number of sweeps.
        speed: speed of the sensor, m/s.
        traffic: relative number of movers; 1 is normal.
        pose_noise: standard deviations of the pose errors, metres and degrees.
        effects: effects of the sensor, further pose errors, and difficult behaviour.
    """

    name: str
    title: str
    scene: str
    sensor: str
    frames: int
    speed: float
    traffic: float = 1.0
    pose_noise: tuple[float, float] = (0.01, 0.05)
    effects: Effects = field(default_factory=Effects)


_ALL = (
    Preset("demo", "small busy street, VLP-16", "street", "vlp16", 50, 3.0, traffic=2.0),
    Preset("hall_mid360", "hall, Livox Mid-360", "hall", "mid360", 200, 1.0),
    Preset("hall_vlp16", "hall, VLP-16", "hall", "vlp16", 200, 1.0),
    Preset("square_mid360", "square with a crowd, Livox Mid-360", "square", "mid360", 200, 1.5),
    Preset("square_vlp32c", "square with a crowd, two VLP-32C", "square", "vlp32c_pair", 120, 3.0),
    Preset(
        "street_hdl64",
        "street, HDL-64E",
        "street",
        "hdl64e",
        200,
        9.0,
        traffic=0.6,
        pose_noise=(0.015, 0.05),
    ),
    Preset("street_vlp16", "street, VLP-16", "street", "vlp16", 200, 2.5),
)

REAL = Effects(
    sweep_s=0.1,
    divergence_mrad=3.0,
    dropout=0.002,
    dropout_range=0.015,
    dropout_incidence=0.02,
    noise_range_m=0.05,
    noise_incidence_m=0.0003,
    beam_deg=0.02,
    bloom_deg=0.8,
    multipath=0.001,
    vegetation_gap=0.3,
    glass=0.6,
    drift_m=0.3,
    drift_deg=0.1,
    jitter_m=0.03,
    jitter_deg=0.1,
    brushing=8,
    passing=3,
    crowds=2,
    doors=3,
    trolleys=2,
    sitting=2,
    animals=2,
    parking=2,
)
"""All effects but rain, as large as in real scans; ``docs/simulator.md`` gives the source of each
number."""

_SENSORS: Mapping[str, Mapping[str, Any]] = {"hdl64e": {"dropout_range": 0.005}}
"""Changes for a sensor whose scans were measured."""


def _real(preset: Preset) -> Preset:
    """The preset with the effects of real scans instead of smooth pose errors."""
    effects = replace(REAL, **_SENSORS.get(preset.sensor, {}))
    title = f"{preset.title}, with the effects of real scans"
    return replace(
        preset, name=f"{preset.name}_real", title=title, pose_noise=(0.0, 0.0), effects=effects
    )


_WITH_EFFECTS = [_real(preset) for preset in _ALL if preset.name != "demo"]

PRESETS: Mapping[str, Preset] = MappingProxyType(
    dict(sorted({p.name: p for p in (*_ALL, *_WITH_EFFECTS)}.items()))
)
"""All presets, sorted by name."""
