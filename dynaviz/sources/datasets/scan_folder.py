"""Any folder of scans with a pose file."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from dynaviz.arrays import F32, F64, I32, I64, U8, U16, single
from dynaviz.contracts.attributes import Attributes, Unposed
from dynaviz.contracts.reader import Reader
from dynaviz.contracts.scan import Label, Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import DataError, NoPoses
from dynaviz.io.e57 import SUFFIX as E57
from dynaviz.io.e57 import read_e57_pose
from dynaviz.io.fields import coordinates, given_coordinates, read_fields, read_points, without_axes
from dynaviz.io.npy import open_npy
from dynaviz.io.pcd import Pcd, read_header
from dynaviz.io.poses import find_poses, nanoseconds, pose_candidates, read_poses
from dynaviz.io.semantic_label import read_semantic_labels
from dynaviz.io.text_cloud import SUFFIXES as TEXT_SUFFIXES
from dynaviz.io.text_cloud import is_text_cloud
from dynaviz.io.velodyne import detect_columns, read_velodyne, velodyne_attributes
from dynaviz.sources.datasets.pose_matching import (
    NO_POSES,
    MatchedPoses,
    match_poses,
    parse_extrinsic,
    parse_points_in,
    warn_skipped,
)
from dynaviz.sources.datasets.semantickitti import CLASS_NAMES, MOVING_CLASSES, UNLABELLED_CLASSES
from dynaviz.sources.hypotheses.judge import Points
from dynaviz.sources.hypotheses.names import read_names
from dynaviz.spatial import geometry
from dynaviz.spatial.trajectory import PosesOverTime

SUFFIXES = (".bin", ".e57", ".las", ".laz", ".npy", ".npz", ".pcd", ".ply")
# Folder names that do not identify a sequence.
_GENERIC_NAMES = ("scans", "pcd", "pcds", "ply", "bin", "velodyne", "lidar", "points", "clouds")
_NO_POSES = (
    "Estimate them with --poses small-gicp, or give --poses FILE: KITTI (12 numbers per line), TUM "
    "(time x y z qx qy "
    "qz qw) or CSV with a header"
)


@dataclass(frozen=True)
class ScanFolderSequence(Reader):
    """Scans as numbered or stamped files with a pose file.

    Files are ``.bin .pcd .ply .npy .npz .las .laz .e57``, or text: ``.xyz .asc .txt .csv``.

    The poses come from ``--poses FILE``, from ``poses.txt``, ``trajectory.txt``, ``*.tum``,
    ``poses.csv`` ... next to the scans or their folder, or from the VIEWPOINT of PCD files. Labels
    are optional: ``labels/NAME.label`` (SemanticKITTI; classes 0 and 1 are unlabelled) or
    ``labels/NAME.npy`` (0 static, 1 dynamic, 255 unlabelled).
    """

    layout: ClassVar[str] = (
        "scans 000000.bin, .pcd, .ply, .npy, .npz, .las or .laz with poses.txt, *.tum or poses.csv"
    )
    fallback: ClassVar[bool] = True

    folder: Path
    sensor: Sensor
    scans: tuple[Path, ...]
    indices: tuple[int, ...]
    matched: MatchedPoses
    points_in: str
    columns: tuple[str, ...] = ()
    skipped: tuple[Path, ...] = ()
    naming: str = ""

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a folder, or its only subfolder with scans, contains scans, judged by file names
        only.
        """
        return path.is_dir() and _scans_in(path) is not None

    @classmethod
    def open(
        cls,
        path: Path,
        *,
        poses: str | None = None,
        points_in: str | None = None,
        extrinsic: str | None = None,
    ) -> Self:
        """Open a folder.

        Args:
            path: folder of the scans, or the parent of the only folder with scans.
            poses: pose file; None searches next to the scans; ``none`` leaves each scan in its own
                frame.
            points_in: ``sensor`` (default) or ``world``: the frame of the points in the files.
            extrinsic: pose of the sensor on the vehicle, if the poses are those of the vehicle.

        Raises:
            DataError: if there are no scans or no poses, or they do not match.
            UsageError: for any other ``points_in``.
        """
        frame = parse_points_in(points_in)
        folder = _scans_in(path) if path.is_dir() else None
        if folder is None:
            known = ", ".join((*SUFFIXES, *TEXT_SUFFIXES))
            hint = f"Scans end in {known} and are named by number or stamp"
            raise DataError(path, _describe_missing_scans(path), hint=hint)
        sequence_folder = (
            folder.parent if folder != path or folder.name.lower() in _GENERIC_NAMES else folder
        )
        file = None
        if poses != NO_POSES:
            file = Path(poses).absolute() if poses else find_beside(folder, sequence_folder)
        scans, numbers, stamps, naming = _sorted_scans(folder, file)
        columns = detect_columns(scans[0]) if scans[0].suffix.lower() == ".bin" else ()
        if poses == NO_POSES:
            matched = MatchedPoses(
                np.arange(len(scans)), np.tile(np.eye(4), (len(scans), 1, 1)), stamps, "none"
            )
        elif file is not None:
            points = None if frame == "world" else _reader(scans, columns)
            matched = match_poses(file, folder, stamps, numbers, points)
        else:
            matched = _own_poses(folder, sequence_folder, scans, stamps)
        mount = parse_extrinsic(extrinsic)
        matched = (matched if mount is None else matched.mounted(mount)).near_zero()
        kept = matched.positions.tolist()
        indices = tuple(kept) if stamps is not None else tuple(numbers[kept].tolist())
        posed = set(kept)
        skipped = tuple(scan for k, scan in enumerate(scans) if k not in posed)
        return cls(
            folder,
            Sensor(),
            tuple(scans[k] for k in kept),
            indices,
            matched,
            frame,
            columns,
            skipped,
            naming,
        )

    @property
    def name(self) -> str:
        """Name of the folder, or of its parent if the folder has a generic name such
        as ``scans``.
        """
        return (
            self.folder.parent if self.folder.name.lower() in _GENERIC_NAMES else self.folder
        ).name or "scans"

    @cached_property
    def has_labels(self) -> bool:
        """Whether any scan has labels; cached, because it checks the files of every scan."""
        return any(self._label_file(scan) is not None for scan in self.scans)

    @property
    def facts(self) -> dict[str, str]:
        """Source and matching of the poses, and frame of the points."""
        facts = {
            "poses": self.matched.description,
            "points in": f"{self.points_in} frame",
            "names": self.naming,
            "deskewed": "no, scans are taken as they are",
        }
        if self.columns:
            facts["columns"] = " ".join(self.columns)
        if self.origin.any():
            facts["origin"] = (
                " ".join(f"{x:.0f}" for x in self.origin) + " m, subtracted here and added in maps"
            )
        return facts

    @property
    def origin(self) -> F64:
        """(3,) float64, metres: what was subtracted from all positions."""
        return self.matched.origin

    @property
    def stamps(self) -> I64 | None:
        """(frames,) int64, nanoseconds: time of each frame; None for numbered scans."""
        return self.matched.stamps

    @property
    def pose_path(self) -> PosesOverTime | None:
        """The poses over time; None if they are not matched by stamp."""
        return self.matched.trajectory

    def __len__(self) -> int:
        return len(self.scans)

    def scan_file(self, index: int) -> Path | None:
        """The file of the frame with this number."""
        return self.scans[self.indices.index(index)] if index in self.indices else None

    def __getitem__(self, position: int) -> Scan:
        path = self.scans[position]
        T_world_sensor = self.matched.poses[position]
        xyz = self._points(path)
        labels, classes, instances = self._labels(path, len(xyz))
        stamps = self.matched.stamps
        return Scan(
            index=self.indices[position],
            points=xyz if self.points_in == "world" else geometry.transform(T_world_sensor, xyz),
            T_world_sensor=T_world_sensor,
            stamp_ns=None if stamps is None else int(stamps[position]),
            labels=labels,
            classes=classes,
            instances=instances,
            class_names=CLASS_NAMES if classes is not None else {},
        )

    def attributes(self, position: int) -> Attributes:
        """All fields of the file besides the coordinates, as they are in the file."""
        return self._attributes(self.scans[position])

    def coordinates(self, position: int) -> F32 | F64 | None:
        """(N, 3), metres, in the world; None for float32 in the sensor frame."""
        if self.points_in == "world":
            return self._given(self.scans[position])
        if self._given_type == np.float32:
            return None
        return (
            geometry.apply(self.matched.poses[position], self._given(self.scans[position]))
            + self.origin
        )

    @cached_property
    def _given_type(self) -> np.dtype[Any]:
        """The type of the coordinates in the first file."""
        return self._given(self.scans[0]).dtype

    @property
    def las_file(self) -> Path | None:
        """The first scan, if it is a LAS or LAZ file in the world frame."""
        first = self.scans[0]
        return (
            first
            if self.points_in == "world" and first.suffix.lower() in (".las", ".laz")
            else None
        )

    def unposed(self) -> Iterator[Unposed]:
        """The points of scans without a pose."""
        for path in self.skipped:
            if self.points_in == "world":
                xyz = self._given(path).astype(np.float64)
                yield Unposed(len(xyz), xyz, self._attributes(path))
            else:
                yield Unposed(len(self._points(path)))

    def _attributes(self, path: Path) -> Attributes:
        if self.columns:
            return velodyne_attributes(read_velodyne(path, len(self.columns)), self.columns)
        return without_axes(read_fields(path))

    def _given(self, path: Path) -> F32 | F64:
        """(N, 3), metres: coordinates in the file."""
        if self.columns:
            return read_velodyne(path, len(self.columns))[:, :3]
        return given_coordinates(read_fields(path))

    def _points(self, path: Path) -> F32:
        """(N, 3) float32, metres, in the file's frame, or in the world moved by the origin."""
        if self.columns:
            return read_velodyne(path, len(self.columns))[:, :3]
        if self.points_in == "world" and self.origin.any():
            return single(coordinates(read_fields(path)) - self.origin)
        return read_points(path)

    def _label_file(self, scan: Path) -> Path | None:
        for folder in (self.folder / "labels", self.folder.parent / "labels"):
            for suffix in (".label", ".npy"):
                if (file := folder / f"{_stem(scan)}{suffix}").is_file():
                    return file
        return None

    def _labels(self, scan: Path, points: int) -> tuple[U8 | None, U16 | None, I32 | None]:
        """Labels, classes and instances of a scan.

        All unlabelled if only other scans have labels.
        """
        file = self._label_file(scan)
        if file is None:
            return (
                (np.full(points, Label.UNLABELLED, np.uint8) if self.has_labels else None),
                None,
                None,
            )
        if file.suffix == ".npy":
            return _label_array(file, points), None, None
        classes, instances = read_semantic_labels(file, points)
        moving = (classes >= MOVING_CLASSES.start) & (classes < MOVING_CLASSES.stop)
        labels = np.where(moving, Label.DYNAMIC, Label.STATIC).astype(np.uint8)
        labels[np.isin(classes, UNLABELLED_CLASSES)] = Label.UNLABELLED
        return labels, classes, instances.astype(np.int32)


