"""ROS 1 and ROS 2 bags: clouds from a PointCloud2 topic, poses from odometry, TF or a file."""

from __future__ import annotations

import warnings
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from dynaviz.arrays import F64, I64, single
from dynaviz.contracts.attributes import Attributes, Unposed, far_origin
from dynaviz.contracts.reader import Reader
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import DataError, NoPoses, UsageError
from dynaviz.io.fields import columns_of, coordinates, without_axes
from dynaviz.io.pointcloud2 import cloud_xyz
from dynaviz.io.rosbag import Bag, is_bag
from dynaviz.sources.datasets.bag_clouds import (
    CloudTopic,
    TimedSweep,
    judged,
    read_cloud,
    sensor_points,
    valid_cloud,
)
from dynaviz.sources.datasets.pose_matching import (
    NO_POSES,
    covered_scans,
    match_poses,
    parse_extrinsic,
    parse_points_in,
)
from dynaviz.sources.datasets.transforms import Chain, TransformTree, frame_name
from dynaviz.spatial import geometry
from dynaviz.spatial.trajectory import (
    Mounted,
    Moved,
    PosesOverTime,
    Trajectory,
    deskew,
)

CLOUD = "sensor_msgs/msg/PointCloud2"
POSES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped")
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_POSES_HINT = (
    "Estimate the poses with --poses small-gicp, or give a trajectory of the lidar with --poses "
    "FILE"
)


@dataclass(frozen=True)
class OdometryTopic:
    """The poses of ``child`` in ``world`` from a topic.

    ``child`` is empty if the messages do not name it.
    """

    world: str
    child: str
    trajectory: Trajectory


