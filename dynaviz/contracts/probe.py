"""Probes receive a method's internal states: named values that the method emits.

A method declares its states in ``MethodInfo.emits`` and computes expensive values only if
``probe.wants(name)``. A probe may use a value until the method's call returns; afterwards the
method may reuse its arrays.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Protocol

from dynaviz.arrays import F32, F64, I32, U8, Bool


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Points: xyz (N, 3) float32, metres, world frame.

    Values (N,) float32, optional, on a colour scale.
    """

    xyz: F32
    values: F32 | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PointClasses:
    """A class for each point of the current scan: (N,) uint8, indices into the state's legend."""

    classes: U8


@dataclass(frozen=True, slots=True, eq=False)
class Mask:
    """A selection of points of the current scan: (N,) bool."""

    chosen: Bool


@dataclass(frozen=True, slots=True, eq=False)
class ImageSpan:
    """The directions that a range image shows; a pixel is a step of both angles.

    Attributes:
        left, right: azimuths of its edges, radians, about the sensor's z axis from its x axis; not
            wrapped, so that right is the larger one if azimuth grows to the right.
        top, bottom: elevations of its edges, radians above the sensor's xy plane.
    """

    left: float
    right: float
    top: float
    bottom: float


@dataclass(frozen=True, slots=True, eq=False)
class RangeImage:
    """A range image: (rows, columns) float32, metres, first row at the top; NaN without return.

    With its span, recordings mark cases in it.
    """

    ranges: F32
    span: ImageSpan | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PolarGrid:
    """Polar bins around the sensor: (rings, sectors) float32, NaN if empty.

    Sector 0 starts at azimuth 0, ring 0 at the sensor; max_range: metres.
    """

    values: F32
    max_range: float


@dataclass(frozen=True, slots=True, eq=False)
class Voxels:
    """Voxels in the world frame: voxel k spans [k, k + 1) * size per axis.

    keys: (N, 3) int32; size: edge in metres; values: (N,) float32, optional, on a colour scale.
    """

    keys: I32
    size: float
    values: F32 | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A disc of the plane normal . p = offset around a centre; metres, world frame."""

    normal: F64
    offset: float
    centre: F64
    radius: float


@dataclass(frozen=True, slots=True)
class Scalar:
    """One number per frame, plotted over time."""

    value: float


@dataclass(frozen=True, slots=True)
class Text:
    """A message in the log."""

    text: str


Value = Points | PointClasses | Mask | RangeImage | PolarGrid | Voxels | Plane | Scalar | Text


@dataclass(frozen=True, slots=True)
class State:
    """An internal state that a method emits.

    The viewer's layout, the report and the tests are generated from it.

    Attributes:
        name: short, constant name; also the last part of its path in the recording.
        kind: type of the value.
        meaning: one sentence that explains it.
        legend: class names of a ``PointClasses``, or of a ``PolarGrid`` whose values are classes,
            by index; empty for an index that is not in use.
        value_range: range of the colour scale of ``Voxels``, ``Points``, ``PolarGrid`` or
            ``RangeImage``.
        threshold: value at which a verdict changes, for the key; or the name of the parameter that
            holds it. None if there is none.
        at_cases: show it at failure cases alone, because it takes much room; ``--record full``
            shows it in all frames.
    """

    name: str
    kind: type
    meaning: str
    legend: tuple[str, ...] = ()
    value_range: tuple[float, float] | None = None
    threshold: float | str | None = None
    at_cases: bool = False


class Probe(Protocol):
    """Receives a method's states."""

    def wants(self, name: str) -> bool:
        """Whether this state is used; check before computing an expensive value."""
        ...

    def emit(self, name: str, value: Value) -> None:
        """Emit a state of the current frame; unwanted states are ignored."""
        ...


class _Silent:
    def wants(self, name: str) -> bool:
        return False

    def emit(self, name: str, value: Value) -> None:
        return None


SILENT: Probe = _Silent()
"""A probe that ignores all states."""


class MemoryProbe:
    """Stores all values, for tests: ``values[name]`` lists them in order."""

    def __init__(self) -> None:
        self.values: defaultdict[str, list[Value]] = defaultdict(list)

    def wants(self, name: str) -> bool:
        """True for every state."""
        return True

    def emit(self, name: str, value: Value) -> None:
        """Store the value itself, not a copy."""
        self.values[name].append(value)