def _describe_missing_scans(path: Path) -> str:
    """What a path contains instead of scans, for error messages."""
    if not path.is_dir():
        return "not a folder"
    suffixes = ", ".join(sorted({entry.suffix or entry.name for entry in path.iterdir()})[:6])
    return f"contains no scans, only {suffixes}" if suffixes else "contains no scans"


def _entries(folder: Path) -> list[Path]:
    """The content of a folder; empty if it cannot be read, such as lost+found of a disk."""
    with contextlib.suppress(OSError):
        return list(folder.iterdir())
    return []


def _scan_files(folder: Path) -> list[Path]:
    """Files that look like scans: a supported suffix, and a digit at the end of the name.

    Text files are scans only if there are no others, and several of them, with points.
    """
    numbered = [path for path in _entries(folder) if _stem(path)[-1:].isdigit()]
    if found := [path for path in numbered if _suffix(path) in SUFFIXES]:
        return found
    texts = [path for path in numbered if _suffix(path) in TEXT_SUFFIXES]
    points = len(texts) > 1 and all(is_text_cloud(path) for path in (texts[0], texts[-1]))
    return texts if points else []


def _stem(path: Path) -> str:
    """The name without its suffixes: ``scan_000001`` of ``scan_000001.pcd.bin``."""
    stem = path.stem
    return stem[: -len(".pcd")] if stem.lower().endswith(".pcd") else stem