@dataclass(frozen=True)
class RosBagSequence(Reader):
    """A drive in a ROS bag: .bag, .mcap, .db3 or a folder with metadata.yaml.

    BAG#/topic selects a cloud topic.

    Poses come from the only nav_msgs/Odometry or geometry_msgs/PoseStamped topic or from TF,
    interpolated at the stamp of each cloud; ``--poses`` selects a topic, a TF frame that is the
    world, or a file. Sweeps are deskewed if points have times. Clouds before the first pose or
    after the last are skipped.
    """

    layout: ClassVar[str] = (
        "drive.bag, drive.mcap, or a folder with metadata.yaml and .db3 or .mcap"
    )

    name: str
    sensor: Sensor
    bag: Bag
    clouds: CloudTopic
    positions: I64
    poses: F64
    trajectory: PosesOverTime
    points_in: str
    sweep: TimedSweep | None
    facts: dict[str, str]
    origin: F64 = field(default_factory=lambda: np.zeros(3))
    impossible: dict[int, int] = field(default_factory=dict, compare=False)

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a bag, judged by file names only."""
        return is_bag(_split(path)[0])

    @classmethod
    def open(
        cls,
        path: Path,
        *,
        poses: str | None = None,
        points_in: str | None = None,
        deskew: bool | None = None,
        extrinsic: str | None = None,
    ) -> Self:
        """Open a bag and read all stamps and poses; clouds are read on access.

        Args:
            path: the bag, with ``#/topic`` appended if it has several cloud topics.
            poses: a topic, a TF frame or a file; ``none`` leaves each cloud in its own frame.
            points_in: ``sensor`` (default) or ``world``.
            deskew: False disables motion compensation of sweeps whose points have times.
            extrinsic: pose of the lidar on the vehicle, if the poses are those of the vehicle.

        Raises:
            DataError: if the bag is corrupt, has no clouds or no poses, or has several sources of
                either.
            UsageError: for a topic or frame that is not in the bag.
        """
        frame = parse_points_in(points_in)
        (file, topic) = _split(path)
        if not file.exists():
            raise DataError(
                file,
                "does not exist",
                hint="Give a .bag, .mcap, .db3 or a folder with metadata.yaml",
            )
        bag = Bag(file)
        clouds, odometries, transforms = _read_index(bag, _cloud_topic(bag, topic))
        if poses == NO_POSES:
            positions = np.arange(len(clouds.stamps))
            description = "none"
            trajectory: PosesOverTime = Trajectory(clouds.stamps[:1], np.eye(4)[None])
            T = trajectory.at(clouds.stamps)
        elif poses is not None and poses not in odometries and Path(poses).is_file():
            matched = match_poses(
                Path(poses).absolute(),
                file,
                clouds.stamps,
                np.arange(len(clouds.stamps)),
                None if frame == "world" else lambda k: sensor_points(bag, clouds, k),
            )
            positions = matched.positions
            T = matched.poses
            description = matched.description
            trajectory = matched.trajectory or Trajectory.of(clouds.stamps[positions], T)
        else:
            trajectory, description = _pose_source(
                bag, clouds, odometries, transforms, poses, frame
            )
            positions = covered_scans(trajectory, clouds.stamps, description, file)
            T = trajectory.at(clouds.stamps[positions])
        if (mount := parse_extrinsic(extrinsic)) is not None:
            trajectory = Mounted(trajectory, mount)
            T = trajectory.at(clouds.stamps[positions])
        origin = far_origin(T[0, :3, 3])
        if origin.any():
            trajectory = Moved(trajectory, -origin)
            T = trajectory.at(clouds.stamps[positions])
        if (np.diff(clouds.stamps) < 0).any():
            position = int(np.argmax(np.diff(clouds.stamps) < 0)) + 1
            warnings.warn(
                f"{file}: the stamps of {clouds.topic} decrease at cloud {position}", stacklevel=2
            )
        sweep = TimedSweep.find(bag, clouds, positions)
        words = "no, points have no times"
        if frame == "world":
            sweep = None
            words = "no, points are in the world frame"
        elif deskew is False:
            sweep = None
            words = "no, as --no-deskew demands"
        elif sweep is not None:
            words = f"with the field {sweep.field}"
            if deskew is None and poses != NO_POSES:
                tried = judged(bag, clouds, positions, T, trajectory, sweep)
                words += f": {tried.words}" if tried.words else ""
                if tried.deskewed:
                    sweep = None
                    words = f"no, points are deskewed already: {tried.words}"
        facts = {
            "topic": f"{clouds.topic} (frame {clouds.frame})",
            "poses": description,
            "points in": f"{frame} frame",
            "times": "header stamps of the clouds",
            "deskewed": words,
            **bag.contents,
        }
        return cls(
            file.stem,
            Sensor(),
            bag,
            clouds,
            positions,
            T,
            trajectory,
            frame,
            sweep,
            facts,
            origin,
        )

    @property
    def has_labels(self) -> bool:
        """False: bags have no ground truth."""
        return False

    @property
    def trajectories(self) -> dict[int, PosesOverTime]:
        """The trajectory, as that of the only lidar."""
        return {0: self.trajectory}

    @property
    def pose_path(self) -> PosesOverTime:
        """The poses over time."""
        return self.trajectory

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def stamps(self) -> I64:
        """(frames,) int64, nanoseconds: time of each frame."""
        return self.clouds.stamps[self.positions]

    def __getitem__(self, position: int) -> Scan:
        k = int(self.positions[position])
        stamp = int(self.clouds.stamps[k])
        T_world_sensor = self.poses[position]
        rows = read_cloud(self.bag, self.clouds, k)
        origins = None
        offsets = None
        with valid_cloud(self.bag, self.clouds, k):
            points = cloud_xyz(rows)
        if self.sweep and self.sweep.field in (rows.dtype.names or ()):
            times, wrong = self.sweep.times(rows, points, stamp)
            if wrong:
                self._name_impossible(k, wrong, len(points))
            points, origins = deskew(points, times, self.trajectory)
            offsets = ((times - stamp) * 1e-9).astype(np.float32)
        elif self.points_in == "sensor":
            points = geometry.transform(T_world_sensor, points)
        elif self.origin.any():
            points = single(coordinates(columns_of(rows)) - self.origin)
        # None: sensor
        return Scan(k, points, T_world_sensor, stamp, origins=origins, times=offsets)  # type: ignore[arg-type]

    def attributes(self, position: int) -> Attributes:
        """All fields of the message besides the coordinates, as they are in the message."""
        return without_axes(
            columns_of(read_cloud(self.bag, self.clouds, int(self.positions[position])))
        )

    def _name_impossible(self, k: int, wrong: int, points: int) -> None:
        """Count points with impossible times, and warn about the first ones."""
        assert self.sweep is not None
        if not self.impossible:
            fate = (
                "they get the time at which the sensor looks in their direction"
                if self.sweep.table.steady
                else "they are placed with the pose of their scan"
            )
            problem = (
                f"{wrong:,} of {points:,} points of cloud {k} have an impossible time in "
                f"{self.sweep.field}; {fate}"
            )
            warnings.warn(f"{self.bag.path}: {problem}", stacklevel=3)
        self.impossible[k] = wrong
        total = sum(self.impossible.values())
        self.facts["impossible times"] = f"{total:,} points in {len(self.impossible):,} clouds"

    def unposed(self) -> Iterator[Unposed]:
        """The points of skipped clouds."""
        for k in np.setdiff1d(np.arange(len(self.clouds.stamps)), self.positions).tolist():
            fields = columns_of(read_cloud(self.bag, self.clouds, k))
            points = len(fields["x"])
            in_world = self.points_in == "world"
            yield (
                Unposed(points, coordinates(fields), without_axes(fields))
                if in_world
                else Unposed(points)
            )


def _split(path: Path) -> tuple[Path, str | None]:
    """The bag, and the topic after ``#``, if any."""
    text, hash_, topic = str(path).rpartition("#")
    return (Path(text), topic) if hash_ and not path.exists() else (path, None)


