"""PandaSet (Xiao et al. 2021): a Pandar64 and a forward PandarGT, boxes, classes of points.

Layout, units and frames: documentation of scaleapi/pandaset-devkit.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from dynaviz.arrays import F64, I64, U16
from dynaviz.contracts.attributes import Attributes
from dynaviz.contracts.reader import Reader
from dynaviz.contracts.scan import Label, Scan
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.errors import DataError
from dynaviz.io.pickled_table import numbers, read_pickled_table, texts
from dynaviz.io.plain_json import read_json
from dynaviz.sources.datasets.box_labels import (
    OrientedBox,
    moving_tracks,
    track_facts,
    truth_from_boxes,
)
from dynaviz.sources.datasets.files import has_files, numbered_files, only
from dynaviz.sources.datasets.truth import Truth, scan_fields
from dynaviz.spatial import geometry

CATEGORIES = (  # Scan.classes are positions in this tuple, the numbers of the data set
    "none", "smoke", "exhaust", "spray or rain", "reflection", "vegetation", "ground", "road",
    "lane line marking", "stop line marking", "other road marking", "sidewalk", "driveway", "car",
    "pickup truck", "medium-sized truck", "semi-truck", "towed object", "motorcycle",
    "other vehicle - construction vehicle", "other vehicle - uncommon", "other vehicle - pedicab",
    "emergency vehicle", "bus", "personal mobility device", "motorized scooter", "bicycle", "train",
    "trolley", "tram / subway", "pedestrian", "pedestrian with object", "animals - bird",
    "animals - other", "pylons", "road barriers", "signs", "cones", "construction signs",
    "temporary construction barriers", "rolling containers", "building", "other static object",
)  # fmt: skip
CLASS_NAMES = dict(enumerate(CATEGORIES))
NO_SURFACE = (1, 2, 3, 4)  # smoke, exhaust, spray and reflections are neither map nor objects
BOTH = -1  # number of the lidar of a box that holds for both
T_PANDAR_GT = np.array([-0.000451117754, -0.605646431446, -0.301525235176])
"""(3,) metres, frame of the Pandar64: position of the PandarGT (the devkit's calibration)."""
STEP = 0.01  # seconds; rays within a step share an origin, so that methods can group them
LONGEST = 10.0  # seconds between a point and its sweep
FARTHEST = 1e9  # metres, of positions and sizes
SUFFIXES = (".pkl.gz", ".pkl")
_POSITION = ("position.x", "position.y", "position.z")
_SIZE = ("dimensions.y", "dimensions.x", "dimensions.z")  # length, width, height
_HINT = "Copy the file again"


@dataclass(frozen=True, slots=True, eq=False)
class SeenBox:
    """A box, and the lidar whose points it holds for: 0, 1, or ``BOTH``."""

    box: OrientedBox
    lidar: int


@dataclass(frozen=True)
class PandaSetSequence(Reader):
    """A sequence of PandaSet. The world frame has the axes of the data set, z up, and its origin at
    the sensor position of the first sweep.

    Points of a moving box are dynamic. A moving object that both lidars see has two boxes, each for
    the points of one lidar; they are one object. Points in smoke, spray and reflections are
    unlabelled where the data set names the class of points, and so are sweeps without boxes. Rays
    start where their lidar was when it measured the point.
    """

    layout: ClassVar[str] = (
        "NNN/{lidar/{*.pkl.gz, poses.json, timestamps.json}, annotations/{cuboids, semseg}}"
    )

    folder: Path
    sensor: Sensor
    scans: dict[int, Path]
    start: F64
    poses: F64
    times: F64
    boxes: dict[int, list[SeenBox]] | None
    classes: dict[int, Path]
    moving: frozenset[int]

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a sequence, its folder ``lidar``, or the parent of sequences."""
        return bool(_sequences(path))

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a sequence.

        Raises:
            DataError: if sweeps, poses or times are missing or corrupt, or there are several
                sequences.
        """
        found = _sequences(path)
        folder = only(path, "sequences", {folder.name: folder for folder in found})
        scans = _numbered(folder / "lidar")
        poses = _poses(folder / "lidar/poses.json")
        times = _times(folder / "lidar/timestamps.json")
        for file, rows in (("poses.json", poses), ("timestamps.json", times)):
            if len(rows) <= max(scans):
                problem = f"has only {len(rows)} entries, but there is a sweep {max(scans):02d}"
                raise DataError(folder / "lidar" / file, problem, hint=_HINT)
        start = poses[min(scans), :3, 3].copy()
        poses[:, :3, 3] -= start
        boxes = None
        if cuboids := _numbered(folder / "annotations/cuboids", required=False):
            boxes = _boxes(cuboids, start)
        moving = moving_tracks(
            (seen.box.track, float(times[frame]), seen.box.T_frame_box[:3, 3])
            for frame, several in (boxes or {}).items()
            if frame < len(times)
            for seen in several
        )
        classes = _numbered(folder / "annotations/semseg", required=False)
        sensor = load_sensor("pandar64")
        return cls(folder, sensor, scans, start, poses, times, boxes, classes, moving)

    @property
    def name(self) -> str:
        """Format and sequence number, such as ``pandaset_002``."""
        return f"pandaset_{self.folder.name}"

    @property
    def has_labels(self) -> bool:
        """Whether there are boxes."""
        return self.boxes is not None

    @property
    def facts(self) -> dict[str, str]:
        """The lidars, the number of objects with boxes, and whether points have classes."""
        tracks = {seen.box.track for several in (self.boxes or {}).values() for seen in several}
        facts = {"lidars": "Pandar64 and PandarGT (forward), in one scan"}
        facts |= track_facts(tracks, self.moving)
        return facts | {"classes of points": f"in {len(self.classes)} sweeps"}

    def __len__(self) -> int:
        return len(self.scans)

    def scan_file(self, index: int) -> Path | None:
        """The file of the frame with this number."""
        return self.scans.get(index)

    def attributes(self, position: int) -> Attributes:
        """Intensity, and the number of the lidar: 0 Pandar64, 1 PandarGT."""
        path = list(self.scans.values())[position]
        columns = numbers(path, read_pickled_table(path), ("i", "d"))
        return {
            "intensity": columns["i"].astype(np.float32),
            "lidar": columns["d"].astype(np.uint8),
        }

    def __getitem__(self, position: int) -> Scan:
        index = list(self.scans)[position]
        path = self.scans[index]
        columns = numbers(path, read_pickled_table(path), ("x", "y", "z", "t", "d"))
        xyz = np.column_stack([columns[axis] for axis in "xyz"]) - self.start
        lidar = columns["d"].astype(np.int64)
        if not np.isin(lidar, (0, 1)).all():
            raise DataError(path, "column d holds a lidar other than 0 and 1", hint=_HINT)
        times = columns["t"] - self.times[index]
        if len(times) and np.abs(times).max() > LONGEST:
            problem = f"column t is up to {np.abs(times).max():.3g} s from the time of the sweep"
            raise DataError(path, problem, hint=_HINT)
        truth = None if self.boxes is None else self._truth(index, xyz, lidar)
        return Scan(
            index=index,
            points=xyz.astype(np.float32),
            T_world_sensor=self.poses[index],
            stamp_ns=round(self.times[index] * 1e9),
            origins=self._origins(index, times, lidar),
            times=times.astype(np.float32),
            **scan_fields(truth, CLASS_NAMES),
        )

    def _truth(self, index: int, xyz: F64, lidar: I64) -> Truth:
        """Ground truth of (N, 3) points in the world frame."""
        several = (self.boxes or {}).get(index)
        n = len(xyz)
        labels = np.full(n, Label.UNLABELLED, np.uint8)
        classes = np.zeros(n, np.uint16)
        instances = np.zeros(n, np.int32)
        for number in (0, 1):
            rows = np.flatnonzero(lidar == number)
            boxes = [seen.box for seen in several or () if seen.lidar in (BOTH, number)]
            part = truth_from_boxes(xyz[rows], boxes, self.moving)
            if several is not None:
                labels[rows] = part.labels
            if part.classes is not None and part.instances is not None:  # boxes state both
                classes[rows] = part.classes
                instances[rows] = part.instances
        if index in self.classes:
            classes = _classes(self.classes[index], n)
            labels[np.isin(classes, NO_SURFACE)] = Label.UNLABELLED
        return Truth(labels, classes, instances)

    def _origins(self, index: int, times: F64, lidar: I64) -> F64:
        """(N, 3) float64, metres, world frame: position of each point's lidar when it measured."""
        if not len(times):
            return np.empty((0, 3))
        step = np.floor(times / STEP).astype(np.int64)
        middles = (np.arange(step.min(), step.max() + 1) + 0.5) * STEP + self.times[index]
        origins = np.empty((len(times), 3))
        for number, mount in enumerate((np.zeros(3), T_PANDAR_GT)):
            path = (self.poses[:, :3, :3] * mount).sum(-1) + self.poses[:, :3, 3]
            rows = lidar == number
            origins[rows] = _along(self.times, path, middles)[step[rows] - step.min()]
        return origins


def _along(times: F64, path: F64, at: F64) -> F64:
    """(M, 3) positions at times, linear between (P,) times and beyond them."""
    if len(times) == 1:
        return np.repeat(path, len(at), axis=0)
    after = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    weight = (at - times[after - 1]) / (times[after] - times[after - 1])
    positions: F64 = path[after - 1] + weight[:, None] * (path[after] - path[after - 1])
    return positions


def _sequences(path: Path) -> list[Path]:
    """The sequences that a path may refer to."""
    for folder in (path, path.parent if path.name == "lidar" else path):
        if _is_sequence(folder):
            return [folder]
    return sorted(folder for folder in path.glob("*") if _is_sequence(folder))


def _is_sequence(folder: Path) -> bool:
    lidar = folder / "lidar"
    return (lidar / "poses.json").is_file() and any(
        has_files(lidar, f"*{suffix}") for suffix in SUFFIXES
    )


def _numbered(folder: Path, required: bool = True) -> dict[int, Path]:
    """The tables of a folder by number; some copies of the data set are not compressed."""
    suffix = next((each for each in SUFFIXES if has_files(folder, f"*{each}")), None)
    if suffix is None and not required:
        return {}
    return numbered_files(folder, suffix or SUFFIXES[0])


def _poses(path: Path) -> F64:
    """(P, 4, 4) float64, metres: pose of the Pandar64 in each sweep."""
    poses = []
    for row, entry in enumerate(_list(path)):
        try:
            place = [float(entry["position"][axis]) for axis in "xyz"]
            turn = [float(entry["heading"][axis]) for axis in "wxyz"]
            pose = geometry.pose(place, turn)
            if np.abs(pose[:3, 3]).max() >= FARTHEST:
                raise ValueError("too far")
        except (ValueError, TypeError, KeyError, IndexError, OverflowError):
            at = f"entry {row}"
            raise DataError(path, "no valid position and heading", at=at, hint=_HINT) from None
        poses.append(pose)
    return np.array(poses).reshape(-1, 4, 4)


def _times(path: Path) -> F64:
    """(P,) float64, seconds since 1970: time of each sweep, increasing."""
    try:
        times = np.array([float(entry) for entry in _list(path)])
    except (ValueError, TypeError, OverflowError):
        raise DataError(path, "contains something other than times", hint=_HINT) from None
    if not (np.abs(times) < 1e10).all() or not (np.diff(times) > 0).all():
        raise DataError(path, "its times do not increase, or are not seconds", hint=_HINT)
    return times


def _list(path: Path) -> list[Any]:
    content = read_json(path, _HINT)
    if not isinstance(content, list):
        raise DataError(path, "is not a list", hint=_HINT)
    return content


def _boxes(files: dict[int, Path], start: F64) -> dict[int, list[SeenBox]]:
    """The boxes of each sweep. Boxes of one object, seen by both lidars, have one number."""
    siblings: dict[str, str] = {}
    rows: dict[int, list[tuple[str, str, float, F64, F64, int]]] = {}
    for frame, path in files.items():
        table = read_pickled_table(path)
        values = numbers(path, table, ("yaw", *_POSITION, *_SIZE))
        names = texts(path, table, "uuid")
        labels = texts(path, table, "label")
        lidars = [BOTH] * len(names)
        if "cuboids.sensor_id" in table:
            seen = numbers(path, table, ("cuboids.sensor_id",))["cuboids.sensor_id"]
            lidars = [int(number) if number in (0, 1) else BOTH for number in seen]
        if "cuboids.sibling_id" in table:
            others = texts(path, table, "cuboids.sibling_id")
            siblings |= {a: b for a, b in zip(names, others, strict=True) if b not in _NOBODY}
        places = np.column_stack([values[name] for name in _POSITION]) - start
        sizes = np.column_stack([values[name] for name in _SIZE])
        if not (np.abs(places) < FARTHEST).all() or not (np.abs(sizes) < FARTHEST).all():
            raise DataError(path, "a box is too far, or too large", hint=_HINT)
        rows[frame] = list(
            zip(names, labels, values["yaw"].tolist(), places, sizes, lidars, strict=True)
        )
    names = sorted({row[0] for several in rows.values() for row in several})
    objects = sorted({min(name, siblings.get(name, name)) for name in names})
    numbers_of = {name: objects.index(min(name, siblings.get(name, name))) + 1 for name in names}
    return {
        frame: [_box(numbers_of[row[0]], *row[1:]) for row in several]
        for frame, several in rows.items()
    }


_NOBODY = ("", "-", "nan", "None")


def _box(track: int, label: str, yaw: float, centre: F64, size: F64, lidar: int) -> SeenBox:
    """A box, whose length points along y of the world at a yaw of 0."""
    T_world_box = np.eye(4)
    T_world_box[:2, 0] = -np.sin(yaw), np.cos(yaw)
    T_world_box[:2, 1] = -np.cos(yaw), -np.sin(yaw)
    length, width, height = size.tolist()
    T_world_box[:3, 3] = centre - np.array([0, 0, height / 2])
    name = label.lower()
    class_id = CATEGORIES.index(name) if name in CATEGORIES else 0
    return SeenBox(OrientedBox(track, class_id, T_world_box, (length, width, height)), lidar)


def _classes(path: Path, points: int) -> U16:
    """(points,) uint16: class of each point of a sweep."""
    column = numbers(path, read_pickled_table(path), ("class",))["class"]
    if len(column) != points:
        raise DataError(path, f"has {len(column)} classes for {points} points", hint=_HINT)
    if len(column) and not 0 <= column.min() <= column.max() < len(CATEGORIES):
        raise DataError(path, f"class {column.max():g} is unknown", hint=_HINT)
    return column.astype(np.uint16)
