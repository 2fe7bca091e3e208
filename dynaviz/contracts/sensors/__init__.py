"""Specifications of LiDAR sensors, one TOML file each."""

from __future__ import annotations

import dataclasses
import tomllib
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from dynaviz.contracts.params import read_toml
from dynaviz.errors import DataError, UsageError

Count = Annotated[int, Meta(gt=0, lt=10**9)]
Finite = Annotated[float, Meta(gt=-1e9, lt=1e9)]
Positive = Annotated[float, Meta(ge=0, lt=1e9)]
Mount = Annotated[tuple[Finite, ...], Meta(min_length=6, max_length=6)]


@dataclass(frozen=True)
class Sensor:
    """Specification of a sensor.

    Every number is optional (None), because a folder of scans may come from any sensor.

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
        mounts: (x, y, z, roll, pitch, yaw) in metres and degrees of each lidar in the sensor frame
            (T_sensor_lidar), if several were merged into one scan.
        carrier: cubes of 0.2 m in the sensor frame, by their indices, that are filled by what
            carries the sensor.
    """

    name: str = "unknown"
    title: str = "unknown sensor"
    rings: Count | None = None
    elevation: tuple[Finite, Finite] | None = None
    elevations: tuple[Finite, ...] = ()
    azimuth: tuple[Finite, Finite] = (-180.0, 180.0)
    azimuth_step: Positive | None = None
    height: Positive | None = None
    min_range: Positive = 0.0
    max_range: Positive | None = None
    range_noise: Positive | None = None
    rate: Positive | None = None
    points_per_sweep: Count | None = None
    mounts: tuple[Mount, ...] = field(default=())
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
        raise UsageError(
            f"unknown sensor '{name}'. Available: {', '.join(sensor_names())}; or give a TOML file"
        )
    with (resources.files(__package__) / f"{name}.toml").open("rb") as file:
        return _sensor(name, tomllib.load(file))


def _read(path: Path) -> Sensor:
    """A sensor from a file of the user."""
    known = [each.name for each in dataclasses.fields(Sensor) if each.name != "name"]
    hint = (
        "Write lines such as rings = 32, elevation = [-25.0, 15.0] or height = 1.8. Known: "
        f"{', '.join(known)}"
    )
    facts = read_toml(path, hint)
    for key in facts:
        if key not in known:
            raise DataError(path, f"a sensor has no '{key}'", hint=hint)
    try:
        sensor = _sensor(path.stem, facts)
    except msgspec.ValidationError as error:
        raise DataError(path, f"is not a sensor: {error}", hint=hint) from None
    for name, span in (("elevation", sensor.elevation), ("azimuth", sensor.azimuth)):
        if span and not span[0] < span[1]:
            raise DataError(
                path, f"invalid {name} = {list(span)}: give ascending degrees", hint=hint
            )
    return sensor


def _sensor(name: str, facts: dict[str, Any]) -> Sensor:
    """A sensor from the content of its file.

    Raises msgspec.ValidationError for a wrong type or sign.
    """
    return msgspec.convert({**facts, "name": name}, Sensor)