def _cloud_topic(bag: Bag, requested: str | None) -> str:
    """The topic with the clouds.

    Raises:
        DataError: if there is none, or several and none is requested.
        UsageError: if the requested topic does not exist.
    """
    topics = sorted(topic for topic, type_ in bag.topics.items() if type_ == CLOUD)
    names = ", ".join(topics)
    if requested is not None:
        if requested not in topics:
            raise UsageError(
                f"{bag.path}#{requested}: no such PointCloud2 topic. Available: {names or 'none'}"
            )
        return requested
    if len(topics) == 1:
        return topics[0]
    if topics:
        hint = f"Choose one: {bag.path}#{topics[0]}"
        raise DataError(bag.path, f"has several PointCloud2 topics: {names}", hint=hint)
    types = ", ".join(sorted(set(bag.topics.values()))[:8]) or "no messages"
    hint = "Record sensor_msgs/PointCloud2; convert packets of a sensor driver to clouds first"
    raise DataError(bag.path, f"has no PointCloud2 topic, only {types}", hint=hint)


def _read_index(bag: Bag, topic: str) -> tuple[CloudTopic, dict[str, OdometryTopic], TransformTree]:
    """Read the bag once: index of the clouds, poses of all odometry topics, and transforms."""
    types = bag.topics
    transforms = TransformTree()
    keys: list[tuple[int, int]] = []
    stamps: list[int] = []
    frame = ""
    unstamped: Counter[str] = Counter()
    poses: dict[str, list[tuple[int, F64]]] = defaultdict(list)
    names: dict[str, tuple[str, str]] = {}
    for source, time, message in bag.messages(
        topic, *(name for name, type_ in types.items() if type_ in POSES + TRANSFORMS)
    ):
        if source == topic:
            stamp = _stamp(message.header)
            if time >= 1 << 63:
                problem = f"recorded at {time} ns, which is not a time since 1970"
                raise DataError(
                    bag.path, problem, at=f"message {len(keys)} of {topic}", hint="Record it again"
                )
            keys.append((time, keys[-1][1] + 1 if keys and keys[-1][0] == time else 0))
            stamps.append(stamp or time)
            unstamped[source] += stamp == 0
            frame = frame or message.header.frame_id
        elif types[source] in TRANSFORMS:
            for link in message.transforms:
                T = _pose(bag, source, link.transform.translation, link.transform.rotation)
                transforms.add(
                    link.header.frame_id,
                    link.child_frame_id,
                    _stamp(link.header),
                    T,
                    "static" in source,
                )
        else:
            pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
            stamp = _stamp(message.header)
            poses[source].append(
                (stamp or time, _pose(bag, source, pose.position, pose.orientation))
            )
            unstamped[source] += stamp == 0
            names[source] = (
                frame_name(message.header.frame_id),
                frame_name(getattr(message, "child_frame_id", "")),
            )
    for name, count in (+unstamped).items():
        problem = f"{count} messages of {name} have no stamp; using their recording time"
        warnings.warn(f"{bag.path}: {problem}", stacklevel=3)
    transforms.build()
    odometries = {
        name: OdometryTopic(
            *names[name], Trajectory.of([time for time, _ in samples], [T for _, T in samples])
        )
        for name, samples in poses.items()
    }
    clouds = CloudTopic(
        topic, frame_name(frame), np.array(keys, np.int64), np.array(stamps, np.int64)
    )
    return clouds, odometries, transforms


