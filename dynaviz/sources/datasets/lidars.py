"""Several lidars of one vehicle, as one sequence.

``drive.bag#/front,/rear`` or ``scans#front,rear``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz.arrays import I64
from dynaviz.contracts.attributes import Attributes
from dynaviz.errors import UsageError
from dynaviz.sources.datasets.drives import Joined
from dynaviz.sources.datasets.pose_matching import NO_POSES
from dynaviz.sources.drive import Drive
from dynaviz.spatial.trajectory import PosesOverTime

LIDAR = "lidar"
"""Attribute of points, and column of poses: number of the lidar, in the order of the names in the
path."""


@dataclass(frozen=True)
class Lidars(Joined):
    """Scans of several lidars in the order of their times.

    Each has the pose of its own lidar, where its rays start.

    Attributes:
        parts: a sequence for each lidar, in one world frame.
        names: of the lidars: topics or folders.
        order: (frames, 2) int64: lidar of each frame, and position in its sequence.
    """

    names: tuple[str, ...]
    order: I64

    @classmethod
    def open(
        cls,
        text: str,
        open_one: Callable[..., Drive],
        poses: str | None = None,
        extrinsic: str | None = None,
        **options: Any,
    ) -> Lidars:
        """Open each lidar.

        Args:
            text: a path for which ``names_in`` finds names.
            open_one: opens the sequence of one lidar, with options.
            poses, options: as for ``dynaviz.open``.
            extrinsic: a pose for each lidar, ``/front=X,Y,Z,ROLL,PITCH,YAW;/rear=...``.

        Raises:
            UsageError: for an extrinsic that does not name each lidar, or poses that are to be
                estimated.
        """
        whole = text.rpartition("#")[0]
        names = names_in(text)
        if poses == NO_POSES:
            one = _path(whole, names[0])
            raise UsageError(
                f"{text}: poses are estimated for one lidar. Estimate them for {one}, then give "
                "the file with --poses "
                f"and the poses of the other lidars in the frame of this one with --extrinsic"
            )
        mounts = _mounts(extrinsic, names)
        lidars = tuple(
            open_one(_path(whole, name), poses=poses, extrinsic=mounts.get(name), **options)
            for name in names
        )
        return cls(lidars, names, _order(lidars))

    @property
    def name(self) -> str:
        """That of the bag, or of the folder with the lidars."""
        folder: Path | None = getattr(self.parts[0].reader, "folder", None)
        return folder.parent.name if folder is not None else self.parts[0].name

    @property
    def facts(self) -> dict[str, str]:
        """The lidars with their numbers of scans, and the facts of the first."""
        counts = ", ".join(
            f"{name} ({len(lidar):,})" for name, lidar in zip(self.names, self.parts, strict=True)
        )
        return {"lidars": counts, **self.parts[0].facts}

    def attributes(self, position: int) -> Attributes:
        """Those of the lidar's frame, and the number of the lidar."""
        found = super().attributes(position)
        (lidar, row) = self.place(position)
        points = len(next(iter(found.values()))) if found else len(self.parts[lidar][row])
        return {**found, LIDAR: np.full(points, lidar, np.uint8)}

    @property
    def trajectories(self) -> Mapping[int, PosesOverTime]:
        """T_world_sensor over time of each lidar; only of those that know it."""
        return {
            number: own
            for number, lidar in enumerate(self.parts)
            for own in lidar.trajectories.values()
        }

    def place(self, position: int) -> tuple[int, int]:
        """The lidar of a frame, and the position in its sequence."""
        lidar, row = self.order[position].tolist()
        return lidar, row


def names_in(text: str) -> tuple[str, ...]:
    """The lidars that a path names after ``#``, separated by commas.

    Empty if it does not name several.
    """
    _, hash_, names = text.rpartition("#")
    return tuple(names.split(",")) if hash_ and "," in names and not Path(text).exists() else ()


def _path(whole: str, name: str) -> str:
    """The path of one lidar: a topic of a bag, or a folder."""
    folder = (
        Path(whole.partition(":")[2] if ":" in whole and not Path(whole).exists() else whole) / name
    )
    return f"{whole}/{name}" if not name.startswith("/") and folder.is_dir() else f"{whole}#{name}"


def _mounts(extrinsic: str | None, names: tuple[str, ...]) -> dict[str, str]:
    """The extrinsic of each lidar; empty if none is given."""
    if extrinsic is None:
        return {}
    parts = dict(part.strip().partition("=")[::2] for part in extrinsic.split(";"))
    if set(parts) != set(names):
        example = ";".join(f"{name}=X,Y,Z,ROLL,PITCH,YAW" for name in names)
        raise UsageError(f"--extrinsic {extrinsic}: must name each lidar once. Give {example}")
    return parts


def _order(lidars: tuple[Drive, ...]) -> I64:
    """Lidar and position of each frame, by time; by position if a lidar has no times."""
    rows = [np.arange(len(lidar)) for lidar in lidars]
    stamps = [found for lidar in lidars if (found := lidar.stamps) is not None]
    keys = stamps if len(stamps) == len(lidars) else rows
    number = np.concatenate([np.full(len(row), k) for k, row in enumerate(rows)])
    order = np.lexsort((number, np.concatenate(keys)))  # stable, first by key, then by lidar
    return np.column_stack([number, np.concatenate(rows)])[order].astype(np.int64)
