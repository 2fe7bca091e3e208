"""Named presets of simulated scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


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
    """

    name: str
    title: str
    scene: str
    sensor: str
    frames: int
    speed: float
    traffic: float = 1.0
    pose_noise: tuple[float, float] = (0.01, 0.05)


_ALL = (
    Preset("demo", "small busy street, VLP-16", "street", "vlp16", 50, 3.0, traffic=2.0),
    Preset("hall_mid360", "hall, Livox Mid-360", "hall", "mid360", 200, 1.0),
    Preset("hall_vlp16", "hall, VLP-16", "hall", "vlp16", 200, 1.0),
    Preset("square_mid360", "square with a crowd, Livox Mid-360", "square", "mid360", 200, 1.5),
    Preset("square_vlp32c", "square with a crowd, two VLP-32C", "square", "vlp32c_pair", 120, 3.0),
    Preset("street_hdl64", "street, HDL-64E", "street", "hdl64e", 200, 9.0, traffic=0.6, pose_noise=(0.015, 0.05)),
    Preset("street_vlp16", "street, VLP-16", "street", "vlp16", 200, 2.5),
)

PRESETS: Mapping[str, Preset] = MappingProxyType({preset.name: preset for preset in _ALL})
"""All presets, sorted by name."""
