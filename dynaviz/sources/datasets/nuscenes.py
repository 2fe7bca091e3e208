"""nuScenes (Caesar et al. 2020): HDL-32E sweeps at 20 Hz, boxes with track ids at 2 Hz."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from dynaviz.arrays import F64, Bool
from dynaviz.contracts.attributes import Attributes
from dynaviz.contracts.reader import Reader
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.errors import DataError
from dynaviz.io.records import read_records
from dynaviz.io.velodyne import read_velodyne, velodyne_attributes
from dynaviz.sources.datasets.box_labels import (
    OrientedBox,
    moving_tracks,
    track_facts,
    truth_from_boxes,
)
from dynaviz.sources.datasets.files import has_files, is_file, only
from dynaviz.sources.datasets.truth import scan_fields
from dynaviz.spatial import geometry

CHANNEL = "LIDAR_TOP"
# metres along x and y of the ego frame; the car itself has no box
EGO_EXTENT = (
    (-0.8, 3.6),
    (-1.1, 1.1),
)
_HINT = "Copy the tables again"
_TYPES: dict[
    str, tuple[type, str]
] = {  # of the values in a record, and their name; all others are text
    "timestamp": (int, "a number of microseconds"),
    "is_key_frame": (bool, "true or false"),
    **dict.fromkeys(("translation", "rotation", "size"), (list, "a list of numbers")),
}
_FARTHEST = 1e9  # metres, of positions and sizes
_LATEST = (1 << 63) // 1000  # microseconds, whose nanoseconds have 64 bits

Record = dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """A sweep of the lidar.

    Attributes:
        path: the file.
        time: microseconds.
        T_world_ego, T_ego_sensor: (4, 4) float64, metres.
        sample: token of its sample if it is a keyframe, else empty.
    """

    path: Path
    time: int
    T_world_ego: F64
    T_ego_sensor: F64
    sample: str


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """Time of a keyframe in microseconds, and its boxes by track, in the world frame."""

    time: int
    boxes: dict[int, OrientedBox]


@dataclass(frozen=True)
class NuScenesSequence(Reader):
    """A scene of nuScenes: keyframes and the sweeps between them.

    Append the name of a scene to the path to select it: ``nuscenes/scene-0061``. The world frame
    has the axes of the map, z up, and its origin at the sensor position of the first sweep.

    Boxes are annotated in keyframes and interpolated between them. If only one of two keyframes has
    an object, its box is extrapolated, and points in an extrapolated moving box are unlabelled.
    Points on the recording car are also unlabelled, and so are all points before the first and
    after the last keyframe. Without the folder ``sweeps``, the sequence consists of the keyframes.
    """

    layout: ClassVar[str] = (
        "{v1.0-mini/*.json, samples/LIDAR_TOP, sweeps/LIDAR_TOP}, followed by the name of a scene"
    )

    scene: str
    sensor: Sensor
    sweeps: list[Sweep]
    keyframes: list[Keyframe]
    class_names: dict[int, str]
    moving: frozenset[int]

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path contains tables ``v1.0-*`` or is a folder of tables, optionally followed
        by a scene name.
        """
        return bool(_versions(path)[0])

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a scene; each table is streamed.

        Raises:
            DataError: if tables or sweeps are missing or corrupt, or there are several scenes.
        """
        tables, scene = _scene(path)
        samples = {
            row["token"]
            for row in _rows(tables, "sample", "scene_token")
            if row["scene_token"] == scene["token"]
        }
        sweeps = _sweeps(tables, samples)
        start = geometry.compose(sweeps[0].T_world_ego, sweeps[0].T_ego_sensor)[:3, 3].copy()
        for sweep in sweeps:
            sweep.T_world_ego[:3, 3] -= start
        names = sorted({row["name"] for row in _rows(tables, "category", "name")})
        keyframes = _keyframes(
            tables, {sweep.sample: sweep.time for sweep in sweeps if sweep.sample}, names, start
        )
        moving = moving_tracks(
            (track, keyframe.time * 1e-6, box.T_frame_box[:3, 3])
            for keyframe in keyframes
            for track, box in keyframe.boxes.items()
        )
        return cls(
            scene["name"],
            load_sensor("hdl32e"),
            sweeps,
            keyframes,
            dict(enumerate(["none", *names])),
            moving,
        )

    @property
    def name(self) -> str:
        """Format and scene, such as ``nuscenes_scene-0061``."""
        return f"nuscenes_{self.scene}"

    @property
    def has_labels(self) -> bool:
        """Whether there are boxes; the test split has none."""
        return any(keyframe.boxes for keyframe in self.keyframes)

    @property
    def facts(self) -> dict[str, str]:
        """Number of keyframes, and number of objects with boxes."""
        count = {"keyframes": f"{sum(bool(sweep.sample) for sweep in self.sweeps):,}"}
        return count | track_facts(
            {track for keyframe in self.keyframes for track in keyframe.boxes}, self.moving
        )

    def __len__(self) -> int:
        return len(self.sweeps)

    def attributes(self, position: int) -> Attributes:
        """Intensity and ring."""
        return velodyne_attributes(read_velodyne(self.sweeps[position].path, 5))

    def __getitem__(self, position: int) -> Scan:
        sweep = self.sweeps[position]
        in_ego = geometry.apply(sweep.T_ego_sensor, read_velodyne(sweep.path, 5)[:, :3])
        points = geometry.apply(sweep.T_world_ego, in_ego)
        truth = None
        if self.has_labels:
            boxes = boxes_at(self.keyframes, sweep.time)
            annotated = ~_on_ego(in_ego) if boxes is not None else np.zeros(len(points), np.bool_)
            truth = truth_from_boxes(points, boxes or [], self.moving, annotated)
        return Scan(
            index=position % len(self),
            points=points.astype(np.float32),
            T_world_sensor=geometry.compose(sweep.T_world_ego, sweep.T_ego_sensor),
            stamp_ns=sweep.time * 1000,
            **scan_fields(truth, self.class_names),
        )


def boxes_at(keyframes: list[Keyframe], time: int) -> list[OrientedBox] | None:
    """Interpolate the boxes at a time in microseconds.

    None before the first keyframe and after the last.
    """
    after = next((k for k, keyframe in enumerate(keyframes) if keyframe.time >= time), None)
    if after is None or (after == 0 and keyframes[0].time > time):
        return None
    if keyframes[after].time == time:
        return list(keyframes[after].boxes.values())
    before = after - 1
    weight = (time - keyframes[before].time) / (keyframes[after].time - keyframes[before].time)
    first = keyframes[before].boxes
    second = keyframes[after].boxes
    boxes = [
        _interpolate(first[track], second[track], weight) for track in first.keys() & second.keys()
    ]
    # Extrapolate boxes that only one of the two keyframes has, from this keyframe and the one
    # beyond it.
    for here, beyond, step in ((before, before - 1, weight), (after, after + 1, 1 - weight)):
        for track in keyframes[here].boxes.keys() - keyframes[before + after - here].boxes.keys():
            box = keyframes[here].boxes[track]
            other = keyframes[beyond].boxes.get(track, box) if 0 <= beyond < len(keyframes) else box
            boxes.append(replace(_interpolate(box, other, -step), extrapolated=True))
    return sorted(boxes, key=lambda box: box.track)


def _interpolate(a: OrientedBox, b: OrientedBox, weight: float) -> OrientedBox:
    """A box between ``a`` (weight 0) and ``b`` (weight 1).

    Outside this range only the position is extrapolated.
    """
    T = np.eye(4)
    T[:3, 3] = (1 - weight) * a.T_frame_box[:3, 3] + weight * b.T_frame_box[:3, 3]
    p = geometry.quaternion(a.T_frame_box[:3, :3])
    q = geometry.quaternion(b.T_frame_box[:3, :3])
    rotation_weight = min(max(weight, 0.0), 1.0) * (1 if (p * q).sum() >= 0 else -1)
    T[:3, :3] = geometry.matrix((1 - abs(rotation_weight)) * p + rotation_weight * q)
    return replace(a, T_frame_box=T)


def _on_ego(in_ego: F64) -> Bool:
    """Mask of (N, 3) points in the ego frame that lie on the recording car."""
    (back, front), (right, left) = EGO_EXTENT
    x = in_ego[:, 0]
    y = in_ego[:, 1]
    on_ego: Bool = (x > back) & (x < front) & (y > right) & (y < left)
    return on_ego


def _versions(path: Path) -> tuple[list[Path], str | None]:
    """The folders of tables that a path refers to, and the scene if the path names one."""
    candidates: list[tuple[Path, str | None]] = [(path, None)]
    if not path.exists():  # otherwise any folder next to the tables would count as a scene
        candidates.append((path.parent, path.name))
    for root, scene in candidates:
        if (root / "scene.json").is_file() and has_files(root.parent, "samples"):
            return [root], scene
        if found := sorted(file.parent for file in root.glob("v1.0-*/scene.json")):
            return found, scene
    return [], None


def _scene(path: Path) -> tuple[Path, Record]:
    """The folder of tables and the record of the scene that a path refers to."""
    versions, name = _versions(path)
    scenes: dict[str, tuple[Path, Record]] = {}
    for tables in versions:
        for row in _rows(tables, "scene", "name"):
            scenes.setdefault(row["name"], (tables, row))
    if name is None:
        return only(path, "scenes", scenes)
    if name not in scenes:
        available = ", ".join(list(scenes)[:10])
        raise DataError(
            path.parent, f"has no scene {name}", hint=f"Give one of its scenes: {available}"
        )
    return scenes[name]


def _rows(tables: Path, table: str, *keys: str) -> Iterator[Record]:
    """The records of a table.

    DataError if one lacks the token or a key, or has a value of another type.
    """
    path = tables / f"{table}.json"
    for number, row in enumerate(read_records(path)):
        for key in ("token", *keys):
            if key not in row:
                raise DataError(path, f"key {key} is missing", at=f"record {number}", hint=_HINT)
            type_, name = _TYPES.get(key, (str, "text"))
            if type(row[key]) is not type_:
                raise DataError(path, f"{key} is not {name}", at=f"record {number}", hint=_HINT)
            if type_ is int and abs(row[key]) >= _LATEST:
                problem = f"{key} = {str(row[key])[:30]} is not a time in microseconds since 1970"
                raise DataError(path, problem, at=f"record {number}", hint=_HINT)
        yield row


def _transform(tables: Path, table: str, row: Record) -> F64:
    """(4, 4) float64, metres: a record's translation and rotation."""
    try:
        T = geometry.pose(row["translation"], row["rotation"])
        if np.abs(T[:3, 3]).max() >= _FARTHEST:
            raise ValueError("too far")
    except (ValueError, TypeError, OverflowError):
        at = f"token {row['token']}"
        raise DataError(
            tables / f"{table}.json", "no valid translation and rotation", at=at, hint=_HINT
        ) from None
    return T


