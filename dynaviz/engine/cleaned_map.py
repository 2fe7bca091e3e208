"""Write maps of what a run kept and removed, with attributes, in a second pass over
the sequence.
"""

from __future__ import annotations

import contextlib
import itertools
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz.arrays import F64, I64, U8, Bool, Intp, all_finite
from dynaviz.contracts.attributes import Attributes, Unposed
from dynaviz.contracts.scan import Scan, stream
from dynaviz.engine.loop import Reviewing
from dynaviz.engine.region import Region
from dynaviz.errors import UsageError
from dynaviz.io.las import GPS_EPOCH, adjusted_gps_time
from dynaviz.io.las_map import LAS, LasHead
from dynaviz.io.maps import Writing, divided_map, map_tiles, open_map, row_dtype
from dynaviz.progress import Progress, silent
from dynaviz.scores.account import PointAccount
from dynaviz.sources.drive import Drive
from dynaviz.spatial.grid import KeySet, in_key_range, pack


@dataclass(frozen=True)
class MapFile:
    """A map to write.

    Attributes:
        path: the file, or the folder of a tiled map.
        removed: write the points that the run removed, instead of those that it kept.
        tiled: write Autoware's divided map.
        tile_size: edge of the squares that get a file each in the folder, metres; None for one
            file.
        suffix: of these files.
        region: write only the points inside.
        voxel_size: write one point per voxel of this edge, metres: the first one. None for all
            points.
        marked: write all points, with the attributes ``dynamic`` and ``reason``.
        by_hand: mark also the points whose answer a decision changed.
        reason: write only the points with this code of the method; None for all.
    """

    path: Path
    removed: bool = False
    tiled: bool = False
    tile_size: float | None = None
    suffix: str = ""
    region: Region | None = None
    voxel_size: float | None = None
    marked: bool = False
    by_hand: bool = False
    reason: int | None = None


@dataclass
class WrittenMap:
    """A map that was written.

    Attributes:
        path: file or folder; points: their number; attributes: their names.
        double_pcd: whether it is PCD with x y z in float64, which PCL before 1.15 reads as zeros.
    """

    path: Path
    points: int = 0
    attributes: tuple[str, ...] = field(default=())
    double_pcd: bool = False


JUDGED_STATIC = 0
JUDGED_DYNAMIC = 1
NOT_JUDGED = 2
"""Values of the attribute ``dynamic`` of a map in which points are marked."""

NO_REASON = 255
"""Value of the attribute ``reason`` of points that were not judged."""

_MARKS = {"dynamic": np.dtype(np.uint8), "reason": np.dtype(np.uint8)}
_BY_HAND = {"by_hand": np.dtype(np.uint8)}


@dataclass(frozen=True)
class Judgement:
    """What a run decided.

    Attributes:
        labels: (N,) bool for each frame by position, True for removed points.
        reasons: (N,) uint8 for each frame, in order: codes of the method; None if no file needs
            them.
        review: decisions of a person, which change labels.
    """

    labels: Sequence[Bool]
    reasons: Iterable[U8] | None = None
    review: Reviewing | None = None


def write_maps(
    sequence: Drive,
    judgement: Judgement,
    files: Sequence[MapFile],
    progress: Progress = silent,
    drop_unposed: bool = False,
    seen: Callable[[Scan], None] = lambda scan: None,
) -> tuple[list[WrittenMap], PointAccount]:
    """Write maps in one pass. Points that are not finite are left out.

    Args:
        sequence: what the labels belong to.
        judgement: labels, and reasons if a file needs them.
        files: what to write; the account is that of the first.
        progress: called after each frame.
        drop_unposed: leave out points that no pose covers. Otherwise they are kept, where their
            place is known.
        seen: called with each scan.

    Raises:
        DataError: for data that cannot be read, or files that cannot be written.
        MissingDependency: for LAS and LAZ if laspy is not installed.
    """
    fields = _dtypes(sequence)
    origin = sequence.origin
    given = sequence.coordinates(0)
    double = given is not None and given.dtype == np.float64
    like = sequence.las_file
    stamp = sequence[0].stamp_ns
    timed = stamp is not None and "gps_time" not in fields
    # otherwise the clock does not tell the date
    absolute = stamp is not None and stamp >= GPS_EPOCH * 10**9
    head = LasHead(like, timed and absolute)
    clock = None if not timed else adjusted_gps_time if absolute else _seconds
    conform = _Conform(fields)
    reasons = itertools.repeat(None) if judgement.reasons is None else judgement.reasons
    with contextlib.ExitStack() as stack:
        maps = [_Map(stack, file, fields, origin, head, clock, double) for file in files]
        frames = zip(stream(_Frames(sequence)), reasons, strict=False)
        for position, ((scan, xyz, attributes), codes) in enumerate(frames):
            seen(scan)
            dynamic = judgement.labels[position]
            by_hand = None
            if judgement.review is not None:
                decided, _ = judgement.review.answers(scan, dynamic)
                by_hand = decided != dynamic
                dynamic = decided
            points = _Points(
                xyz=xyz,
                finite=all_finite(scan.points),
                attributes=conform(attributes, len(scan), position),
                dynamic=dynamic,
                by_hand=by_hand,
                reasons=codes,
                times=None if scan.stamp_ns is None else _times(scan, scan.stamp_ns),
            )
            for each in maps:
                each.add(points)
            progress("write", position + 1, len(sequence))
        for unposed in sequence.unposed():
            placed = unposed.xyz is not None and not drop_unposed
            kept = _Points.unjudged(unposed, conform) if placed else None
            for each in maps:
                each.add_unposed(kept, unposed.number)
    return [each.written for each in maps], maps[0].account


