"""The layout of the public benchmark (Zhang et al. 2023): scans in the world frame, their poses in VIEWPOINT."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from dynaviz.arrays import F64
from dynaviz.datasets.files import holds, numbered
from dynaviz.datasets.truth import GroundTruth
from dynaviz.errors import DataError
from dynaviz.io.pcd import Pcd, read_header, read_pcd
from dynaviz.io.poses import find_poses
from dynaviz.scan import Scan
from dynaviz.sensors import Sensor, load_sensor
from dynaviz.spatial import geometry

_POSE = (
    "The points are in the world frame, and VIEWPOINT tx ty tz qw qx qy qz is the sensor's pose in it: "
    "its position in metres is where the rays start, its quaternion has length 1"
)


@dataclass(frozen=True)
class BenchmarkSequence:
    """A folder with ``pcd/*.pcd`` and, where there is ground truth, ``gt_cloud.pcd``.

    ``sequence.toml`` may tell ``name``, ``sensor``, ``rate`` (sweeps per second, from which the stamps follow), and a
    table ``classes`` with the name of each class number.
    Points are passed on as they are, with duplicates and NaN. Where scans have a field ``lidar``, rays start at that
    lidar's mount on the sensor.
    """

    layout: ClassVar[str] = "pcd/*.pcd in the world frame with the sensor's pose in VIEWPOINT, gt_cloud.pcd"

    name: str
    sensor: Sensor
    rate: float | None
    scans: dict[int, Path]
    truth: GroundTruth | None
    class_names: Mapping[int, str] = field(default_factory=dict)
    unmatched: dict[int, int] = field(default_factory=dict, compare=False)

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path holds ``pcd/*.pcd``, or is that folder of scans itself, without a file of poses."""
        itself = any(file.stem.isdigit() for file in path.glob("*[0-9].pcd"))
        return holds(path / "pcd", "*.pcd") or (itself and find_poses(path) is None)

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a sequence; the header of every scan is read.

        Raises:
            DataError: for a scan that is damaged or has no pose, and for ground truth that is none.
        """
        folder = path / "pcd" if (path / "pcd").is_dir() else path
        root = folder.parent if folder.name == "pcd" else folder
        scans = numbered(folder, ".pcd")
        files = list(scans.values())
        counts = [_checked(file) for file in files]
        facts = _facts(root / "sequence.toml")
        sensor = load_sensor(facts["sensor"]) if "sensor" in facts else Sensor()
        gt = root / "gt_cloud.pcd"
        truth = GroundTruth(gt, counts, lambda position: read_pcd(files[position]).xyz) if gt.exists() else None
        return cls(facts.get("name", root.name), sensor, facts.get("rate"), scans, truth, facts["classes"])

    @property
    def has_labels(self) -> bool:
        """Whether there is a ``gt_cloud.pcd``."""
        return self.truth is not None

    @property
    def facts(self) -> dict[str, str]:
        """What is worth telling of the ground truth; the number of unmatched points counts the frames read so far."""
        if self.truth is None:
            return {}
        how = "rows of gt_cloud.pcd" if self.truth.by_index else "coordinates in gt_cloud.pcd"
        return {"ground truth by": how, "points without partner": f"{sum(self.unmatched.values()):,}"}

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, position: int) -> Scan:
        index = list(self.scans)[position]
        pcd = read_pcd(self.scans[index])
        T_world_sensor = _pose(pcd)
        truth = self.truth.of(position % len(self), pcd.xyz) if self.truth else None
        if truth:
            self.unmatched[index] = truth.unmatched
        return Scan(
            index=index,
            points=pcd.xyz,
            T_world_sensor=T_world_sensor,
            stamp_ns=round(index / self.rate * 1e9) if self.rate else None,
            labels=truth.labels if truth else None,
            classes=truth.classes if truth else None,
            instances=truth.instances if truth else None,
            origins=self._origins(pcd, T_world_sensor),
            class_names=self.class_names,
        )

    def _origins(self, pcd: Pcd, T_world_sensor: F64) -> F64:
        """(1, 3) or (N, 3) float64, metres, world frame: where the rays start."""
        if "lidar" not in pcd or not self.sensor.mounts:
            return T_world_sensor[None, :3, 3]
        lidar = pcd["lidar"].astype(np.int64)
        if len(lidar) and not 0 <= lidar.min() <= lidar.max() < len(self.sensor.mounts):
            problem = f"has a point of lidar {lidar.max()}, but {self.sensor.title} has {len(self.sensor.mounts)}"
            raise DataError(pcd.path, problem, hint="Count them from 0, or name another sensor in sequence.toml")
        mounts = np.array([mount[:3] for mount in self.sensor.mounts], np.float64)
        return geometry.apply(T_world_sensor, mounts)[lidar]


def _checked(path: Path) -> int:
    """Number of points of a scan that can be read and has a pose, by its header and size."""
    header = read_header(path)
    pcd = Pcd(path, header, np.empty(0, header.row))
    _pose(pcd)
    _ = pcd.xyz
    needed = header.offset + header.points * header.row.itemsize
    if header.data == "binary" and path.stat().st_size < needed:
        problem = f"is too short: {header.points} points need {needed} bytes, it has {path.stat().st_size}"
        raise DataError(path, problem, at=f"byte {path.stat().st_size}", hint="Write or copy the file again")
    return header.points


def _pose(pcd: Pcd) -> F64:
    T_world_sensor = pcd.T_world_sensor
    if T_world_sensor is None:
        raise DataError(pcd.path, "has no VIEWPOINT, so nobody knows where its rays start", hint=_POSE)
    return T_world_sensor


def _facts(path: Path) -> Mapping[str, Any]:
    """What ``sequence.toml`` tells, if it is there."""
    if not path.exists():
        return {"classes": {}}
    hint = 'It may hold name = "...", sensor = "..." (dynaviz list sensors) and rate = 10.0'
    try:
        facts = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(path, f"cannot be read ({error})", hint=hint) from None
    kinds: dict[str, Any] = {"name": str, "sensor": str, "rate": (int, float)}
    for key, kind in kinds.items():
        if key in facts and not isinstance(facts[key], kind):
            raise DataError(path, f"has {key} = {facts[key]!r}", hint=hint)
    if not facts.get("rate", 1.0) > 0:
        raise DataError(path, f"has rate = {facts['rate']}", hint=hint)
    if "name" in facts and facts["name"] != (Path(facts["name"]).name or None):
        raise DataError(path, f"has name = {facts['name']!r}, which no folder can have", hint=hint)
    try:
        classes = {int(number): str(name) for number, name in facts.get("classes", {}).items()}
    except (AttributeError, ValueError):
        raise DataError(
            path, "has classes that are no table of numbers and names", hint='[classes] 10 = "car"'
        ) from None
    return {**facts, "classes": classes}