def _sweeps(tables: Path, samples: set[str]) -> list[Sweep]:
    """All sweeps of a scene, in order of time."""
    pose = ("translation", "rotation")
    channels = {
        row["token"] for row in _rows(tables, "sensor", "channel") if row["channel"] == CHANNEL
    }
    mounts = {
        row["token"]: _transform(tables, "calibrated_sensor", row)
        for row in _rows(tables, "calibrated_sensor", "sensor_token", *pose)
        if row["sensor_token"] in channels
    }
    keys = (
        "sample_token",
        "ego_pose_token",
        "calibrated_sensor_token",
        "filename",
        "timestamp",
        "is_key_frame",
    )
    rows = [
        row
        for row in _rows(tables, "sample_data", *keys)
        if row["sample_token"] in samples and row["calibrated_sensor_token"] in mounts
    ]
    if not (tables.parent / "sweeps").is_dir():
        rows = [row for row in rows if row["is_key_frame"]]
    if not rows:
        raise DataError(
            tables / "sample_data.json", f"has no {CHANNEL} data for this scene", hint=_HINT
        )
    pose_tokens = {row["ego_pose_token"] for row in rows}
    ego_poses = {
        row["token"]: _transform(tables, "ego_pose", row)
        for row in _rows(tables, "ego_pose", *pose)
        if row["token"] in pose_tokens
    }
    sweeps = []
    for row in sorted(rows, key=lambda row: row["timestamp"]):
        if row["ego_pose_token"] not in ego_poses:
            raise DataError(
                tables / "ego_pose.json", f"pose {row['ego_pose_token']} is missing", hint=_HINT
            )
        path = tables.parent / row["filename"]
        if not is_file(path):
            raise DataError(
                path,
                "does not exist",
                hint="Download it, or remove the folder sweeps to use keyframes only",
            )
        mount = mounts[row["calibrated_sensor_token"]]
        sample = row["sample_token"] if row["is_key_frame"] else ""
        sweeps.append(
            Sweep(
                path, int(row["timestamp"]), ego_poses[row["ego_pose_token"]].copy(), mount, sample
            )
        )
    return sweeps


