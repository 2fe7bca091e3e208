"""The drive: the frames of one sequence, as every part of dynaviz receives them.

A drive is a value. It says what is read, which frames, with which poses and sensor, in which world
frame, and whether with ground truth. What changes one of these returns another drive.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock

import msgspec
import numpy as np

from dynaviz.arrays import F32, F64, I64
from dynaviz.contracts.attributes import Attributes, Unposed, precision_of
from dynaviz.contracts.reader import Reader, reader_of
from dynaviz.contracts.scan import Scan, Sequence
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import UsageError
from dynaviz.sources.origin import EstimatedPoses, Origin, PoseRefinement, SourceReading
from dynaviz.spatial import geometry
from dynaviz.spatial.trajectory import Moved, PosesOverTime


@dataclass(frozen=True, eq=False)
class OtherPoses:
    """Poses that scans have instead of their own.

    Attributes:
        T_world_sensor: (frames, 4, 4) float64, metres, by position in the drive.
        refinement: how far they differ from the earlier ones, in the same world frame; None for
            estimated poses, whose world frame is their own.
    """

    T_world_sensor: F64
    refinement: PoseRefinement | None = None

    def applied(self, scan: Scan, position: int) -> Scan:
        """A scan, moved from its pose to the one at a position."""
        T_world_sensor = self.T_world_sensor[position]
        move = geometry.compose(T_world_sensor, geometry.inverse(scan.T_world_sensor))
        return dataclasses.replace(
            scan,
            points=geometry.transform(move, scan.points),
            T_world_sensor=T_world_sensor,
            origins=geometry.apply(move, scan.origins),
        )

    def facts(self, given: Mapping[str, str]) -> Mapping[str, str]:
        """Facts of a sequence, with those of its poses."""
        if self.refinement is None:
            return {**given, "poses": "estimated"}
        return {**given, "poses": f"{given.get('poses', 'of the sequence')}, refined"}


@dataclass(frozen=True, eq=False)
class Drive:
    """The frames of a sequence; ``drive[k]`` is the only place where a scan is read and changed.

    Attributes:
        reader: reads the frames of the source.
        rows: the frames that belong to the drive, by their position in the source.
        sensor: that recorded it.
        name: short, for folders and table rows.
        origin: (3,) float64, metres: add it to points and poses to get the coordinates of the
            source.
        poses: other poses than those of the source, in the order in which they were applied.
        truth: whether scans have their ground truth.
        selected: whether some frames of the source were left out, and with them its points that no
            frame contains.
        provenance: where it came from, enough to open it again.
        estimated: the poses that an odometry estimated when it was opened; None for given poses.
        lock: held while a frame is read, for several threads with one reader.
    """

    reader: Reader
    rows: range
    sensor: Sensor
    name: str
    origin: F64
    poses: tuple[OtherPoses, ...] = ()
    truth: bool = True
    selected: bool = False
    provenance: Origin = field(default_factory=Origin)
    estimated: EstimatedPoses | None = None
    lock: Lock | None = None

    @classmethod
    def of(cls, sequence: Sequence) -> Drive:
        """All frames of a sequence; a drive as it is."""
        if isinstance(sequence, Drive):
            return sequence
        reader = reader_of(sequence)
        name = reader.name
        sensor = reader.sensor
        provenance = Origin(format=reader.format, name=name, sensor=sensor)
        rows = range(len(reader))
        return cls(reader, rows, sensor, name, reader.origin, provenance=provenance)

    @property
    def has_labels(self) -> bool:
        """Whether any frame has ground truth."""
        return self.truth and self.reader.has_labels

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, position: int) -> Scan:
        """Read the frame at a position from 0 to len - 1; raises IndexError otherwise."""
        row = self.rows[position]
        with self.lock or nullcontext():
            scan = self.reader[row]
        for each in self.poses:
            scan = each.applied(scan, position)
        if self._shift.any():
            scan = scan.moved(self._shift)
        return scan if self.truth else scan.without_truth()

    def __repr__(self) -> str:
        truth = "with" if self.has_labels else "without"
        sensor = self.sensor.title if self.sensor.name == "unknown" else self.sensor.name
        return f"<Drive {self.name}: {len(self):,} frames, {sensor}, {truth} ground truth>"

    def select(self, frames: str | None = None, stride: int = 1) -> Drive:
        """Some of the frames.

        Args:
            frames: ``A:B``, positions as in a Python slice, end exclusive; either may be omitted.
            stride: use every N-th of these frames, N at least 1.

        Raises:
            UsageError: for an invalid or empty range, or an invalid stride.
        """
        if stride < 1:
            raise UsageError(
                f"--stride {stride}: must be at least 1. Give 1 for every frame, 2 for every "
                "second frame"
            )
        try:
            first, last = (int(x) if x.strip() else None for x in (frames or ":").split(":"))
        except ValueError:
            raise UsageError(
                f"--frames {frames}: invalid range. Give A:B, for example 0:100 for the first "
                "hundred frames"
            ) from None
        positions = range(len(self))[slice(first, last, stride)]
        if not positions:
            raise UsageError(
                f"--frames {frames}: selects none of the {len(self)} frames of {self.name}"
            )
        return self.chosen(positions)

    def chosen(self, positions: range) -> Drive:
        """The frames at these positions."""
        rows = slice(positions.start, positions.stop, positions.step)
        known = self.provenance.positions
        selected = (range(len(self)) if known is None else range(*known))[rows]
        changed = known is not None or selected != range(len(self))
        kept = (selected.start, selected.stop, selected.step) if changed else None
        return dataclasses.replace(
            self,
            rows=self.rows[rows],
            selected=self.selected or len(positions) < len(self),
            poses=tuple(
                dataclasses.replace(each, T_world_sensor=each.T_world_sensor[rows])
                for each in self.poses
            ),
            provenance=msgspec.structs.replace(self.provenance, positions=kept),
        )

    def with_sensor(self, sensor: Sensor) -> Drive:
        """The drive with another sensor, such as one with estimates of unknown facts."""
        found = {
            name
            for name in _FACTS
            if getattr(self.sensor, name) is None and getattr(sensor, name) is not None
        } | set(self.provenance.estimated)
        provenance = msgspec.structs.replace(
            self.provenance,
            sensor=sensor,
            estimated=tuple(name for name in _FACTS if name in found),
        )
        return dataclasses.replace(self, sensor=sensor, provenance=provenance)

    def renamed(self, name: str) -> Drive:
        """The drive under another name."""
        provenance = msgspec.structs.replace(self.provenance, name=name)
        return dataclasses.replace(self, name=name, provenance=provenance)

    def with_poses(self, T_world_sensor: F64) -> Drive:
        """The drive with other poses, in a world frame of their own.

        Args:
            T_world_sensor: (frames, 4, 4) float64, metres, by position.
        """
        poses = (*self.poses, OtherPoses(T_world_sensor))
        return dataclasses.replace(self, poses=poses, origin=np.zeros(3))

    def with_refined(self, T_world_sensor: F64, refinement: PoseRefinement) -> Drive:
        """The drive with refined poses, in the same world frame.

        Args:
            T_world_sensor: (frames, 4, 4) float64, metres, by position.
            refinement: how far the poses moved.
        """
        within = T_world_sensor.copy()
        within[:, :3, 3] -= self._shift  # which is added again
        return dataclasses.replace(
            self,
            poses=(*self.poses, OtherPoses(within, refinement)),
            provenance=msgspec.structs.replace(self.provenance, refined=True),
        )

    def at(self, origin: F64) -> Drive:
        """The drive in a world frame with another origin, (3,) metres."""
        return dataclasses.replace(self, origin=origin)

    def blind(self) -> Drive:
        """The drive without its ground truth."""
        return dataclasses.replace(self, truth=False)

    def for_threads(self) -> Drive:
        """The drive, of which one thread reads at a time."""
        return dataclasses.replace(self, lock=Lock())

    @property
    def refinement(self) -> PoseRefinement | None:
        """How far the poses were refined; None if they were not."""
        return self.poses[-1].refinement if self.poses else None

    @property
    def exact(self) -> bool:
        """Whether poses and sensor are exact: nobody estimates or checks them."""
        return self.reader.exact and not self.poses

    @property
    def facts(self) -> Mapping[str, str]:
        """Further facts by name, such as the topic of a bag or the number of tracks."""
        facts = self.reader.facts
        for each in self.poses:
            facts = each.facts(facts)
        return facts

    @property
    def reading(self) -> SourceReading:
        """How the numbers of the source were read.

        Raises:
            DataError: if the first frame cannot be read.
        """
        facts = self.facts
        mount = self.provenance.options.extrinsic
        given = self.reader.coordinates(self.rows[0]) if len(self) else None
        coordinates = precision_of(given)
        odometry = self.estimated and f"estimated with {self.estimated.odometry}"
        known = "those of the data set" if self.reader.stamps is not None else "none"
        return SourceReading(
            poses=odometry or facts.get("poses", "those of the data set"),
            times=facts.get("times") or facts.get("split by") or facts.get("names") or known,
            points_in=facts.get("points in", ""),
            deskewed=facts.get("deskewed", ""),
            columns=facts.get("columns", ""),
            mount=mount or "none, the poses are taken as those of the lidar",
            coordinates=str(coordinates or "float32"),
        )

    @property
    def stamps(self) -> I64 | None:
        """(frames,) int64, nanoseconds; None if a scan must be read to know."""
        stamps = self.reader.stamps
        return None if stamps is None else stamps[self.rows.start : self.rows.stop : self.rows.step]

    @property
    def trajectories(self) -> Mapping[int, PosesOverTime]:
        """T_world_sensor over time of each lidar; empty if poses of scans are known only."""
        if self.poses:
            return {}
        found = self.reader.trajectories
        if not self._shift.any():
            return found
        return {lidar: Moved(poses, self._shift) for lidar, poses in found.items()}

    @property
    def pose_path(self) -> PosesOverTime | None:
        """T_world_sensor over time, by which frames were placed by their stamps; None if their
        poses have no times.
        """
        found = None if self.poses else self.reader.pose_path
        return Moved(found, self._shift) if found is not None and self._shift.any() else found

    @property
    def las_file(self) -> Path | None:
        """A LAS file in whose world frame the scans are, apart from ``origin``.

        None without one.
        """
        return None if self._own_world else self.reader.las_file

    @property
    def unmatched(self) -> Mapping[int, int]:
        """Number of points without ground truth, by frame number, of the frames read so far."""
        return self.reader.unmatched

    def scan_file(self, index: int) -> Path | None:
        """The file of the frame with this number; None if frames have no files of their own."""
        return self.reader.scan_file(index)

    def attributes(self, position: int) -> Attributes:
        """Attributes of the frame at a position, in the order of its points.

        Empty if it has none.
        """
        return self.reader.attributes(self.rows[position])

    def coordinates(self, position: int) -> F32 | F64 | None:
        """(N, 3), metres: coordinates of a frame as the source states them, in its type.

        None if they follow from its points.
        """
        return None if self.poses else self.reader.coordinates(self.rows[position])

    def exact_points(self, position: int, scan: Scan) -> F64:
        """(N, 3) float64, metres, in the coordinates of the source.

        As the source states them, otherwise the points of the scan at this position.
        """
        given = self.coordinates(position)
        if given is not None:
            return given.astype(np.float64)
        points: F64 = scan.points.astype(np.float64) + self.origin
        return points

    def unposed(self) -> Iterator[Unposed]:
        """Points that no pose covers, piece by piece; none if frames are selected.

        Their place is unknown in the world frame of estimated poses.
        """
        if self.selected:
            return
        for each in self.reader.unposed():
            yield dataclasses.replace(each, xyz=None) if self._own_world else each

    @property
    def _own_world(self) -> bool:
        return any(each.refinement is None for each in self.poses)

    @property
    def _shift(self) -> F64:
        """(3,) float64, metres: what is added to scans that were read and moved."""
        shift: F64 = (np.zeros(3) if self._own_world else self.reader.origin) - self.origin
        return shift


_FACTS = tuple(each.name for each in dataclasses.fields(Sensor))
