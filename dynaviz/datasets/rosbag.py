"""Bags of ROS 1 and ROS 2: clouds from a PointCloud2 topic, poses from odometry, TF or a file."""

from __future__ import annotations

import warnings
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F32, F64, I64
from dynaviz.datasets.pose_matching import frame_of, inside, match
from dynaviz.datasets.transforms import Chain, Frames, plain
from dynaviz.errors import DataError, UsageError
from dynaviz.io.pointcloud2 import cloud_rows, cloud_xyz
from dynaviz.io.rosbag import Bag, is_bag
from dynaviz.scan import Scan
from dynaviz.sensors import Sensor
from dynaviz.spatial import geometry
from dynaviz.spatial.trajectory import FIELDS, Trajectory, deskew, point_times, unit_of
from dynaviz.spatial.trajectory import PosesOverTime as PosePath

CLOUD = "sensor_msgs/msg/PointCloud2"
POSES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped")
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
SAMPLES = 5  # clouds from which the unit of their points' times is told
_TRAJECTORY = "Give a trajectory of the lidar with --poses FILE; any odometry, for example KISS-ICP, writes one"


@dataclass(frozen=True)
class CloudTopic:
    """Where the clouds of a topic are.

    Attributes:
        topic, frame: of the first cloud.
        keys: (N, 2) int64: time of recording in ns, and which of those at that time.
        stamps: (N,) int64, nanoseconds: the header's, or the time of recording where a header has none.
    """

    topic: str
    frame: str
    keys: I64
    stamps: I64


@dataclass(frozen=True)
class Odometry:
    """The poses of a topic: of ``child`` in ``world``; ``child`` is empty where the messages do not tell."""

    world: str
    child: str
    path: Trajectory


@dataclass(frozen=True)
class RosBagSequence:
    """A drive in a bag: .bag, .mcap, .db3 or a folder with metadata.yaml; BAG#/topic chooses among several clouds.

    Poses come from the only nav_msgs/Odometry or geometry_msgs/PoseStamped topic or from TF, interpolated at the stamp
    of each cloud; ``--poses`` chooses a topic, a TF frame that is the world, or a file. Where points have times, each
    is placed by the pose of its own time. Clouds before the first pose or after the last are left out.
    """

    layout: ClassVar[str] = "drive.bag, drive.mcap, or a folder with metadata.yaml and .db3 or .mcap"

    name: str
    sensor: Sensor
    bag: Bag
    clouds: CloudTopic
    positions: I64
    poses: F64
    path: PosePath
    points_in: str
    clock: tuple[str, float] | None
    facts: dict[str, str]

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a bag by its name."""
        return is_bag(_split(path)[0])

    @classmethod
    def open(
        cls, path: Path, *, poses: str | None = None, points_in: str | None = None, deskew: bool | None = None
    ) -> Self:
        """Open a bag: all its stamps and poses are read, no cloud is kept.

        Args:
            path: the bag, with ``#/topic`` where it has several topics of clouds.
            poses: a topic, a TF frame or a file.
            points_in: ``sensor`` (default) or ``world``.
            deskew: False leaves the points of a sweep where they are, although they have times.

        Raises:
            DataError: for a bag that is damaged, has no clouds, no poses, or a choice.
            UsageError: for a topic or frame that is not in it.
        """
        frame, (file, topic) = frame_of(points_in), _split(path)
        if not file.exists():
            raise DataError(file, "does not exist", hint="Give a .bag, .mcap, .db3 or a folder with metadata.yaml")
        bag = Bag(file)
        clouds, odometries, frames = _walk(bag, _topic(bag, topic))
        if poses is not None and poses not in odometries and Path(poses).is_file():
            matched = match(Path(poses).absolute(), file, clouds.stamps, np.arange(len(clouds.stamps)))
            positions, T, how = matched.positions, matched.poses, matched.how
            source: PosePath = matched.path or Trajectory.of(clouds.stamps[positions], T)
        else:
            source, how = _source(bag, clouds, odometries, frames, poses, frame)
            positions = inside(source, clouds.stamps, how, file)
            T = source.at(clouds.stamps[positions])
        if (np.diff(clouds.stamps) < 0).any():
            back = int(np.argmax(np.diff(clouds.stamps) < 0)) + 1
            warnings.warn(f"{file}: the stamps of {clouds.topic} go backwards at cloud {back}", stacklevel=2)
        clock = None if frame == "world" or deskew is False else _clock(bag, clouds, positions)
        facts = {"topic": f"{clouds.topic} (frame {clouds.frame})", "poses": how, "points in": f"{frame} frame",
                 "de-skewed": f"by the points' {clock[0]}" if clock else "no"}  # fmt: skip
        return cls(file.stem, Sensor(), bag, clouds, positions, T, source, frame, clock, facts)

    @property
    def has_labels(self) -> bool:
        """Bags have no ground truth."""
        return False

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, position: int) -> Scan:
        k = int(self.positions[position])
        stamp, T_world_sensor = int(self.clouds.stamps[k]), self.poses[position]
        rows = _rows(self.bag, self.clouds, k)
        points, origins = _xyz(self.bag, self.clouds, k, rows), None
        if self.clock and self.clock[0] in (rows.dtype.names or ()):
            times = point_times(rows[self.clock[0]], self.clock[1], stamp)
            points, origins = deskew(points, times, self.path)
        elif self.points_in == "sensor":
            points = geometry.transform(T_world_sensor, points)
        return Scan(k, points, T_world_sensor, stamp, origins=origins)  # type: ignore[arg-type]  # None is the position


def _split(path: Path) -> tuple[Path, str | None]:
    """The bag, and the topic after ``#`` if there is one."""
    text, hash_, topic = str(path).rpartition("#")
    return (Path(text), topic) if hash_ and not path.exists() else (path, None)


