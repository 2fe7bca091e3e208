"""nuScenes (Caesar et al. 2020): HDL-32E sweeps at 20 Hz, boxes with track ids at 2 Hz."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from dynaviz.arrays import F64, Bool
from dynaviz.datasets.box_labels import OrientedBox, boxed_truth, moving_tracks, track_facts
from dynaviz.datasets.files import holds, only
from dynaviz.datasets.truth import fields_of
from dynaviz.errors import DataError
from dynaviz.io.records import read_records
from dynaviz.io.velodyne import read_velodyne
from dynaviz.scan import Scan
from dynaviz.sensors import Sensor, load_sensor
from dynaviz.spatial import geometry

CHANNEL = "LIDAR_TOP"
CAR = ((-0.8, 3.6), (-1.1, 1.1))  # metres along and across, in the car's frame: nobody drew a box around it
_HINT = "Copy the tables again"

Record = dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """A sweep of the lidar.

    Attributes:
        path: its file.
        time: microseconds.
        T_world_ego, T_ego_sensor: (4, 4) float64, metres.
        sample: token of its sample where it is a keyframe, else empty.
    """

    path: Path
    time: int
    T_world_ego: F64
    T_ego_sensor: F64
    sample: str


@dataclass(frozen=True, slots=True, eq=False)
class AnnotatedBox:
    """The boxes of a keyframe by their tracks, in the world frame, and its time in microseconds."""

    time: int
    boxes: dict[int, OrientedBox]


@dataclass(frozen=True)
class NuScenesSequence:
    """A scene of nuScenes: keyframes and the sweeps between them.

    A scene is chosen by its name behind the path, as in ``nuscenes/scene-0061``. The world has the axes of the map,
    z up, and its origin where the sensor was at the first sweep.

    Boxes are drawn in keyframes; between two of them a box moves evenly from one place to the other. Where only one of
    the two has an object, it is thought to go on as before, and what a moving one may hold is unlabelled. So are points
    of the recording car, and all points before the first and after the last keyframe.
    Where the folder ``sweeps`` is missing, there are keyframes only.
    """

    layout: ClassVar[str] = "{v1.0-mini/*.json, samples/LIDAR_TOP, sweeps/LIDAR_TOP} and a scene's name behind it"

    scene: str
    sensor: Sensor
    sweeps: list[Sweep]
    drawn: list[AnnotatedBox]
    class_names: dict[int, str]
    moving: frozenset[int]

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path has tables ``v1.0-*``, is such a folder of tables, or is one of both with a scene's name."""
        return bool(_versions(path)[0])

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a scene; the tables are read through once.

        Raises:
            DataError: where tables or sweeps are missing or damaged, or there are several scenes to choose from.
        """
        tables, scene = _scene(path)
        samples = {
            row["token"] for row in _rows(tables, "sample", "scene_token") if row["scene_token"] == scene["token"]
        }
        sweeps = _sweeps(tables, samples)
        start = geometry.compose(sweeps[0].T_world_ego, sweeps[0].T_ego_sensor)[:3, 3].copy()
        for sweep in sweeps:
            sweep.T_world_ego[:3, 3] -= start
        names = sorted({row["name"] for row in _rows(tables, "category", "name")})
        drawn = _drawn(tables, {sweep.sample: sweep.time for sweep in sweeps if sweep.sample}, names, start)
        moving = moving_tracks(
            (track, frame.time * 1e-6, box.T_frame_box[:3, 3]) for frame in drawn for track, box in frame.boxes.items()
        )
        return cls(scene["name"], load_sensor("hdl32e"), sweeps, drawn, dict(enumerate(["none", *names])), moving)

    @property
    def name(self) -> str:
        """As in ``nuscenes_scene-0061``."""
        return f"nuscenes_{self.scene}"

    @property
    def has_labels(self) -> bool:
        """Whether there are boxes; there are none in the test split."""
        return any(frame.boxes for frame in self.drawn)

    @property
    def facts(self) -> dict[str, str]:
        """How many sweeps are keyframes, and how many objects have boxes."""
        keys = {"keyframes": f"{sum(bool(sweep.sample) for sweep in self.sweeps):,}"}
        return keys | track_facts({track for frame in self.drawn for track in frame.boxes}, self.moving)

    def __len__(self) -> int:
        return len(self.sweeps)

    def __getitem__(self, position: int) -> Scan:
        sweep = self.sweeps[position]
        in_ego = geometry.apply(sweep.T_ego_sensor, read_velodyne(sweep.path, 5)[:, :3])
        points = geometry.apply(sweep.T_world_ego, in_ego)
        truth = None
        if self.has_labels:
            boxes = boxes_at(self.drawn, sweep.time)
            known = ~_own(in_ego) if boxes is not None else np.zeros(len(points), np.bool_)
            truth = boxed_truth(points, boxes or [], self.moving, known)
        return Scan(
            index=position % len(self),
            points=points.astype(np.float32),
            T_world_sensor=geometry.compose(sweep.T_world_ego, sweep.T_ego_sensor),
            stamp_ns=sweep.time * 1000,
            **fields_of(truth, self.class_names),
        )


def boxes_at(drawn: list[AnnotatedBox], time: int) -> list[OrientedBox] | None:
    """The boxes at a time, in microseconds; None before the first keyframe and after the last."""
    after = next((k for k, frame in enumerate(drawn) if frame.time >= time), None)
    if after is None or (after == 0 and drawn[0].time > time):
        return None
    if drawn[after].time == time:
        return list(drawn[after].boxes.values())
    before = after - 1
    share = (time - drawn[before].time) / (drawn[after].time - drawn[before].time)
    first, second = drawn[before].boxes, drawn[after].boxes
    boxes = [_between(first[track], second[track], share) for track in first.keys() & second.keys()]
    for here, beyond, step in ((before, before - 1, share), (after, after + 1, 1 - share)):
        for track in drawn[here].boxes.keys() - drawn[before + after - here].boxes.keys():
            box = drawn[here].boxes[track]
            known = drawn[beyond].boxes.get(track, box) if 0 <= beyond < len(drawn) else box
            boxes.append(replace(_between(box, known, -step), guessed=True))
    return sorted(boxes, key=lambda box: box.track)


def _between(a: OrientedBox, b: OrientedBox, share: float) -> OrientedBox:
    """A box on its way from one place (share 0) to another (1), or before or beyond them, where it does not turn."""
    T = np.eye(4)
    T[:3, 3] = (1 - share) * a.T_frame_box[:3, 3] + share * b.T_frame_box[:3, 3]
    p, q = geometry.quaternion(a.T_frame_box[:3, :3]), geometry.quaternion(b.T_frame_box[:3, :3])
    turned = min(max(share, 0.0), 1.0) * (1 if (p * q).sum() >= 0 else -1)
    T[:3, :3] = geometry.matrix((1 - abs(turned)) * p + turned * q)
    return replace(a, T_frame_box=T)


def _own(in_ego: F64) -> Bool:
    """Which (N, 3) points in the car's frame are of the car itself."""
    (back, front), (right, left) = CAR
    x, y = in_ego[:, 0], in_ego[:, 1]
    own: Bool = (x > back) & (x < front) & (y > right) & (y < left)
    return own