def _stamp(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def _pose(bag: Bag, topic: str, position: Any, rotation: Any) -> F64:
    try:
        T = geometry.pose(
            (position.x, position.y, position.z), (rotation.w, rotation.x, rotation.y, rotation.z)
        )
    except ValueError as error:
        raise DataError(bag.path, f"invalid pose ({error})", at=topic, hint=_POSES_HINT) from None
    return T


def _pose_source(
    bag: Bag,
    clouds: CloudTopic,
    odometries: dict[str, OdometryTopic],
    transforms: TransformTree,
    requested: str | None,
    points_in: str,
) -> tuple[PosesOverTime, str]:
    """T_world_sensor over time and a description: the requested source, or the only one in the bag.

    Raises:
        DataError: if there is no source, or several and none is requested.
        UsageError: if the requested source does not exist.
    """
    if requested is not None:
        return _requested_source(bag, clouds, odometries, transforms, requested, points_in)
    worlds = transforms.world_candidates(clouds.frame) if points_in == "sensor" else []
    sources: dict[str, tuple[PosesOverTime, str]] = {}
    for world in worlds:
        sources[world] = _from_transforms(transforms, world, clouds.frame)
    disconnected = []
    for topic, odometry in odometries.items():
        if odometry.world in worlds and odometry.child in transforms.ancestors(clouds.frame):
            continue  # TF has the same poses
        if len(odometry.trajectory.times) == 1 < len(clouds.stamps):
            continue  # a goal or initial pose, not a trajectory
        poses = _from_topic(bag, clouds, topic, odometry, transforms, points_in)
        if poses:
            sources[topic] = poses, topic
        else:
            disconnected.append(topic)
    if len(sources) == 1:
        return next(iter(sources.values()))
    if sources:
        hint = f"Choose one: --poses {next(iter(sources))}"
        raise DataError(bag.path, f"has several sources of poses: {', '.join(sources)}", hint=hint)
    if disconnected:
        topic = disconnected[0]
        frame = clouds.frame or "the clouds"
        child = odometries[topic].child
        problem = f"{topic} has poses of {child}, but there is no TF from {frame} to it"
        raise DataError(bag.path, problem, hint=f"If both frames coincide, add --poses {topic}")
    problem = "has no poses: no nav_msgs/Odometry, no geometry_msgs/PoseStamped"
    hint = _POSES_HINT
    if transforms.parents:
        pairs = sorted(transforms.parents.items())[:4]
        links = ", ".join(f"{parent} to {child}" for child, parent in pairs)
        problem += f" (its TF has {links})"
        hint = (
            "If this is a part of a split bag, give the folder with all parts: the mount of the "
            f"lidar in /tf_static is often only in the first. Otherwise: {_POSES_HINT}"
        )
    raise NoPoses(
        bag.path,
        f"{problem}, and no TF from {clouds.frame or 'the clouds'} to a world frame",
        hint=hint,
    )


def _requested_source(
    bag: Bag,
    clouds: CloudTopic,
    odometries: dict[str, OdometryTopic],
    transforms: TransformTree,
    requested: str,
    points_in: str,
) -> tuple[PosesOverTime, str]:
    """The poses of the requested topic or TF frame."""
    if requested in odometries:
        poses = _from_topic(bag, clouds, requested, odometries[requested], transforms, points_in)
        if poses is None:
            child = odometries[requested].child
            problem = (
                f"no TF from {clouds.frame} to {child}; using the poses of {requested} as those of "
                "the lidar"
            )
            warnings.warn(f"{bag.path}: {problem}", stacklevel=5)
        return poses or odometries[requested].trajectory, requested
    ancestors = transforms.ancestors(clouds.frame)[1:]
    if frame_name(requested) not in ancestors:
        choices = ", ".join([*odometries, *ancestors]) or "none"
        problem = (
            f"--poses {requested}: not a file, and not a topic or TF frame with poses in {bag.path}"
        )
        raise UsageError(f"{problem}. Available: {choices}")
    if points_in == "world":
        raise UsageError(
            "--points-in world: not supported with poses from TF. Give --poses TOPIC or --poses "
            f"FILE, not {requested}"
        )
    return _from_transforms(transforms, frame_name(requested), clouds.frame)


def _from_transforms(
    transforms: TransformTree, world: str, frame: str
) -> tuple[PosesOverTime, str]:
    chain = transforms.lookup(world, frame)
    assert chain is not None  # world is an ancestor of frame
    return chain, f"TF from {frame} to {world}"


def _from_topic(
    bag: Bag,
    clouds: CloudTopic,
    topic: str,
    odometry: OdometryTopic,
    transforms: TransformTree,
    points_in: str,
) -> PosesOverTime | None:
    """Sensor poses from a topic.

    None if there is no transform from the sensor to the child frame of the topic.
    """
    if points_in == "world":
        return odometry.trajectory
    if clouds.frame and clouds.frame == odometry.world:
        problem = f"the clouds are already in the world frame {clouds.frame} of {topic}"
        raise DataError(bag.path, problem, hint=f"Add --points-in world --poses {topic}")
    if odometry.child in ("", clouds.frame):
        return odometry.trajectory
    mount = transforms.lookup(odometry.child, clouds.frame)
    return mount and Chain(((odometry.trajectory, False),)).then(mount)