def _topic(bag: Bag, asked: str | None) -> str:
    """The topic with the clouds.

    Raises:
        DataError: where there is none, or a choice.
        UsageError: for one that is not there.
    """
    clouds = sorted(topic for topic, kind in bag.topics.items() if kind == CLOUD)
    names = ", ".join(clouds)
    if asked is not None:
        if asked not in clouds:
            raise UsageError(f"{bag.path}#{asked}: no such topic of clouds. There are: {names or 'none'}")
        return asked
    if len(clouds) == 1:
        return clouds[0]
    if clouds:
        raise DataError(bag.path, f"has several topics of clouds: {names}", hint=f"Choose one: {bag.path}#{clouds[0]}")
    kinds = ", ".join(sorted(set(bag.topics.values()))[:8]) or "no messages"
    hint = "Record a topic of sensor_msgs/PointCloud2; packets of a sensor must be turned into clouds first"
    raise DataError(bag.path, f"has no topic of clouds, but {kinds}", hint=hint)


def _walk(bag: Bag, topic: str) -> tuple[CloudTopic, dict[str, Odometry], Frames]:
    """One walk through the bag: where the clouds are, and all poses."""
    kinds, frames = bag.topics, Frames()
    keys: list[tuple[int, int]] = []
    stamps: list[int] = []
    frame = ""
    unstamped: Counter[str] = Counter()
    found: dict[str, list[tuple[int, F64]]] = defaultdict(list)
    names: dict[str, tuple[str, str]] = {}
    for source, time, message in bag.messages(
        topic, *(name for name, kind in kinds.items() if kind in POSES + TRANSFORMS)
    ):
        if source == topic:
            stamp = _stamp(message.header)
            keys.append((time, keys[-1][1] + 1 if keys and keys[-1][0] == time else 0))
            stamps.append(stamp or time)
            unstamped[source] += stamp == 0
            frame = frame or message.header.frame_id
        elif kinds[source] in TRANSFORMS:
            for link in message.transforms:
                T = _pose(bag, source, link.transform.translation, link.transform.rotation)
                frames.tell(link.header.frame_id, link.child_frame_id, _stamp(link.header), T, "static" in source)
        else:
            pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
            stamp = _stamp(message.header)
            found[source].append((stamp or time, _pose(bag, source, pose.position, pose.orientation)))
            unstamped[source] += stamp == 0
            names[source] = plain(message.header.frame_id), plain(getattr(message, "child_frame_id", ""))
    for name, count in (+unstamped).items():
        remark = f"{count} messages of {name} have no stamp; the time of recording is taken"
        warnings.warn(f"{bag.path}: {remark}", stacklevel=3)
    frames.settle()
    odometries = {
        name: Odometry(*names[name], Trajectory.of([time for time, _ in told], [T for _, T in told]))
        for name, told in found.items()
    }
    return CloudTopic(topic, plain(frame), np.array(keys, np.int64), np.array(stamps, np.int64)), odometries, frames


