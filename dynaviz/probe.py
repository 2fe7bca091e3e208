"""How a method shows its inner state: named values, emitted to whoever listens.

A method lists what it can show in ``MethodInfo.emits``; it prepares a costly value only where ``probe.wants(name)``.
A probe may keep a value until the method's call returns, no longer: methods are free to reuse their arrays afterwards.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Protocol

from dynaviz.arrays import F32, F64, I32, U8, Bool


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Points in the world: xyz (N, 3) float32, metres, world frame; values (N,) float32 colours them, if given."""

    xyz: F32
    values: F32 | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PointClasses:
    """A class for each point of the current scan: (N,) uint8, indices into the state's legend."""

    classes: U8


@dataclass(frozen=True, slots=True, eq=False)
class Mask:
    """Some points of the current scan: (N,) bool."""

    chosen: Bool


@dataclass(frozen=True, slots=True, eq=False)
class RangeImage:
    """A picture seen from the sensor: (rows, columns) float32, metres, first row at the top; NaN without return."""

    ranges: F32


@dataclass(frozen=True, slots=True, eq=False)
class PolarGrid:
    """Bins around the sensor: (rings, sectors) float32, NaN where empty.

    Sector 0 starts at azimuth 0, ring 0 at the sensor; max_range: metres.
    """

    values: F32
    max_range: float


@dataclass(frozen=True, slots=True, eq=False)
class Voxels:
    """Cubes in the world: cube k spans [k, k + 1) * size per axis.

    keys: (N, 3) int32; size: edge in metres; values: (N,) float32 colours them, if given.
    """

    keys: I32
    size: float
    values: F32 | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A disc of the plane normal . p = offset around a centre: metres, world frame."""

    normal: F64
    offset: float
    centre: F64
    radius: float


@dataclass(frozen=True, slots=True)
class Scalar:
    """One number a frame, drawn as a curve."""

    value: float


@dataclass(frozen=True, slots=True)
class Text:
    """A remark, shown in the log."""

    text: str


Value = Points | PointClasses | Mask | RangeImage | PolarGrid | Voxels | Plane | Scalar | Text


@dataclass(frozen=True, slots=True)
class State:
    """What a method can show, declared in its class; the viewer's layout, the docs and the tests come from it.

    Attributes:
        name: short and constant, also the last part of its path in the recording.
        kind: the type of the value.
        meaning: one sentence for the reader of a recording.
        legend: names of the classes of a ``PointClasses``, by index.
        value_range: the values' range on the colour scale of ``Voxels``, ``Points``, ``PolarGrid`` or ``RangeImage``.
    """

    name: str
    kind: type
    meaning: str
    legend: tuple[str, ...] = ()
    value_range: tuple[float, float] | None = None


class Probe(Protocol):
    """A listener to a method's states."""

    def wants(self, name: str) -> bool:
        """Whether anybody looks at this state; ask before preparing a costly value."""
        ...

    def emit(self, name: str, value: Value) -> None:
        """Show a state of the current frame; a state nobody wants is dropped."""
        ...


class _Silent:
    def wants(self, name: str) -> bool:
        return False

    def emit(self, name: str, value: Value) -> None:
        return None


SILENT: Probe = _Silent()
"""Nobody listens."""


class MemoryProbe:
    """Keeps everything, for tests: ``values[name]`` lists what was emitted, in order."""

    def __init__(self) -> None:
        self.values: defaultdict[str, list[Value]] = defaultdict(list)

    def wants(self, name: str) -> bool:
        """Everything is wanted."""
        return True

    def emit(self, name: str, value: Value) -> None:
        """Keep the value as it is, not a copy."""
        self.values[name].append(value)
