"""Specifications of LiDAR sensors, one TOML file each."""

from __future__ import annotations

import dataclasses
import tomllib
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from dynaviz.errors import DataError, UsageError


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
        carrier: cubes of 0.2 m in the sensor frame, by their indices, that are filled by what carries the sensor.
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
    carrier: tuple[tuple[int, int, int], ...] = field(default=())


def sensor_names() -> list[str]:
    """Names of all sensors, sorted."""
    files = resources.files(__package__).iterdir()
    return sorted(f.name.removesuffix(".toml") for f in files if f.name.endswith(".toml"))


@cache
def load_sensor(name: str) -> Sensor:
    """Load a sensor by its name, or from a TOML file with the fields of ``Sensor``.

    Raises:
        UsageError: for an unknown name; the message lists the available names.
        DataError: for a file that is not the specification of a sensor.
    """
    if name.endswith(".toml"):
        return _read(Path(name))
    if name not in sensor_names():
        raise UsageError(f"unknown sensor '{name}'. Available: {', '.join(sensor_names())}; or give a TOML file")
    with (resources.files(__package__) / f"{name}.toml").open("rb") as file:
        return _sensor(name, tomllib.load(file))


def _read(path: Path) -> Sensor:
    """A sensor from a file of the user."""
    known = [each.name for each in dataclasses.fields(Sensor) if each.name != "name"]
    hint = f"Write lines such as rings = 32, elevation = [-25.0, 15.0] or height = 1.8. Known: {', '.join(known)}"
    try:
        facts = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(path, f"cannot be read ({error})", hint=hint) from None
    for key, value in facts.items():
        if key not in known:
            raise DataError(path, f"a sensor has no '{key}'", hint=hint)
        if not _valid(key, value):
            raise DataError(path, f"invalid {key} = {value!r}", hint=hint)
    return _sensor(path.stem, facts)


def _valid(key: str, value: Any) -> bool:
    """Whether a value of a sensor file has the right type and sign."""

    def numbers(each: Any, count: int | None = None) -> bool:
        listed = isinstance(each, list) and all(type(x) in (int, float) and abs(x) < 1e9 for x in each)
        return listed and count in (None, len(each))

    if key == "title":
        return isinstance(value, str)
    if key in ("elevation", "azimuth"):
        return numbers(value, 2) and value[0] < value[1]
    if key == "elevations":
        return numbers(value)
    if key == "carrier":
        return isinstance(value, list) and all(numbers(row, 3) and all(type(x) is int for x in row) for row in value)
    if key == "mounts":
        return isinstance(value, list) and all(numbers(row, 6) for row in value)
    if key in ("rings", "points_per_sweep"):
        return type(value) is int and 0 < value < 1e9
    return numbers([value]) and value >= 0


def _sensor(name: str, facts: dict[str, Any]) -> Sensor:
    """A sensor with lists as tuples."""
    for key, value in facts.items():
        if isinstance(value, list):
            facts[key] = tuple(tuple(v) if isinstance(v, list) else v for v in value)
    return Sensor(name=name, **facts)