def _suffix(path: Path) -> str:
    return path.suffix.lower()


def _scans_in(path: Path) -> Path | None:
    """The folder with the scans: the path itself, or its only subfolder with scans."""
    if _scan_files(path):
        return path
    folders = [each for each in _entries(path) if each.is_dir() and each.name != "labels"]
    files = {folder: found for folder in folders if (found := _scan_files(folder))}
    candidates = [each for each in files if _suffix(files[each][0]) in SUFFIXES] or [*files]
    return candidates[0] if len(candidates) == 1 else None


def _sorted_scans(folder: Path, poses: Path | None) -> tuple[list[Path], I64, I64 | None, str]:
    """The scans in order, their numbers, their stamps if the names are times, and how the names
    were read.

    Args:
        folder: of the scans.
        poses: pose file, whose times show what the names mean.

    Raises:
        DataError: for files of several formats, or two files with the same number.
    """
    files = sorted(_scan_files(folder))
    suffixes = Counter(_suffix(path) for path in files)
    if len(suffixes) > 1:
        counts = ", ".join(f"{suffix} ({count})" for suffix, count in suffixes.most_common())
        raise DataError(
            folder,
            f"contains scans in several formats: {counts}",
            hint="Keep one format per folder",
        )
    naming = read_names([_stem(path) for path in files], _times_of(poses))
    keys = naming.keys
    order = sorted(range(len(files)), key=lambda k: (keys[k], files[k].name))
    for a, b in pairwise(order):
        if keys[a] == keys[b]:
            raise DataError(
                files[b], f"has the same number as {files[a].name}", hint="Remove one of them"
            )
    try:
        numbers = np.array([keys[k] for k in order], np.int64)
    except OverflowError:
        raise DataError(
            files[order[-1]],
            f"its name is not a valid time ({_too_large(_stem(files[order[-1]]))})",
            hint="Name scans by number, or by their stamp in s, ms, us or ns since 1970",
        ) from None
    first = files[order[0]].name
    words = f"{naming}, {first} to {files[order[-1]].name}" if len(files) > 1 else str(naming)
    return [files[k] for k in order], numbers, numbers if naming.timed else None, words


