"""Specifications of LiDAR sensors, one TOML file each."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

from dynaviz.errors import UsageError


@dataclass(frozen=True)
class Sensor:
    """Specification of a sensor. Every number is optional (None), because a folder of scans may come from any sensor.

    Attributes:
        name: name of the file without ``.toml``; ``unknown`` for an unknown sensor.
        title: display name.
        rings: number of beams of a spinning sensor.
        elevation: (lowest, highest) beam in degrees above the horizon.
        elevations: all beams in degrees if they are not evenly spaced; otherwise empty.
        azimuth: (start, end) of the field of view in degrees, 0 forward, counter-clockwise.
        azimuth_step: degrees between two firings.
        height: mounting height above the ground, metres.
        min_range, max_range: metres.
        range_noise: standard deviation of the range, metres.
        rate: sweeps per second.
        points_per_sweep: for sensors without rings.
        mounts: (x, y, z, roll, pitch, yaw) in metres and degrees of each lidar in the sensor frame (T_sensor_lidar),
            if several were merged into one scan.
    """

    name: str = "unknown"
    title: str = "unknown sensor"
    rings: int | None = None
    elevation: tuple[float, float] | None = None
    elevations: tuple[float, ...] = ()
    azimuth: tuple[float, float] = (-180.0, 180.0)
    azimuth_step: float | None = None
    height: float | None = None
    min_range: float = 0.0
    max_range: float | None = None
    range_noise: float | None = None
    rate: float | None = None
    points_per_sweep: int | None = None
    mounts: tuple[tuple[float, ...], ...] = field(default=())


def sensor_names() -> list[str]:
    """Names of all sensors, sorted."""
    files = resources.files(__package__).iterdir()
    return sorted(f.name.removesuffix(".toml") for f in files if f.name.endswith(".toml"))


@cache
def load_sensor(name: str) -> Sensor:
    """Load a sensor by its name.

    Raises:
        UsageError: for an unknown name; the message lists the available names.
    """
    if name not in sensor_names():
        raise UsageError(f"unknown sensor '{name}'. Available: {', '.join(sensor_names())}")
    with (resources.files(__package__) / f"{name}.toml").open("rb") as file:
        facts = tomllib.load(file)
    for key, value in facts.items():
        if isinstance(value, list):
            facts[key] = tuple(tuple(v) if isinstance(v, list) else v for v in value)
    return Sensor(name=name, **facts)