def _stamp(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def _pose(bag: Bag, topic: str, position: Any, turn: Any) -> F64:
    try:
        T = geometry.pose((position.x, position.y, position.z), (turn.w, turn.x, turn.y, turn.z))
    except ValueError as error:
        raise DataError(bag.path, f"has a pose that is none ({error})", at=topic, hint=_TRAJECTORY) from None
    return T


def _source(
    bag: Bag, clouds: CloudTopic, odometries: dict[str, Odometry], frames: Frames, asked: str | None, points_in: str
) -> tuple[PosePath, str]:
    """T_world_sensor over time, and where it comes from: what was asked for, or the only source there is.

    Raises:
        DataError: where there is none, or a choice.
        UsageError: for what was asked for and is not there.
    """
    if asked is not None:
        return _asked(bag, clouds, odometries, frames, asked, points_in)
    worlds = frames.worlds(clouds.frame) if points_in == "sensor" else []
    known: dict[str, tuple[PosePath, str]] = {world: _by_frames(frames, world, clouds.frame) for world in worlds}
    apart = []
    for topic, odometry in odometries.items():
        if odometry.world in worlds and odometry.child in frames.above(clouds.frame):
            continue  # TF tells the same
        if len(odometry.path.times) == 1 < len(clouds.stamps):
            continue  # a goal or a start, but no way
        path = _by_topic(bag, clouds, topic, odometry, frames, points_in)
        if path:
            known[topic] = path, topic
        else:
            apart.append(topic)
    if len(known) == 1:
        return next(iter(known.values()))
    if known:
        hint = f"Choose one: --poses {next(iter(known))}"
        raise DataError(bag.path, f"has several sources of poses: {', '.join(known)}", hint=hint)
    if apart:
        child = odometries[apart[0]].child
        problem = f"has no TF from {clouds.frame} to {child}, whose poses {apart[0]} gives"
        raise DataError(bag.path, problem, hint=f"If both are in the same place, add --poses {apart[0]}")
    problem = "has no poses: no nav_msgs/Odometry, no geometry_msgs/PoseStamped"
    raise DataError(bag.path, f"{problem}, and no TF from {clouds.frame or 'the clouds'} to a world", hint=_TRAJECTORY)


def _asked(
    bag: Bag, clouds: CloudTopic, odometries: dict[str, Odometry], frames: Frames, asked: str, points_in: str
) -> tuple[PosePath, str]:
    """The topic or frame that was asked for."""
    if asked in odometries:
        path = _by_topic(bag, clouds, asked, odometries[asked], frames, points_in)
        if path is None:
            child = odometries[asked].child
            remark = f"no TF from {clouds.frame} to {child}; the poses of {asked} are taken for those of the lidar"
            warnings.warn(f"{bag.path}: {remark}", stacklevel=5)
        return path or odometries[asked].path, asked
    above = frames.above(clouds.frame)[1:]
    if plain(asked) not in above:
        choices = ", ".join([*odometries, *above]) or "none"
        raise UsageError(f"--poses {asked}: neither a file nor a source of poses in {bag.path}. There are: {choices}")
    if points_in == "world":
        raise UsageError(
            f"--points-in world: TF does not tell where the sensor is. Give --poses TOPIC or --poses FILE, not {asked}"
        )
    return _by_frames(frames, plain(asked), clouds.frame)


def _by_frames(frames: Frames, world: str, frame: str) -> tuple[PosePath, str]:
    chain = frames.between(world, frame)
    assert chain is not None  # one hangs on the other
    return chain, f"TF from {frame} to {world}"


def _by_topic(
    bag: Bag, clouds: CloudTopic, topic: str, odometry: Odometry, frames: Frames, points_in: str
) -> PosePath | None:
    """The sensor's path by a topic; None where nothing tells how the sensor is mounted on what the topic is about."""
    if points_in == "world":
        return odometry.path
    if clouds.frame and clouds.frame == odometry.world:
        problem = f"has clouds in the frame {clouds.frame}, in which {topic} gives poses: they are in the world already"
        raise DataError(bag.path, problem, hint=f"Add --points-in world --poses {topic}")
    if odometry.child in ("", clouds.frame):
        return odometry.path
    mount = frames.between(odometry.child, clouds.frame)
    return mount and Chain(((odometry.path, False),)).then(mount)


def _clock(bag: Bag, clouds: CloudTopic, positions: I64) -> tuple[str, float] | None:
    """The field with the points' times, and nanoseconds a count of it; None where there is none that spans a sweep.

    Some sweeps are looked at, for a single one may be cut.
    """
    widest: tuple[float, str, float] | None = None
    for k in np.unique(np.linspace(0, len(positions) - 1, SAMPLES).astype(int)):
        rows = _rows(bag, clouds, int(positions[k]))
        field = next((name for name in FIELDS if name in (rows.dtype.names or ())), None)
        if field is None or rows.dtype[field].shape or not len(rows):
            continue
        values = rows[field][np.isfinite(rows[field])]
        span = float(values.max() - values.min()) if len(values) else 0.0
        if (unit := unit_of(values)) is not None and (widest is None or span > widest[0]):
            widest = span, field, unit
    return widest and widest[1:]


def _rows(bag: Bag, clouds: CloudTopic, k: int) -> NDArray[Any]:
    """The points of a cloud, as they are."""
    try:
        return cloud_rows(bag.message(clouds.topic, *clouds.keys[k].tolist()))
    except ValueError as error:
        raise _wrong(bag, clouds, k, error) from None


def _xyz(bag: Bag, clouds: CloudTopic, k: int, rows: NDArray[Any]) -> F32:
    try:
        return cloud_xyz(rows)
    except ValueError as error:
        raise _wrong(bag, clouds, k, error) from None


def _wrong(bag: Bag, clouds: CloudTopic, k: int, error: ValueError) -> DataError:
    return DataError(bag.path, f"is no cloud: {error}", at=f"message {k} of {clouds.topic}", hint="Record it again")