def _too_large(stem: str) -> str:
    """Why the number in a name is no time."""
    try:
        nanoseconds(stem)
    except ValueError as error:
        return str(error)
    return "the number is too large"


def _times_of(poses: Path | None) -> I64 | None:
    """The times in a pose file; None if it has none, or cannot be read, which is reported later."""
    if poses is None:
        return None
    try:
        return read_poses(poses).stamps
    except DataError:
        return None


def _reader(scans: list[Path], columns: tuple[str, ...]) -> Points:
    """Reads the points of a scan as they are in its file."""

    def read(position: int) -> F64:
        path = scans[position]
        if columns:
            return read_velodyne(path, len(columns))[:, :3].astype(np.float64)
        return coordinates(read_fields(path))

    return read


def find_beside(folder: Path, sequence: Path) -> Path | None:
    """The pose file in the folder of the scans, or beside it.

    Raises:
        DataError: if there are several of the same rank.
    """
    return find_poses(folder) or find_poses(sequence)


def _own_poses(folder: Path, sequence: Path, scans: list[Path], stamps: I64 | None) -> MatchedPoses:
    """Poses in a file beside each scan (``.odom``), or in the VIEWPOINT of PCD files.

    Raises:
        DataError: if there are none, but another file may have them.
        NoPoses: if there are none.
    """
    files = [path.with_name(f"{_stem(path)}.odom") for path in scans]
    posed = [k for k, path in enumerate(files) if path.is_file()]
    if posed:
        poses = np.concatenate([read_poses(files[k]).poses for k in posed])
        kept = np.array(posed)
        own = None if stamps is None else stamps[kept]
        warn_skipped(len(scans) - len(kept), len(scans), "have no .odom file")
        return MatchedPoses(kept, poses, own, "a .odom file beside each scan")
    try:
        return _viewpoints(folder, scans, stamps)
    except NoPoses:
        places = dict.fromkeys([folder, sequence])
        found = [file for place in places for file in pose_candidates(place, len(scans))]
        if not found:
            raise
        names = ", ".join(path.name for path in found[:4])
        hint = (
            f"If these are the poses, give them with --poses {found[0]}; otherwise estimate them "
            "with --poses small-gicp"
        )
        raise DataError(
            folder,
            f"has no poses under a usual name, but files that may be poses: {names}",
            hint=hint,
        ) from None


def _viewpoints(folder: Path, scans: list[Path], stamps: I64 | None) -> MatchedPoses:
    """Poses from the VIEWPOINT of PCD files.

    Raises:
        DataError: if a scan has none, or all are the identity.
    """
    poses = []
    for path in scans:
        T_world_sensor = _own_pose(path)
        if T_world_sensor is None:
            raise NoPoses(folder, "has no poses", hint=_NO_POSES)
        poses.append(T_world_sensor)
    if all(np.array_equal(T, np.eye(4)) for T in poses):
        raise NoPoses(
            folder, "has no poses: VIEWPOINT is the identity in every scan", hint=_NO_POSES
        )
    source = "pose of each E57" if _suffix(scans[0]) == E57 else "VIEWPOINT of each PCD"
    return MatchedPoses(np.arange(len(poses)), np.array(poses), stamps, source)


def _own_pose(path: Path) -> F64 | None:
    """The pose in a scan: VIEWPOINT of a PCD file, or that of an E57 file; None without one."""
    if _suffix(path) == E57:
        return read_e57_pose(path)
    header = read_header(path) if _suffix(path) == ".pcd" else None
    return None if header is None else Pcd(path, header, np.empty(0, header.row)).T_world_sensor


def _label_array(path: Path, points: int) -> U8:
    """Labels from an NPY file."""
    hint = f"Save ({points},) integers: 0 static, 1 dynamic, 255 unlabelled"
    with open_npy(path, "NPY file", hint) as labels:
        pass
    if (
        not isinstance(labels, np.ndarray)
        or labels.shape != (points,)
        or labels.dtype.kind not in "iub"
    ):
        raise DataError(
            path,
            f"contains {getattr(labels, 'shape', 'several arrays')} for {points} points",
            hint=hint,
        )
    if not np.isin(labels, [*Label]).all():
        raise DataError(path, f"{labels[~np.isin(labels, [*Label])][0]} is not a label", hint=hint)
    return labels.astype(np.uint8)
