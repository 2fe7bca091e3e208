"""DOALS (Pfreundschuh et al. 2021).

An OS1-64 carried through crowds, with ten labelled scans per sequence.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from dynaviz.arrays import F64, I64
from dynaviz.contracts.attributes import Attributes
from dynaviz.contracts.reader import Reader
from dynaviz.contracts.scan import Label, Scan
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file
from dynaviz.io.rosbag import Bag
from dynaviz.sources.datasets.rosbag import CLOUD, RosBagSequence
from dynaviz.sources.datasets.scan_folder import ScanFolderSequence

TOPIC = "/os1_cloud_node/points"
INDICES = "indices.csv"
_HINT = (
    "Each line is the stamp of a scan in nanoseconds, followed by the indices of its dynamic points"
)


@dataclass(frozen=True)
class DoalsSequence(Reader):
    """A sequence of DOALS: a bag, or a folder of scans named by their stamps, next to
    ``indices.csv``.

    Each line of ``indices.csv`` is the stamp of a labelled scan in nanoseconds and the indices of
    its dynamic points; its other points are static. All other scans are unlabelled.
    """

    layout: ClassVar[str] = "indices.csv with a bag, or with a folder of scans named by stamp"

    folder: Path
    inner: RosBagSequence | ScanFolderSequence
    dynamic: Mapping[int, I64]
    sensor: Sensor

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path is a folder with ``indices.csv``, or a bag in such a folder."""
        folder = path.parent if path.suffix == ".bag" else path
        return (folder / INDICES).is_file()

    @classmethod
    def open(
        cls,
        path: Path,
        *,
        poses: str | None = None,
        points_in: str | None = None,
        deskew: bool | None = None,
    ) -> Self:
        """Open a sequence; the options are those of bags, the first two also those of folders of
        scans.

        Raises:
            DataError: if scans, poses or labels are missing or invalid, or no scan has a stamp of
                ``indices.csv``.
        """
        folder = path.parent if path.suffix == ".bag" else path
        bags = [path] if path != folder else sorted(folder.glob("*.bag"))
        if len(bags) > 1:
            raise DataError(
                folder,
                f"contains several bags: {bags[0].name}, {bags[1].name}",
                hint="Give one of them",
            )
        inner: RosBagSequence | ScanFolderSequence
        if bags:
            inner = RosBagSequence.open(
                _with_topic(bags[0]), poses=poses, points_in=points_in, deskew=deskew
            )
            stamps = inner.clouds.stamps[inner.positions]
        else:
            inner = ScanFolderSequence.open(folder, poses=poses, points_in=points_in)
            stamps = (
                inner.matched.stamps if inner.matched.stamps is not None else np.empty(0, np.int64)
            )
        dynamic = _read_indices(folder / INDICES)
        if not np.isin(list(dynamic), stamps).any():
            hint = "Name the scans by their stamps in nanoseconds, such as 1582196327123456789.bin"
            raise DataError(
                folder / INDICES, "none of its stamps is the stamp of a scan", hint=hint
            )
        return cls(folder, inner, dynamic, load_sensor("os1_64"))

    @property
    def name(self) -> str:
        """Scene and number, such as ``doals_hauptgebaeude_1``."""
        return f"doals_{self.folder.parent.name}_{self.folder.name.removeprefix('sequence_')}"

    @property
    def has_labels(self) -> bool:
        """True: some scans have labels."""
        return True

    @property
    def facts(self) -> dict[str, str]:
        """The facts of the bag or folder, and the number of labelled scans."""
        return {**self.inner.facts, "labelled scans": str(len(self.dynamic))}

    def __len__(self) -> int:
        return len(self.inner)

    def attributes(self, position: int) -> Attributes:
        """Those of the bag or folder."""
        return self.inner.attributes(position)

    @property
    def origin(self) -> F64:
        """That of the bag or folder."""
        return self.inner.origin

    def __getitem__(self, position: int) -> Scan:
        scan = self.inner[position]
        labels = np.full(len(scan), Label.UNLABELLED, np.uint8)
        moving = None if scan.stamp_ns is None else self.dynamic.get(scan.stamp_ns)
        if moving is not None:
            if len(moving) and not 0 <= moving.min() <= moving.max() < len(scan):
                problem = (
                    f"point {moving.max()} of the scan at {scan.stamp_ns} ns, which has "
                    f"{len(scan)} points"
                )
                raise DataError(
                    self.folder / INDICES,
                    problem,
                    hint="Use the scans as published, in their order",
                )
            labels[:] = Label.STATIC
            labels[moving] = Label.DYNAMIC
            labels[~np.isfinite(scan.points).all(1)] = Label.UNLABELLED  # beams without a return
        return replace(scan, labels=labels)


def _with_topic(bag: Path) -> Path:
    """The bag, with the topic of the lidar if it has several topics of clouds."""
    topics = [topic for topic, type_ in Bag(bag).topics.items() if type_ == CLOUD]
    return Path(f"{bag}#{TOPIC}") if len(topics) > 1 and TOPIC in topics else bag


def _read_indices(path: Path) -> dict[int, I64]:
    """Indices of the dynamic points by stamp, nanoseconds."""
    found: dict[int, I64] = {}
    with open_file(path, _HINT) as file:
        for number, line in enumerate(file, 1):
            try:
                row = [int(word) for word in line.decode("latin-1").split(",") if word.strip()]
                if row:
                    found[row[0]] = np.array(row[1:], np.int64)
            except (ValueError, OverflowError):
                raise DataError(
                    path, "contains something other than integers", at=f"line {number}", hint=_HINT
                ) from None
    if not found:
        raise DataError(path, "contains no labels", hint=_HINT)
    return found
