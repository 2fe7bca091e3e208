"""The layout of the public benchmark (Zhang et al. 2023).

Scans in the world frame, their poses in VIEWPOINT.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from dynaviz.arrays import F64, single
from dynaviz.contracts.attributes import Attributes, far_origin
from dynaviz.contracts.params import read_toml
from dynaviz.contracts.reader import Reader
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.errors import DataError, NoPoses
from dynaviz.io.fields import columns_of, coordinates, without_axes
from dynaviz.io.pcd import Pcd, read_header, read_pcd
from dynaviz.io.poses import find_poses, pose_candidates
from dynaviz.sources.datasets.files import has_files, numbered_files
from dynaviz.sources.datasets.truth import GroundTruth
from dynaviz.spatial import geometry

_POSE_HINT = (
    "Write points in the world frame and the sensor pose as VIEWPOINT tx ty tz qw qx qy qz, "
    "with the position in metres and a unit quaternion"
)


@dataclass(frozen=True)
class BenchmarkSequence(Reader):
    """A folder with ``pcd/*.pcd`` and, if there is ground truth, ``gt_cloud.pcd``.

    ``sequence.toml`` is optional; it sets ``name``, ``sensor``, ``rate`` (sweeps per second, which
    defines the stamps) and a table ``classes`` with the name of each class number. Points are
    passed on unchanged, with duplicates and NaN. If scans have a field ``lidar``, rays start at the
    mount of that lidar on the sensor.
    """

    layout: ClassVar[str] = (
        "pcd/*.pcd in the world frame with the sensor's pose in VIEWPOINT, gt_cloud.pcd"
    )

    name: str
    sensor: Sensor
    rate: float | None
    scans: dict[int, Path]
    truth: GroundTruth | None
    class_names: Mapping[int, str] = field(default_factory=dict)
    unmatched: dict[int, int] = field(default_factory=dict, compare=False)

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path contains ``pcd/*.pcd``, or is that folder of scans.

        Scans beside a pose file are not of this layout, nor are scans with other names than
        numbers.
        """
        folder = path / "pcd" if has_files(path / "pcd", "*.pcd") else path
        files = sorted(folder.glob("*.pcd"))
        if not files or (folder == path and not any(file.stem.isdigit() for file in files)):
            return False
        if (folder.parent / "gt_cloud.pcd").exists():
            return True
        root = folder.parent if folder.name == "pcd" else folder
        if not all(file.stem.isdigit() for file in (files[0], files[-1])):
            return False
        if any(_has_poses(place) for place in (folder, root)):
            return False
        return _posed(files) or not any(
            pose_candidates(place, len(files)) for place in (folder, root)
        )

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a sequence and read the header of every scan.

        Raises:
            DataError: if a scan is corrupt or has no pose, or the ground truth is invalid.
        """
        folder = path / "pcd" if (path / "pcd").is_dir() else path
        root = folder.parent if folder.name == "pcd" else folder
        scans = numbered_files(folder, ".pcd")
        files = list(scans.values())
        counts = [_validated_count(file) for file in files]
        facts = _read_facts(root / "sequence.toml")
        sensor = load_sensor(facts["sensor"]) if "sensor" in facts else Sensor()
        gt = root / "gt_cloud.pcd"
        truth = (
            GroundTruth(gt, counts, lambda position: read_pcd(files[position]).xyz)
            if gt.exists()
            else None
        )
        return cls(
            facts.get("name", root.name), sensor, facts.get("rate"), scans, truth, facts["classes"]
        )

    @property
    def has_labels(self) -> bool:
        """Whether there is a ``gt_cloud.pcd``."""
        return self.truth is not None

    @property
    def facts(self) -> dict[str, str]:
        """How the ground truth is matched.

        Unmatched points are counted over the frames read so far.
        """
        if self.truth is None:
            return {}
        source = "rows of gt_cloud.pcd" if self.truth.by_index else "coordinates in gt_cloud.pcd"
        return {"ground truth by": source, "unmatched points": f"{sum(self.unmatched.values()):,}"}

    @cached_property
    def origin(self) -> F64:
        """(3,) float64, metres: what is subtracted from all positions."""
        header = read_header(path := next(iter(self.scans.values())))
        return far_origin(_pose(Pcd(path, header, np.empty(0, header.row)))[:3, 3])

    def attributes(self, position: int) -> Attributes:
        """All fields of the file besides the coordinates, as they are in the file."""
        return without_axes(columns_of(read_pcd(list(self.scans.values())[position]).rows))

    def __len__(self) -> int:
        return len(self.scans)

    def scan_file(self, index: int) -> Path | None:
        """The file of the frame with this number."""
        return self.scans.get(index)

    def __getitem__(self, position: int) -> Scan:
        index = list(self.scans)[position]
        pcd = read_pcd(self.scans[index])
        T_world_sensor = _pose(pcd)
        truth = self.truth.for_scan(position % len(self), pcd.xyz) if self.truth else None
        if truth:
            self.unmatched[index] = truth.unmatched
        if self.origin.any():
            T_world_sensor = T_world_sensor.copy()
            T_world_sensor[:3, 3] -= self.origin
        return Scan(
            index=index,
            points=single(coordinates(columns_of(pcd.rows)) - self.origin)
            if self.origin.any()
            else pcd.xyz,
            T_world_sensor=T_world_sensor,
            stamp_ns=round(index / self.rate * 1e9) if self.rate else None,
            labels=truth.labels if truth else None,
            classes=truth.classes if truth else None,
            instances=truth.instances if truth else None,
            origins=self._origins(pcd, T_world_sensor),
            class_names=self.class_names,
        )

    def _origins(self, pcd: Pcd, T_world_sensor: F64) -> F64:
        """(1, 3) or (N, 3) float64, metres, world frame: origins of the rays."""
        if "lidar" not in pcd or not self.sensor.mounts:
            return T_world_sensor[None, :3, 3]
        lidar = pcd["lidar"].astype(np.int64)
        if len(lidar) and not 0 <= lidar.min() <= lidar.max() < len(self.sensor.mounts):
            problem = (
                f"a point has lidar {lidar.max()}, but {self.sensor.title} has "
                f"{len(self.sensor.mounts)} lidars"
            )
            raise DataError(
                pcd.path,
                problem,
                hint="Number lidars from 0, or set another sensor in sequence.toml",
            )
        mounts = np.array([mount[:3] for mount in self.sensor.mounts], np.float64)
        return geometry.apply(T_world_sensor, mounts)[lidar]


def _has_poses(folder: Path) -> bool:
    """Whether a folder has a pose file, or several among which somebody must choose."""
    try:
        return find_poses(folder) is not None
    except DataError:
        return True


def _posed(files: list[Path]) -> bool:
    """Whether a scan has a pose that is not the identity; damaged scans are reported later."""
    for file in (files[0], files[len(files) // 2], files[-1]):
        try:
            viewpoint = read_header(file).viewpoint
        except DataError:
            return True
        if viewpoint is None or not np.array_equal(viewpoint, [0, 0, 0, 1, 0, 0, 0]):
            return True
    return False


def _validated_count(path: Path) -> int:
    """Number of points of a scan; checks its header, pose and file size."""
    header = read_header(path)
    pcd = Pcd(path, header, np.empty(0, header.row))
    _pose(pcd)
    _ = pcd.xyz
    needed = header.offset + header.points * header.row.itemsize
    if header.data == "binary" and path.stat().st_size < needed:
        problem = (
            f"file is too short: {header.points} points need {needed} bytes, it has "
            f"{path.stat().st_size}"
        )
        raise DataError(
            path, problem, at=f"byte {path.stat().st_size}", hint="Write or copy the file again"
        )
    return header.points


def _pose(pcd: Pcd) -> F64:
    T_world_sensor = pcd.T_world_sensor
    if T_world_sensor is None:
        raise NoPoses(pcd.path, "has no VIEWPOINT, so the sensor pose is unknown", hint=_POSE_HINT)
    return T_world_sensor


def _read_facts(path: Path) -> Mapping[str, Any]:
    """The content of ``sequence.toml``, if it exists."""
    if not path.exists():
        return {"classes": {}}
    hint = 'Set name = "...", sensor = "..." (see dynaviz list sensors) and rate = 10.0'
    facts = read_toml(path, hint)
    types: dict[str, Any] = {"name": str, "sensor": str, "rate": (int, float)}
    for key, type_ in types.items():
        if key in facts and not isinstance(facts[key], type_):
            raise DataError(path, f"invalid {key} = {facts[key]!r}", hint=hint)
    if not facts.get("rate", 1.0) > 0:
        raise DataError(path, f"invalid rate = {facts['rate']}, must be positive", hint=hint)
    if "name" in facts and facts["name"] != (Path(facts["name"]).name or None):
        raise DataError(
            path, f"invalid name = {facts['name']!r}, must be usable as a folder name", hint=hint
        )
    try:
        classes = {int(number): str(name) for number, name in facts.get("classes", {}).items()}
    except (AttributeError, ValueError):
        hint = 'Write a table [classes] with entries such as 10 = "car"'
        raise DataError(path, "invalid [classes], must map numbers to names", hint=hint) from None
    return {**facts, "classes": classes}
