"""Facts of LiDAR sensors, one TOML file each; nothing here depends on a method."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

from dynaviz.errors import UsageError


@dataclass(frozen=True)
class Sensor:
    """What is known of a sensor. Every number may be missing (None): a folder of scans need not say where it came from.

    Attributes:
        name: the file's name without ``.toml``; ``unknown`` where nothing is known.
        title: as a reader would write it.
        rings: number of beams of a spinning sensor.
        elevation: (lowest, highest) beam in degrees above the horizon.
        elevations: all beams in degrees, where they are not evenly spaced; else empty.
        azimuth: (from, to) field of view in degrees, 0 forward, counter-clockwise.
        azimuth_step: degrees between two firings.
        height: of the sensor above the ground as mounted, metres.
        min_range, max_range: metres.
        range_noise: standard deviation of a range, metres.
        rate: sweeps per second.
        points_per_sweep: for patterns that are not rings.
        mounts: (x, y, z, roll, pitch, yaw) in metres and degrees of each lidar in the sensor frame (T_sensor_lidar),
            where several were merged into one scan.
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
    """Names of the sensors that are known, sorted."""
    files = resources.files(__package__).iterdir()
    return sorted(f.name.removesuffix(".toml") for f in files if f.name.endswith(".toml"))


@cache
def load_sensor(name: str) -> Sensor:
    """A sensor by its name.

    Raises:
        UsageError: for a name that is not known; the message lists those that are.
    """
    if name not in sensor_names():
        raise UsageError(f"no sensor '{name}'. Known: {', '.join(sensor_names())}")
    with (resources.files(__package__) / f"{name}.toml").open("rb") as file:
        facts = tomllib.load(file)
    for key, value in facts.items():
        if isinstance(value, list):
            facts[key] = tuple(tuple(v) if isinstance(v, list) else v for v in value)
    return Sensor(name=name, **facts)