def _versions(path: Path) -> tuple[list[Path], str | None]:
    """The folders of tables that a path means, and the scene where it says which."""
    places: list[tuple[Path, str | None]] = [(path, None)]
    if not path.exists():  # else any folder beside the tables would be a scene
        places.append((path.parent, path.name))
    for root, scene in places:
        if (root / "scene.json").is_file() and holds(root.parent, "samples"):
            return [root], scene
        if found := sorted(file.parent for file in root.glob("v1.0-*/scene.json")):
            return found, scene
    return [], None


def _scene(path: Path) -> tuple[Path, Record]:
    """The folder of tables and the record of the scene that a path means."""
    versions, name = _versions(path)
    scenes: dict[str, tuple[Path, Record]] = {}
    for tables in versions:
        for row in _rows(tables, "scene", "name"):
            scenes.setdefault(row["name"], (tables, row))
    if name is None:
        return only(path, "scenes", scenes)
    if name not in scenes:
        known = ", ".join(list(scenes)[:10])
        raise DataError(path.parent, f"has no scene {name}, but {known}", hint="Give one of the scenes")
    return scenes[name]


def _rows(tables: Path, table: str, *keys: str) -> Iterator[Record]:
    """The records of a table, which have a token and the keys."""
    path = tables / f"{table}.json"
    for number, row in enumerate(read_records(path)):
        for key in ("token", *keys):
            if key not in row:
                raise DataError(path, f"has no {key}", at=f"record {number}", hint=_HINT)
        yield row


