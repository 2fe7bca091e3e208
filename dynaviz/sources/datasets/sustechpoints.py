"""Scenes of the annotation tool SUSTechPOINTS: boxes with object ids, one JSON file per scan.

Layout and frames: documentation of naurril/SUSTechPOINTS (Li et al. 2020).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from dynaviz.arrays import F32, F64
from dynaviz.contracts.attributes import Attributes
from dynaviz.contracts.reader import Reader
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import DataError, NoPoses
from dynaviz.io.plain_json import read_json
from dynaviz.sources.datasets.box_labels import (
    MIN_WAY,
    OrientedBox,
    moving_tracks,
    track_facts,
    truth_from_boxes,
)
from dynaviz.sources.datasets.files import has_files, only
from dynaviz.sources.datasets.pose_matching import NO_POSES, MatchedPoses
from dynaviz.sources.datasets.scan_folder import ScanFolderSequence
from dynaviz.sources.datasets.truth import Truth, scan_fields
from dynaviz.spatial import geometry

IGNORED = "dontcare"
"""Type of boxes in which nobody annotated."""
FARTHEST = 1e9  # metres, of positions and sizes
_HINT = "Save the frame again with SUSTechPOINTS"
_POSE_HINT = (
    'Write lidar_pose/FRAME.json, {"lidarPose": 16 numbers}, with the tool\'s adjust_ego_pose.py; '
    "or give a pose file with --poses"
)


@dataclass(frozen=True)
class SustechPointsSequence(Reader):
    """A scene of SUSTechPOINTS: ``lidar/*.pcd`` in the sensor frame, ``label/*.json``.

    Poses are those of ``lidar_pose/*.json``, unless a pose file is given. Points in the box of a
    moving object are dynamic. A box without an object id may move or not: its points are
    unlabelled. Frames without a label file are unlabelled, and so is everything if there are no
    poses, because nobody can tell then which objects move.
    """

    layout: ClassVar[str] = "SCENE/{lidar/*.pcd, label/*.json, lidar_pose/*.json}"

    folder: Path
    inner: ScanFolderSequence
    posed: bool
    sensor: Sensor

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a scene, its folder ``lidar``, or the parent of scenes."""
        return bool(_scenes(path))

    @classmethod
    def open(cls, path: Path, *, poses: str | None = None, points_in: str | None = None) -> Self:
        """Open a scene; the options are those of folders of scans.

        Raises:
            DataError: if scans, poses or labels are missing or invalid, or there are several
                scenes.
        """
        found = _scenes(path)
        folder = only(path, "scenes", {folder.name: folder for folder in found})
        own = has_files(folder / "lidar_pose", "*.json")
        try:
            inner = ScanFolderSequence.open(
                folder / "lidar",
                poses=NO_POSES if own and not poses else poses,
                points_in=points_in,
            )
        except NoPoses as error:
            if not (folder / "ego_pose").is_dir():
                raise
            problem = "has poses of the car (ego_pose), but not of the lidar"
            raise NoPoses(folder, problem, hint=_POSE_HINT) from error
        if own and not poses:
            inner = _posed(inner, folder / "lidar_pose")
        return cls(folder, inner, poses != NO_POSES, inner.sensor)

    @property
    def name(self) -> str:
        """Format and scene, such as ``sustechpoints_example``."""
        return f"sustechpoints_{self.folder.name}"

    @property
    def has_labels(self) -> bool:
        """Whether there are label files, and poses that show what moves."""
        return self.posed and has_files(self.folder / "label", "*.json")

    @property
    def facts(self) -> dict[str, str]:
        """The facts of the folder of scans, the objects, and how moving ones are found."""
        facts = dict(self.inner.facts)
        if not self.posed:
            return facts | {"labels": "none: without poses, nobody can tell what moves"}
        tracks = {box.track for boxes in self.boxes.values() for box in boxes} - self._untracked
        facts |= track_facts(tracks, self.moving)
        if self._untracked:
            facts["boxes without an id"] = f"{len(self._untracked):,}, their points are unlabelled"
        if self.inner.stamps is None:
            way = f"over {MIN_WAY:g} m from its first box to its last"
            facts["moving objects"] = f"{way}, because the names of the scans are not times"
        return facts

    @property
    def origin(self) -> F64:
        """That of the folder of scans."""
        return self.inner.origin

    def attributes(self, position: int) -> Attributes:
        """Those of the file."""
        return self.inner.attributes(position)

    def coordinates(self, position: int) -> F32 | F64 | None:
        """Those of the file."""
        return self.inner.coordinates(position)

    def __len__(self) -> int:
        return len(self.inner)

    def scan_file(self, index: int) -> Path | None:
        """The file of the frame with this number."""
        return self.inner.scan_file(index)

    def __getitem__(self, position: int) -> Scan:
        scan = self.inner[position]
        if not self.has_labels:
            return scan
        truth = self._truth(position % len(self), scan)
        return replace(scan, **scan_fields(truth, self.class_names))

    def _truth(self, position: int, scan: Scan) -> Truth:
        boxes = self.boxes.get(position)
        annotated = np.full(len(scan), boxes is not None)
        points = geometry.apply(geometry.inverse(scan.T_world_sensor), scan.points)
        return truth_from_boxes(points, boxes or [], self.moving | self._untracked, annotated)

    @cached_property
    def boxes(self) -> dict[int, list[OrientedBox]]:
        """The boxes of each frame with a label file, by position, in the sensor frame."""
        return self._annotations[0]

    @property
    def class_names(self) -> Mapping[int, str]:
        """Types of objects by their number."""
        return self._annotations[1]

    @property
    def _untracked(self) -> frozenset[int]:
        """Numbers of the boxes without an object id."""
        return self._annotations[2]

    @cached_property
    def moving(self) -> frozenset[int]:
        """Numbers of the objects that move."""
        stamps = self.inner.stamps
        return moving_tracks(
            (
                box.track,
                None if stamps is None else 1e-9 * float(stamps[position] - stamps[0]),
                geometry.compose(self.inner.matched.poses[position], box.T_frame_box)[:3, 3],
            )
            for position, boxes in self.boxes.items()
            for box in boxes
            if box.track not in self._untracked
        )

    @cached_property
    def _annotations(
        self,
    ) -> tuple[dict[int, list[OrientedBox]], dict[int, str], frozenset[int]]:
        """The boxes, names of their types, and the numbers of boxes without an object id."""
        files = {
            position: file
            for position, scan in enumerate(self.inner.scans)
            if (file := self.folder / "label" / f"{scan.stem}.json").is_file()
        }
        objects = {position: _objects(file) for position, file in files.items()}
        every = [one for several in objects.values() for one in several]
        types = sorted({kind for kind, _, _, _ in every})
        names = sorted({name for kind, name, _, _ in every if name and kind != IGNORED})
        numbers = {name: number for number, name in enumerate(names, 1)}
        untracked: set[int] = set()
        boxes: dict[int, list[OrientedBox]] = {}
        for position, several in objects.items():
            boxes[position] = []
            for kind, name, T_sensor_box, size in several:
                tracked = name in numbers and kind != IGNORED
                track = numbers[name] if tracked else len(names) + len(untracked) + 1
                if not tracked:
                    untracked.add(track)
                number = types.index(kind) + 1
                box = OrientedBox(track, number, T_sensor_box, size, extrapolated=not tracked)
                boxes[position].append(box)
        return boxes, dict(enumerate(("none", *types))), frozenset(untracked)


def _scenes(path: Path) -> list[Path]:
    """The scenes that a path may refer to."""
    for folder in (path, path.parent if path.name == "lidar" else path):
        if _is_scene(folder):
            return [folder]
    places = (path, path / "data")
    return sorted(folder for place in places for folder in place.glob("*") if _is_scene(folder))


def _is_scene(folder: Path) -> bool:
    return has_files(folder / "label", "*.json") and any(
        has_files(folder / "lidar", f"*{suffix}") for suffix in (".pcd", ".bin")
    )


def _posed(inner: ScanFolderSequence, folder: Path) -> ScanFolderSequence:
    """The scans that have a pose in ``lidar_pose``, with it.

    Raises:
        DataError: if none has one, or one is not a pose.
    """
    files = [folder / f"{scan.stem}.json" for scan in inner.scans]
    kept = [position for position, file in enumerate(files) if file.is_file()]
    if not kept:
        raise DataError(folder, "has no pose of any scan", hint=_POSE_HINT)
    poses = np.array([_pose(files[position]) for position in kept])
    stamps = None if inner.stamps is None else inner.stamps[kept]
    missing = set(range(len(files))) - set(kept)
    matched = MatchedPoses(np.array(kept), poses, stamps, "lidar_pose/*.json").near_zero()
    return replace(
        inner,
        scans=tuple(inner.scans[position] for position in kept),
        indices=tuple(inner.indices[position] for position in kept),
        matched=matched,
        skipped=(*inner.skipped, *(inner.scans[position] for position in sorted(missing))),
    )


def _pose(path: Path) -> F64:
    """(4, 4) float64, metres: T_world_sensor."""
    content = read_json(path, _POSE_HINT)
    try:
        T = np.array(content["lidarPose"], np.float64).reshape(4, 4)
        problem = geometry.rotation_problem(T[:3, :3])
        if not np.isfinite(T).all() or np.abs(T[:3, 3]).max() >= FARTHEST:
            problem = "the position is not finite, or too far"
    except (ValueError, TypeError, KeyError, OverflowError):
        problem = "has no lidarPose of 16 numbers"
    if problem:
        raise DataError(path, problem, hint=_POSE_HINT)
    T[3] = 0, 0, 0, 1
    return T


def _objects(path: Path) -> list[tuple[str, str, F64, tuple[float, float, float]]]:
    """Type, object id, T_sensor_box of the bottom face, and size of each box in a file."""
    content: Any = read_json(path, _HINT)
    if isinstance(content, dict):
        content = content.get("objs")
    if not isinstance(content, list):
        raise DataError(path, "is not a list of boxes", hint=_HINT)
    objects = []
    for number, each in enumerate(content):
        try:
            psr = each["psr"]
            centre, size, angles = (
                np.array([float(psr[name][axis]) for axis in "xyz"])
                for name in ("position", "scale", "rotation")
            )
            if not (np.abs([*centre, *size]) < FARTHEST).all() or not np.isfinite(angles).all():
                raise ValueError("not finite, or too far")
            kind = str(each["obj_type"]).lower()
            name = str(each.get("obj_id", "") or "")
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError):
            at = f"box {number}"
            raise DataError(
                path, "no valid position, scale and rotation", at=at, hint=_HINT
            ) from None
        T_sensor_box = np.eye(4)
        T_sensor_box[:3, :3] = _rotation(angles)
        T_sensor_box[:3, 3] = centre - T_sensor_box[:3, 2] * size[2] / 2
        length, width, height = size.tolist()
        objects.append((kind, name, T_sensor_box, (length, width, height)))
    return objects


def _rotation(angles: F64) -> F64:
    """(3, 3): rotation by (3,) radians about the box's own x, then y, then z axis."""
    R: F64 = np.eye(3)
    for axis, angle in enumerate(angles):
        first = (axis + 1) % 3
        second = (axis + 2) % 3
        turn = np.eye(3)
        turn[first, first] = turn[second, second] = np.cos(angle)
        turn[second, first] = np.sin(angle)
        turn[first, second] = -np.sin(angle)
        R = geometry.compose(R, turn)
    return R
