"""A map of a whole drive in one file, split into scans again by the times of its points and the
trajectory.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F32, F64, I64, Bool, single
from dynaviz.contracts.attributes import Attributes, Unposed, far_origin
from dynaviz.contracts.reader import Reader
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import DataError, UsageError
from dynaviz.io.fields import coordinates, given_coordinates, read_fields, without_axes
from dynaviz.io.las import leap_offset
from dynaviz.io.poses import read_poses
from dynaviz.sources.datasets.lidars import LIDAR
from dynaviz.sources.datasets.pose_matching import parse_points_in
from dynaviz.spatial.trajectory import Moved, PosesOverTime, Trajectory

SUFFIXES = (".las", ".laz", ".pcd", ".ply")
TIMES = ("gpstime", "time", "timestamp", "t", "stamp")  # plain names, the better ones first
WEEK = 604_800.0  # seconds; GPS time may be that of the week
COARSEST = 0.05  # seconds; steps of times that can split a map
PERIOD = 100_000_000  # nanoseconds of a scan
TICK = 1_000_000  # nanoseconds; resolution of the positions of the sensor
_NEVER = -(1 << 62)  # nanoseconds; before every trajectory
_HINT = (
    "Give the trajectory of the sensor with --poses FILE (TUM, or CSV with a stamp), on the clock "
    "of the points"
)
_NEEDS_SCANS = (
    "Methods must know from where each point was seen: give the single scans with their poses, or "
    "a map that keeps "
    "gps_time with --poses TRAJECTORY"
)


@dataclass(frozen=True, eq=False)
class MergedMapSequence(Reader):
    """A merged map (.las .laz .pcd .ply) whose points have times, and a trajectory given with
    ``--poses``.

    Points are in the world frame. They are split into scans of 0.1 s; each ray starts where the
    sensor was at the time of its point, and of its lidar if points and poses state it. Points
    outside the time span of the trajectory are in no scan.
    """

    layout: ClassVar[str] = (
        "survey.laz, .las, .pcd or .ply with a time per point, and --poses TRAJECTORY"
    )
    fallback: ClassVar[bool] = True

    path: Path
    fields: dict[str, NDArray[Any]]
    bounds: I64
    times: I64
    trajectories: dict[int, PosesOverTime]
    facts: dict[str, str]
    origin: F64
    sensor: Sensor = field(default_factory=Sensor)
    has_labels: bool = False

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a file that may be a map.

        Not one of several numbered scans, nor a file next to scans.
        """
        if (
            path.suffix.lower() not in SUFFIXES
            or not path.is_file()
            or (path.parent / "pcd").is_dir()
        ):
            return False
        return (
            not path.stem[-1:].isdigit() or len(list(path.parent.glob(f"*[0-9]{path.suffix}"))) == 1
        )

    @classmethod
    def open(cls, path: Path, *, poses: str | None = None, points_in: str | None = None) -> Self:
        """Read the map and split it.

        Raises:
            DataError: if the points have no times, there is no trajectory, or they do not overlap
                in time.
            UsageError: for points in the sensor frame.
        """
        if parse_points_in(points_in or "world") != "world":
            raise UsageError(
                f"--points-in {points_in}: the points of a merged map are in the world frame"
            )
        fields = read_fields(path)
        name = _time_field(path, fields)
        if poses is None or not Path(poses).is_file():
            raise DataError(
                path, f"is a merged map; its field {name} can split it by a trajectory", hint=_HINT
            )
        file = read_poses(poses)
        if file.stamps is None:
            raise DataError(poses, "has no times, so it cannot split a merged map", hint=_HINT)
        if len(file.lidars) > 1 and LIDAR not in fields:
            problem = f"has no field {LIDAR}, but the poses are those of {len(file.lidars)} lidars"
            raise DataError(
                path, problem, hint="Give the poses of one lidar, without the column lidar"
            )
        paths = {
            k: Trajectory.of(file.stamps[rows], file.poses[rows]) for k, rows in file.lidars.items()
        }
        times, clock = _nanoseconds(fields[name], Trajectory.of(file.stamps, file.poses))
        inside = np.zeros(len(times), np.bool_)
        for lidar, each in paths.items():
            inside |= (
                _of_lidar(fields, lidar, len(paths))
                & (times >= each.times[0])
                & (times <= each.times[-1])
            )
        if not inside.any():
            spans = [f"{t.min() / 1e9:.1f} to {t.max() / 1e9:.1f} s" for t in (times, file.stamps)]
            problem = (
                f"points and poses do not overlap in time: points from {spans[0]}, poses from "
                f"{spans[1]}"
            )
            raise DataError(path, problem, hint=_HINT)
        order = np.flatnonzero(inside)[np.argsort(times[inside], kind="stable")]
        times = times[order]
        outside = np.flatnonzero(~inside)
        numbers = (times - times[0]) // PERIOD
        bounds = np.append(np.flatnonzero(np.diff(numbers, prepend=-1)), len(times))
        origin = far_origin(file.poses[0, :3, 3])
        facts = {
            "poses": f"{Path(poses).name} ({file.kind}), by stamp",
            "points in": "world frame",
            "split by": f"{name} ({clock}), {PERIOD / 1e9:g} s per scan; {len(outside):,} points "
            "are outside the trajectory",
        }
        rows = np.concatenate([order, outside])
        sorted_fields = {key: array[rows] for key, array in fields.items()}
        moved: dict[int, PosesOverTime] = {
            lidar: Moved(each, -origin) for lidar, each in paths.items()
        }
        return cls(path, sorted_fields, bounds, times, moved, facts, origin)

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.path.stem

    @property
    def las_file(self) -> Path | None:
        """The map, if it is a LAS or LAZ file."""
        return self.path if self.path.suffix.lower() in (".las", ".laz") else None

    @cached_property
    def _points(self) -> NDArray[np.float32]:
        return single(self._coordinates(slice(0, int(self.bounds[-1]))) - self.origin)

    def __len__(self) -> int:
        return len(self.bounds) - 1

    def _rows(self, position: int) -> slice:
        first = range(len(self))[position]
        return slice(int(self.bounds[first]), int(self.bounds[first + 1]))

    def attributes(self, position: int) -> Attributes:
        """All fields of the file besides the coordinates."""
        return self._attributes(self._rows(position))

    def coordinates(self, position: int) -> F32 | F64:
        """(N, 3), metres: coordinates in the file."""
        return given_coordinates(self._fields(self._rows(position)))

    def unposed(self) -> Iterator[Unposed]:
        """The points outside the time span of the trajectory."""
        rows = slice(int(self.bounds[-1]), None)
        xyz = self._coordinates(rows)
        yield Unposed(len(xyz), xyz, self._attributes(rows))

    def _attributes(self, rows: slice) -> Attributes:
        return without_axes(self._fields(rows))

    def _coordinates(self, rows: slice) -> F64:
        return coordinates(self._fields(rows))

    def _fields(self, rows: slice) -> dict[str, NDArray[Any]]:
        return {name: array[rows] for name, array in self.fields.items()}

    def __getitem__(self, position: int) -> Scan:
        rows = self._rows(position)
        times = self.times[rows]
        middle = int(times[0] + (times[-1] - times[0]) // 2)
        ticks, of = np.unique(times // TICK, return_inverse=True)
        origins = np.empty((len(of), 3))
        for lidar, trajectory in self.trajectories.items():
            own = _of_lidar(self._fields(rows), lidar, len(self.trajectories))
            origins[own] = trajectory.at(ticks * TICK)[of[own], :3, 3]
        return Scan(
            index=range(len(self))[position],
            points=self._points[rows],
            T_world_sensor=next(iter(self.trajectories.values())).at([middle])[0],
            stamp_ns=middle,
            origins=origins,
            times=((times - middle) * 1e-9).astype(np.float32),
        )


def _of_lidar(fields: dict[str, NDArray[Any]], lidar: int, lidars: int) -> Bool:
    """(N,) bool: points of a lidar; all of them if there is only one."""
    of: Bool = fields[LIDAR] == lidar if lidars > 1 else np.ones(len(fields["x"]), np.bool_)
    return of


def _time_field(path: Path, fields: dict[str, NDArray[Any]]) -> str:
    """The field with the times of points, also under the names that CloudCompare gives.

    Raises:
        DataError: if there is none that can split the map.
    """
    plain = {name.lower().removeprefix("scalar_").replace("_", ""): name for name in fields}
    found = [plain[name] for name in TIMES if name in plain]
    coarse = ""
    for name in found:
        values = fields[name][np.isfinite(fields[name])]
        if not len(values):
            continue
        step = float(np.spacing(values.max())) if values.dtype == np.float32 else 0.0
        if step > COARSEST:
            coarse = f"its field {name} is float32, which holds such times in steps of {step:g} s"
        elif values.min() < values.max():
            return name
    if coarse:
        hint = "Write the times as float64, or subtract the same number from them and the poses"
        raise DataError(path, f"is a merged map; {coarse}", hint=hint)
    if found:
        problem = f"is a merged map whose field {found[0]} is the same for all points"
        raise DataError(path, problem, hint=_NEEDS_SCANS)
    raise DataError(path, "is a merged map without a time per point", hint=_NEEDS_SCANS)


def _clocks(values: NDArray[Any], first: float) -> list[tuple[str, float]]:
    """What the times may be, and seconds to add to get those of the trajectory.

    LAS stores GPS seconds, GPS seconds minus 1e9, or those of the week; a trajectory may have Unix
    time instead.

    Args:
        values: (N,) times of points; first: of the trajectory, seconds.
    """
    to_unix = leap_offset(first)
    found = [
        ("clock of the poses", 0.0),
        ("adjusted GPS time", 1e9),
        ("GPS time", to_unix),
        ("adjusted GPS time", 1e9 + to_unix),
    ]
    finite = values[np.isfinite(values)]
    middle = float(np.median(finite)) if len(finite) else 0.0
    if 0 <= middle < 2 * WEEK < first:
        weeks = [(shift, (first - shift) // WEEK * WEEK) for shift in (to_unix, 0.0)]
        found += [
            ("seconds of the GPS week", shift + start - back)
            for shift, start in weeks
            for back in (0.0, WEEK)
        ]
    if 0 <= first < 2 * WEEK < middle:
        for shift in (0.0, 1e9, -leap_offset(middle)):
            start = (middle + shift) // WEEK * WEEK
            found += [("poses in seconds of the GPS week", shift - start)]
    return found


def _nanoseconds(values: NDArray[Any], trajectory: Trajectory) -> tuple[I64, str]:
    """Times on the clock of the trajectory, and what they were taken to be.

    Units of s, ms, us and ns are tried; of those in which most points lie within the trajectory,
    the first is used. Times that are not finite, or beyond 64 bits, become ``_NEVER``.
    """
    first, last = trajectory.span
    best: NDArray[Any] = np.empty(0)
    most = -1.0
    words = ""
    for clock, offset in _clocks(values, trajectory.times[0] / 1e9):
        for name, unit in (("s", 1e9), ("ms", 1e6), ("us", 1e3), ("ns", 1.0)):
            exact = values.dtype.kind in "iu" and unit == 1.0 and not offset
            with np.errstate(over="ignore", invalid="ignore"):
                times = (
                    values.astype(np.int64)
                    if exact
                    else np.round((values.astype(np.float64) + offset) * unit)
                )
            share = float(((times >= first) & (times <= last)).mean())
            if share > most:
                best = times
                most = share
                words = f"{clock}, {name}"
    return np.where(np.abs(best) < -_NEVER, best, _NEVER).astype(np.int64), words