@dataclass(frozen=True)
class _Frames:
    """The frames of a sequence, each with its coordinates in the source and its attributes."""

    sequence: Drive

    def __len__(self) -> int:
        return len(self.sequence)

    def __getitem__(self, position: int) -> tuple[Scan, F64, Attributes]:
        scan = self.sequence[position]
        return (
            scan,
            self.sequence.exact_points(position, scan),
            self.sequence.attributes(position),
        )


def region_is_empty(sequence: Drive, region: Region) -> bool:
    """Whether a region contains no point of a sequence.

    Frames are read until one is found, in random order.
    """
    origin = sequence.origin
    for position in np.random.default_rng(0).permutation(len(sequence)).tolist():
        points = sequence[position].points
        if region.contains(points[all_finite(points)].astype(np.float64) + origin).any():
            return False
    unposed = (each.xyz for each in sequence.unposed() if each.xyz is not None)
    return not any(region.contains(xyz).any() for xyz in unposed)


def check_voxel_size(size: float | None) -> None:
    """Raise UsageError unless a voxel size is above 1 mm, or None."""
    if size is not None and not 0.001 <= size < np.inf:
        raise UsageError(f"--voxel-size {size}: give metres, at least 0.001")


@dataclass(frozen=True)
class _Points:
    """Points to write.

    Attributes:
        xyz: (N, 3) float64, metres, coordinates of the source.
        finite: (N,) bool.
        attributes: (N,) each.
        dynamic: (N,) bool, True for removed points; None for points that were not judged.
        by_hand: (N,) bool, points whose answer a decision changed; None without decisions.
        reasons: (N,) uint8, if they are known.
        times: (N,) int64, nanoseconds, if they are known.
    """

    xyz: F64
    finite: Bool
    attributes: Attributes
    dynamic: Bool | None = None
    by_hand: Bool | None = None
    reasons: U8 | None = None
    times: I64 | None = None

    @classmethod
    def unjudged(cls, unposed: Unposed, conform: _Conform) -> _Points:
        """Points that no pose covers, whose place is known."""
        xyz = np.empty((0, 3)) if unposed.xyz is None else unposed.xyz
        return cls(xyz, all_finite(xyz), conform(unposed.attributes, len(xyz), None))

    def marks(self) -> Attributes:
        """The attributes of a map in which points are marked."""
        n = len(self.xyz)
        dynamic = (
            np.full(n, NOT_JUDGED)
            if self.dynamic is None
            else np.where(self.dynamic, JUDGED_DYNAMIC, JUDGED_STATIC)
        )
        reasons = np.full(n, NO_REASON) if self.reasons is None else self.reasons
        by_hand = np.zeros(n) if self.by_hand is None else self.by_hand
        return {
            "dynamic": dynamic.astype(np.uint8),
            "reason": reasons.astype(np.uint8),
            "by_hand": by_hand.astype(np.uint8),
        }


def _seconds(times: I64) -> F64:
    """(N,) float64, seconds."""
    seconds: F64 = times.astype(np.float64) * 1e-9
    return seconds


def _times(scan: Scan, stamp_ns: int) -> I64:
    """(N,) int64, nanoseconds: when each point was measured."""
    offsets = (
        np.zeros(len(scan), np.int64)
        if scan.times is None
        else np.round(scan.times.astype(np.float64) * 1e9)
    )
    return stamp_ns + offsets.astype(np.int64)


def _dtypes(sequence: Drive) -> dict[str, np.dtype[Any]]:
    """Attributes of the first frame that has any, with their types; x, y and z are coordinates."""
    for position in range(min(len(sequence), 10)):
        if found := sequence.attributes(position):
            return {
                name: array.dtype
                for name, array in found.items()
                if name not in ("x", "y", "z", "points")
            }
    return {}


class _Conform:
    """Gives all frames the attributes of the first, with one warning for all frames that have
    others.

    What a frame lacks becomes 0; what only it has is left out.
    """

    def __init__(self, fields: Mapping[str, np.dtype[Any]]) -> None:
        self._fields = fields
        self._warned = False

    def __call__(self, attributes: Attributes, points: int, position: int | None) -> Attributes:
        missing = [name for name in self._fields if name not in attributes]
        more = [name for name in attributes if name not in (*self._fields, "x", "y", "z", "points")]
        if (missing or more) and not self._warned:
            self._warned = True
            where = "points without a pose have" if position is None else f"frame {position} has"
            problems = [f"{where} no {', '.join(missing)}; the map has 0 there"] if missing else []
            problems += (
                [f"{where} also {', '.join(more)}, unlike the first; the map leaves it out"]
                if more
                else []
            )
            warnings.warn(". ".join(problems), stacklevel=3)
        return {
            name: attributes[name].astype(dtype, copy=False)
            if name in attributes
            else np.zeros(points, dtype)
            for name, dtype in self._fields.items()
        }


