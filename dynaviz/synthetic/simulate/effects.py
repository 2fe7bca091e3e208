"""What real scans have and ideal ones do not.

Sensor effects and difficult behaviour, each a switch with a unit.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

from dynaviz.errors import UsageError
from dynaviz.synthetic.query import whole


def _off(unit: str, text: str, most: float = 1e4, least: float = 0.0) -> Any:
    """A field that is 0 (off) by default, with its unit and a description."""
    return field(default=0.0, metadata={"unit": unit, "text": text, "range": (least, most)})


def _number(text: str) -> Any:
    """A number of movers, 0 by default."""
    return field(default=0, metadata={"unit": "", "text": text, "range": (0, 100)})


@dataclass(frozen=True)
class Effects:
    """Effects of a simulated sequence.

    Each is off by default, and then changes no bit of the sequence.

    Off means 0, except for ``pulse_m``, which has no effect without ``divergence_mrad``, and
    ``dropout``, whose default is the drop-out rate of the plain simulator.

    ``docs/simulator.md`` explains each effect, its source and its magnitude in the ``*_real``
    presets. Every effect has random numbers of its own: switching one on leaves the noise of the
    others as it was.

    Raises:
        UsageError: for a value out of range.
    """

    sweep_s: float = _off("s", "duration of a sweep in which sensor and movers move", 1.0)
    raw: int = field(
        default=0,
        metadata={
            "unit": "",
            "text": "1 leaves the points of a sweep without deskewing",
            "range": (0, 1),
        },
    )
    divergence_mrad: float = _off(
        "mrad", "full beam divergence; gives mixed pixels at depth edges", 20.0
    )
    pulse_m: float = field(
        default=1.0,
        metadata={
            "unit": "m",
            "text": "two surfaces nearer than this give one mixed return",
            "range": (0.0, 100.0),
        },
    )
    dropout: float = field(
        default=0.04,
        metadata={"unit": "", "text": "share of returns lost at any range", "range": (0.0, 1.0)},
    )
    dropout_range: float = _off(
        "", "share of returns lost at 100 m, in proportion to the range", 1.0
    )
    dropout_incidence: float = _off("", "share of returns lost at grazing incidence", 1.0)
    noise_range_m: float = _off(
        "m", "additional standard deviation of the range at 100 m, in proportion to it", 10.0
    )
    noise_incidence_m: float = _off(
        "m", "additional standard deviation at 45 degrees of incidence", 1.0
    )
    beam_deg: float = _off("°", "standard deviation of the constant angle error of each beam", 5.0)
    bloom_deg: float = _off("°", "radius of the halo around retro-reflectors", 10.0)
    multipath: float = _off("", "share of returns from the ground that are mirrored below it", 1.0)
    rain_per_m3: float = _off(
        "1/m³", "drops or grains of dust that return a beam, per volume", 1000.0
    )
    vegetation_gap: float = _off("", "share of rays that pass each leaf", 0.99)
    glass: float = _off("", "share of rays that pass a window pane", 1.0)
    drift_m: float = _off("m", "standard deviation of the position drift after 100 m", 50.0)
    drift_deg: float = _off("°", "standard deviation of the rotation drift after 100 m", 45.0)
    jitter_m: float = _off("m", "standard deviation of the position error of each frame", 10.0)
    jitter_deg: float = _off("°", "standard deviation of the rotation error of each frame", 45.0)
    brushing: int = _number("walkers who brush along walls, pillars and parked cars, 0.2 m away")
    passing: int = _number("cars that pass parked cars, 0.5 m away")
    crowds: int = _number("groups of six people who touch each other")
    doors: int = _number("doors that open and close")
    trolleys: int = _number("trolleys that are pushed")
    sitting: int = _number("people who walk to a bench and sit down")
    animals: int = _number("dogs that run and stop")
    parking: int = _number("cars that arrive and park, wait, and leave")

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            (low, high) = each.metadata["range"]
            if not low <= value <= high:
                raise UsageError(f"simulate: {each.name} = {value}: give {low:g} to {high:g}")

    @property
    def optical(self) -> bool:
        """Whether any effect changes what the sensor measures."""
        return any(name in self.active for name in OPTICAL)

    @property
    def active(self) -> dict[str, float | int]:
        """The effects that are switched on, by name."""
        return {
            e.name: getattr(self, e.name)
            for e in fields(self)
            if getattr(self, e.name) != e.default
        }


NAMES = tuple(each.name for each in fields(Effects))
OPTICAL = tuple(name for name in NAMES[: NAMES.index("drift_m")] if name not in ("raw", "pulse_m"))
BEHAVIOUR = NAMES[NAMES.index("brushing") :]


def parse_value(name: str, text: str, place: str) -> float | int:
    """The value of an effect.

    Raises:
        UsageError: for text that is not a number; the message starts with ``place``.
    """
    default = next(each.default for each in fields(Effects) if each.name == name)
    if isinstance(default, int):
        return whole(place, name, text)
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"{place}: {name} = {text!r}: give a number") from None
