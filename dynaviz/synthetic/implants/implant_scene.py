"""The movers of a sequence.

Their kinds, paths and schedules, and the scene file that stores them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from dynaviz.arrays import F64
from dynaviz.contracts.params import read_toml
from dynaviz.contracts.scan import Scan
from dynaviz.errors import DataError
from dynaviz.synthetic.simulate import objects
from dynaviz.synthetic.simulate.movers import Route
from dynaviz.synthetic.simulate.shapes import Mesh

FORMAT = 1
MoverKind = Literal["car", "truck", "cyclist", "person"]
_MOVER_KEYS = ("kind", "instance", "shape", "note", "path", "schedule")
CLASSES = {"car": 60001, "truck": 60002, "cyclist": 60003, "person": 60004}
CLASS_NAMES = {number: f"implanted {kind}" for kind, number in CLASSES.items()}
WHEELBASE = {"car": 2.6, "truck": 4.0, "cyclist": 1.04, "person": 0.0}  # metres
_HINT = "Use a scene file that 'dynaviz simulate implant:SEQ' wrote"


@dataclass(frozen=True, eq=False)
class Implant:
    """One mover.

    Attributes:
        kind: a key of ``CLASSES``.
        instance: instance number.
        shape: seed of its model and size.
        path: (P, 3) float64, metres, world frame: its track on the ground.
        schedule: (K, 2) float64: seconds, and metres along the path in the plane, both not
            decreasing.
        note: what it does, for the reader.
    """

    kind: MoverKind
    instance: Annotated[int, Meta(ge=1, lt=1 << 31)]
    shape: Annotated[int, Meta(ge=0)]
    path: F64
    schedule: F64
    note: str = ""

    def __post_init__(self) -> None:
        if self.path.shape[1:] != (3,) or len(self.path) < 2 or self.schedule.shape[1:] != (2,):
            raise ValueError(
                "path must be two places or more, (x, y, z), and schedule rows of seconds and "
                "metres"
            )
        if not (np.isfinite(self.path).all() and np.isfinite(self.schedule).all()):
            raise ValueError("path and schedule must be finite")
        if not (np.diff(self.path[:, :2], axis=0) != 0).any(1).all():
            raise ValueError("path contains the same place twice in a row")
        if (np.diff(self.schedule, axis=0) < 0).any():
            raise ValueError("schedule must not decrease")

    @cached_property
    def route(self) -> Route:
        """The path in the plane."""
        return Route(self.path[:, :2])

    @cached_property
    def _model(self) -> Mesh | float | None:
        rng = np.random.default_rng(self.shape)
        if self.kind == "person":
            return float(rng.uniform(1.55, 1.9))
        return (
            {"car": objects.car, "truck": objects.truck}[self.kind](rng)
            if self.kind != "cyclist"
            else None
        )

    def distance(self, time: float) -> float | None:
        """Metres along the path at a time in seconds; None before and after the schedule."""
        seconds, metres = self.schedule.T
        return (
            float(np.interp(time, seconds, metres)) if seconds[0] <= time <= seconds[-1] else None
        )

    def pose(self, distance: float) -> F64:
        """T_world_mover, (4, 4) float64, after a distance.

        On the path, pitched as the ground along it.
        """
        x, y, yaw = self.route.pose2d(distance)
        half = WHEELBASE[self.kind] / 2
        front, rear = (self._height(distance + shift) for shift in (half, -half))
        forward = np.array([np.cos(yaw), np.sin(yaw), (front - rear) / (2 * half) if half else 0.0])
        forward /= np.sqrt(np.sum(forward * forward))
        left = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
        T = np.eye(4)
        T[:3, 0] = forward
        T[:3, 1] = left
        T[:3, 2] = np.cross(forward, left)
        T[:3, 3] = x, y, (front + rear) / 2
        return T

    def velocity(self, start: float, end: float) -> F64:
        """(3,) float64, m/s: mean velocity between two times in seconds while it is present.

        Zero for equal times.
        """
        start = max(start, float(self.schedule[0, 0]))
        end = min(end, float(self.schedule[-1, 0]))
        a = self.distance(start)
        b = self.distance(end)
        if end <= start or a is None or b is None:
            return np.zeros(3)
        step: F64 = self.pose(b)[:3, 3] - self.pose(a)[:3, 3]
        return step / (end - start)

    def _height(self, distance: float) -> float:
        """Height of the path; beyond its ends it goes on at the same slope."""
        at = self.route.distance
        z = self.path[:, 2]
        if distance < 0:
            return float(z[0] + distance * (z[1] - z[0]) / (at[1] - at[0]))
        if distance > at[-1]:
            return float(z[-1] + (distance - at[-1]) * (z[-1] - z[-2]) / (at[-1] - at[-2]))
        return float(np.interp(distance, at, z))

    def mesh(self, time: float) -> Mesh | None:
        """Its mesh in the world frame at a time in seconds, or None while it is absent."""
        distance = self.distance(time)
        if distance is None:
            return None
        body = self._model
        if not isinstance(body, Mesh):
            body = objects.cyclist(distance) if body is None else objects.person(distance, body)
        return body.transformed(self.pose(distance))


@dataclass(frozen=True, eq=False)
class ImplantScene:
    """Movers for a sequence, and how they are measured.

    Attributes:
        seed: random seed of the noise.
        range_noise: standard deviation of the range, metres.
        drop_out: share of rays that lose their return.
        sky_rays: whether rays without a return may hit a mover; needs a regular scan pattern.
        movers: the movers.
        rate: sweeps per second; the time of a frame is its number divided by this.
        start_ns: if not None, the time of a frame is its stamp minus this.
        sequence: name of the sequence, for the reader.
    """

    seed: int
    range_noise: Annotated[float, Meta(ge=0, le=10)]
    drop_out: Annotated[float, Meta(ge=0, le=1)]
    sky_rays: bool
    movers: tuple[Implant, ...] = ()
    rate: Annotated[float, Meta(ge=1e-3, le=1e6)] = 10.0
    start_ns: int | None = None
    sequence: str = ""

    def time(self, scan: Scan) -> float:
        """Time of a scan in seconds."""
        if self.start_ns is not None and scan.stamp_ns is not None:
            return (scan.stamp_ns - self.start_ns) / 1e9
        return scan.index / self.rate

    def to_toml(self) -> bytes:
        """The content of a scene file; equal scenes give equal bytes."""
        import tomli_w

        head: dict[str, Any] = {
            "format": FORMAT,
            "sequence": self.sequence,
            "seed": self.seed,
            "rate": self.rate,
        }
        if self.start_ns is not None:
            head["start_ns"] = self.start_ns
        head |= {
            "range_noise": self.range_noise,
            "drop_out": self.drop_out,
            "sky_rays": self.sky_rays,
        }
        text = tomli_w.dumps(head)
        for mover in (
            self.movers
        ):  # one line per array: thousands of numbers, of which a reader wants the beginning
            lines = "".join(f"{key} = {_inline(getattr(mover, key))}\n" for key in _MOVER_KEYS)
            text += f"\n[[movers]]\n{lines}"
        return text.encode()

    @classmethod
    def load(cls, path: Path) -> ImplantScene:
        """Read a scene file.

        Raises:
            DataError: if it cannot be read, or an entry is missing or invalid.
        """
        table = read_toml(path, _HINT)
        if table.get("format") != FORMAT:
            raise DataError(
                path, f"has format = {table.get('format')!r}, expected {FORMAT}", hint=_HINT
            )
        try:
            return msgspec.convert(table, cls, dec_hook=_rows)
        except msgspec.ValidationError as error:
            raise DataError(path, f"is invalid: {error}", hint=_HINT) from None


def _rows(kind: Any, value: Any) -> F64:
    """The rows of an array in a scene file."""
    return np.array(msgspec.convert(value, list[tuple[float, ...]]))


def _inline(value: Any) -> str:
    value = value.tolist() if isinstance(value, np.ndarray) else value
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(value)