def _transform(tables: Path, table: str, row: Record) -> F64:
    """(4, 4) float64, metres: a record's translation and rotation."""
    try:
        T = geometry.pose(row["translation"], row["rotation"])
    except (ValueError, TypeError):
        T = np.full((4, 4), np.nan)
    if not np.isfinite(T).all():
        place = f"token {row['token']}"
        raise DataError(tables / f"{table}.json", "has no translation and rotation", at=place, hint=_HINT)
    return T


def _sweeps(tables: Path, samples: set[str]) -> list[Sweep]:
    """All sweeps of a scene in the order of time."""
    pose = ("translation", "rotation")
    channels = {row["token"] for row in _rows(tables, "sensor", "channel") if row["channel"] == CHANNEL}
    mounts = {
        row["token"]: _transform(tables, "calibrated_sensor", row)
        for row in _rows(tables, "calibrated_sensor", "sensor_token", *pose)
        if row["sensor_token"] in channels
    }
    keys = ("sample_token", "ego_pose_token", "calibrated_sensor_token", "filename", "timestamp", "is_key_frame")
    rows = [
        row
        for row in _rows(tables, "sample_data", *keys)
        if row["sample_token"] in samples and row["calibrated_sensor_token"] in mounts
    ]
    if not (tables.parent / "sweeps").is_dir():
        rows = [row for row in rows if row["is_key_frame"]]
    if not rows:
        raise DataError(tables / "sample_data.json", f"has no {CHANNEL} of this scene", hint=_HINT)
    wanted = {row["ego_pose_token"] for row in rows}
    places = {
        row["token"]: _transform(tables, "ego_pose", row)
        for row in _rows(tables, "ego_pose", *pose)
        if row["token"] in wanted
    }
    sweeps = []
    for row in sorted(rows, key=lambda row: row["timestamp"]):
        if row["ego_pose_token"] not in places:
            raise DataError(tables / "ego_pose.json", f"has no pose {row['ego_pose_token']}", hint=_HINT)
        path = tables.parent / row["filename"]
        if not path.is_file():
            raise DataError(path, "is missing", hint="Download it, or remove the folder sweeps to use keyframes only")
        mount, sample = mounts[row["calibrated_sensor_token"]], row["sample_token"] if row["is_key_frame"] else ""
        sweeps.append(Sweep(path, int(row["timestamp"]), places[row["ego_pose_token"]].copy(), mount, sample))
    return sweeps


def _drawn(tables: Path, times: dict[str, int], names: list[str], start: F64) -> list[AnnotatedBox]:
    """The boxes of each keyframe in the order of time, given the times of samples by their tokens."""
    pose = ("translation", "rotation", "size")
    rows = [
        row
        for row in _rows(tables, "sample_annotation", "sample_token", "instance_token", *pose)
        if row["sample_token"] in times
    ]
    numbers = {token: n for n, token in enumerate(sorted({row["instance_token"] for row in rows}), 1)}
    categories = {row["token"]: names.index(row["name"]) + 1 for row in _rows(tables, "category", "name")}
    kinds = {
        row["token"]: categories.get(row["category_token"], 0)
        for row in _rows(tables, "instance", "category_token")
        if row["token"] in numbers
    }
    drawn = {sample: AnnotatedBox(time, {}) for sample, time in times.items()}
    for row in rows:
        T_world_box, track = _transform(tables, "sample_annotation", row), numbers[row["instance_token"]]
        try:
            width, length, height = (float(x) for x in row["size"])
        except (ValueError, TypeError):
            place = f"token {row['token']}"
            raise DataError(tables / "sample_annotation.json", "has no size", at=place, hint=_HINT) from None
        T_world_box[:3, 3] -= start + T_world_box[:3, 2] * height / 2  # from the middle to the bottom
        box = OrientedBox(track, kinds.get(row["instance_token"], 0), T_world_box, (length, width, height))
        drawn[row["sample_token"]].boxes[track] = box
    return sorted(drawn.values(), key=lambda frame: frame.time)