class _Map:
    """Adds frames to a map, and counts where each point goes."""

    def __init__(
        self,
        stack: contextlib.ExitStack,
        file: MapFile,
        fields: Mapping[str, np.dtype[Any]],
        origin: F64,
        head: LasHead,
        clock: Callable[[I64], F64] | None,
        double: bool,
    ) -> None:
        self._file = file
        self._origin = origin
        self._voxels = KeySet()
        suffix = (file.suffix or file.path.suffix).lower()
        self._clock = clock if suffix in LAS else None
        marks = {**_MARKS, **(_BY_HAND if file.by_hand else {})} if file.marked else {}
        self._marks = tuple(marks)
        if replaced := [name for name in marks if name in fields]:
            warnings.warn(
                f"{file.path}: the marks replace the attribute {' and '.join(replaced)}",
                stacklevel=4,
            )
        own = {**fields, **({"gps_time": np.dtype(np.float64)} if self._clock else {}), **marks}
        self._account = dict.fromkeys(PointAccount.__struct_fields__, 0)
        self._append = stack.enter_context(_writer(file, own, origin, head, double))
        wide = row_dtype({}, origin, double)["x"].itemsize > 4
        double_pcd = wide and suffix == ".pcd" and not file.tiled
        self.written = WrittenMap(file.path, 0, tuple(own), double_pcd)

    @property
    def account(self) -> PointAccount:
        """Where the points went."""
        return PointAccount(**self._account)

    def add(self, points: _Points) -> None:
        """Write the points that belong in the map."""
        self._account["points"] += len(points.xyz)
        chosen = self._take("not_finite", np.arange(len(points.xyz)), points.finite)
        if points.dynamic is not None and not self._file.marked:
            self._account["removed"] += int(points.dynamic[chosen].sum())
            if points.by_hand is not None:
                by_hand = points.by_hand[chosen] & points.dynamic[chosen]
                self._account["removed_by_hand"] += int(by_hand.sum())
            chosen = chosen[points.dynamic[chosen] == self._file.removed]
        if (wanted := self._file.reason) is not None:
            chosen = (
                chosen[:0] if points.reasons is None else chosen[points.reasons[chosen] == wanted]
            )
        if self._file.region is not None:
            chosen = self._take(
                "outside_region", chosen, self._file.region.contains(points.xyz[chosen])
            )
        if self._file.voxel_size is not None:
            chosen = self._take(
                "thinned", chosen, self._first_in_voxels(points.xyz[chosen], self._file.voxel_size)
            )
        if points.dynamic is None:
            self._account["unposed_kept"] += len(chosen)
        else:
            marked = int(points.dynamic[chosen].sum()) if self._file.marked else 0
            self._account["removed"] += marked
            self._account["kept"] += len(chosen) - marked
            if points.by_hand is not None:
                by_hand = points.by_hand[chosen]
                removed = int((by_hand & points.dynamic[chosen]).sum())
                self._account["removed_by_hand"] += removed if self._file.marked else 0
                self._account["kept_by_hand"] += int(by_hand.sum()) - removed
        attributes = {name: array[chosen] for name, array in points.attributes.items()}
        if self._clock:
            known = None if points.times is None else points.times[chosen]
            attributes["gps_time"] = np.zeros(len(chosen)) if known is None else self._clock(known)
        if self._file.marked:
            marks = points.marks()
            attributes |= {name: marks[name][chosen] for name in self._marks}
        self._append(points.xyz[chosen], attributes)
        self.written.points += len(chosen)

    def add_unposed(self, points: _Points | None, number: int) -> None:
        """Write points that no pose covers, or count them if they are left out."""
        if points is None:
            self._account["points"] += number
            self._account["unposed_left_out"] += number
        elif not self._file.removed:
            self.add(points)

    def _take(self, name: str, rows: Intp, which: Bool) -> Intp:
        """Some of the rows; the others are counted."""
        self._account[name] += len(rows) - int(which.sum())
        chosen: Intp = rows[which]
        return chosen

    def _first_in_voxels(self, xyz: F64, size: float) -> Bool:
        """(N,) bool: the first points in voxels without a point.

        Those beyond the range of keys are all kept.
        """
        points = (xyz - self._origin).astype(np.float32)
        new: Bool = np.ones(len(points), np.bool_)
        near = in_key_range(points, size)
        new[near] = self._voxels.add(pack(points[near], size))
        return new


def _writer(
    file: MapFile, fields: Mapping[str, np.dtype[Any]], origin: F64, head: LasHead, double: bool
) -> Writing:
    if file.tile_size is not None:
        return map_tiles(file.path, fields, origin, file.tile_size, file.suffix, head, double)
    if file.tiled:
        return divided_map(file.path, fields, origin)
    return open_map(file.path, fields, origin, head, double)