def _keyframes(tables: Path, times: dict[str, int], names: list[str], start: F64) -> list[Keyframe]:
    """The keyframes in order of time.

    Args:
        tables: folder of tables.
        times: time of each sample in microseconds, by its token.
        names: category names; the class id of a box is the position of its category in it, plus 1.
        start: (3,) float64, metres: origin of the world frame in the map.
    """
    pose = ("translation", "rotation", "size")
    rows = [
        row
        for row in _rows(tables, "sample_annotation", "sample_token", "instance_token", *pose)
        if row["sample_token"] in times
    ]
    numbers = {
        token: n for n, token in enumerate(sorted({row["instance_token"] for row in rows}), 1)
    }
    categories = {
        row["token"]: names.index(row["name"]) + 1 for row in _rows(tables, "category", "name")
    }
    class_ids = {
        row["token"]: categories.get(row["category_token"], 0)
        for row in _rows(tables, "instance", "category_token")
        if row["token"] in numbers
    }
    keyframes = {sample: Keyframe(time, {}) for sample, time in times.items()}
    for row in rows:
        T_world_box = _transform(tables, "sample_annotation", row)
        track = numbers[row["instance_token"]]
        try:
            width, length, height = (float(x) for x in row["size"])
            if not (np.abs([width, length, height]) < _FARTHEST).all():
                raise ValueError("not finite, or too large")
        except (ValueError, TypeError, OverflowError):
            at = f"token {row['token']}"
            raise DataError(
                tables / "sample_annotation.json", "no valid size", at=at, hint=_HINT
            ) from None
        # from the centre of the box to its bottom face
        T_world_box[:3, 3] -= start + T_world_box[:3, 2] * height / 2
        box = OrientedBox(
            track, class_ids.get(row["instance_token"], 0), T_world_box, (length, width, height)
        )
        keyframes[row["sample_token"]].boxes[track] = box
    return sorted(keyframes.values(), key=lambda keyframe: keyframe.time)
