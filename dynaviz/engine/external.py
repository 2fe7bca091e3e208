"""Labels from other programs: a cleaned map, labels of each scan, or the labels of an earlier run.

They are scored and recorded like any method. A cleaned map contains points, not labels: a point of
the sequence counts as removed if the nearest point of the map is farther than a radius (scoring
``nn``, the rule of the public benchmark). Labels are looked up by index (scoring ``mask``).
"""

from __future__ import annotations

import os
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from dynaviz.arrays import F32, F64, Bool, all_finite, single
from dynaviz.contracts.method import Context, Labels, MethodInfo, Reason
from dynaviz.contracts.scan import Scan
from dynaviz.engine.label_folder import UNANSWERED, LabelFolder, NoParams
from dynaviz.errors import DataError, UsageError
from dynaviz.io.fields import coordinates, read_fields, read_points
from dynaviz.scores.labels import RunLabels
from dynaviz.sources.drive import Drive
from dynaviz.sources.summary import SequenceSummary
from dynaviz.spatial.nearest import Nearest

RADIUS = 0.05  # metres: that of the public benchmark, half of its 0.1 m voxel

_NEAR, _FAR, _NOT_FINITE = range(3)
_REASONS = (
    Reason("near_kept_point", "kept: a point of the map lies within the radius"),
    Reason("no_kept_point_within_radius", "removed: no point of the map lies within the radius"),
    Reason("not_finite", "kept: no finite coordinates, so no map can contain it"),
)
_NEARBY = 1.0  # metres
_GENERIC = ("predictions", "labels", "sequences", "bin")  # folder names that do not name a program


@runtime_checkable
class TakesMap(Protocol):
    """A metric that looks at a cleaned map itself, in addition to the labels that
    follow from it.
    """

    def cleaned_map(self, points: F32) -> None:
        """The map's points, (M, 3) float32, metres, world frame; finite.

        Called once, before the first scan.
        """
        ...


@dataclass(frozen=True)
class MapParams:
    """Parameters of the scoring; those of the program that wrote the map are unknown.

    Attributes:
        radius: metres; a point this far from the map still counts as kept.
    """

    radius: float = RADIUS


class ExternalMap:
    """A map cleaned by another program, as a labeller.

    Args:
        path: the map (``dynaviz.io.fields.read_points``), in the world frame of the sequence.
        name: for tables.
        radius: metres, 0 or more.
        origin: (3,) float64, metres: subtracted from the map, as from the sequence
            (``Drive.origin``).

    Raises:
        UsageError: for an invalid radius.
        DataError: for a file that cannot be read, or contains no finite point.
    """

    scoring = "nn"

    def __init__(
        self, path: Path, name: str, radius: float = RADIUS, origin: F64 | None = None
    ) -> None:
        if not 0 <= radius < np.inf:
            raise UsageError(
                f"radius = {radius}: give metres, 0 or more; the public benchmark uses {RADIUS}"
            )
        far = origin if origin is not None and origin.any() else None
        points = read_points(path) if far is None else single(coordinates(read_fields(path)) - far)
        chosen = all_finite(points)
        self.path = path
        self.points = np.compress(chosen, points, 0)
        self.params = MapParams(radius)
        self.total = len(points)
        self.not_finite = len(points) - len(self.points)
        if not len(self.points):
            problem = (
                "contains no points"
                if not len(points)
                else "contains no point with finite coordinates"
            )
            raise DataError(
                path,
                problem,
                hint="A cleaned map contains the static points: check its program's output",
            )
        title = f"{name} (a map, within {radius:g} m)"
        self.info = MethodInfo(name, title, f"another program, which wrote {path.name}", _REASONS)
        # By columns, here and below: numpy is ten times slower along rows of three.
        self.low, self.high = (
            np.array([f(column) for column in self.points.T]) for f in (np.min, np.max)
        )

    def begin(self, context: Context) -> None:
        """Build the search tree of the part of the map that lies near the sequence."""
        margin = _NEARBY + self.params.radius
        inside = np.ones(len(self.points), np.bool_)
        for column, low, high in zip(
            self.points.T, context.extent.low, context.extent.high, strict=True
        ):
            inside &= (column >= low - margin) & (column <= high + margin)
        self.points = np.compress(inside, self.points, 0)
        self._tree = Nearest(self.points)

    def label(self, scan: Scan) -> Labels:
        """Dynamic where no point of the map lies within the radius."""
        chosen = all_finite(scan.points)
        near = self._tree.within(np.compress(chosen, scan.points, 0), self.params.radius)
        reasons = np.full(len(scan), _NOT_FINITE, np.uint8)
        reasons[chosen] = np.where(near, _NEAR, _FAR)
        return Labels(reasons == _FAR, reasons)

    def distances(self, points: F32, limit: float) -> F32:
        """(N,) float32, metres from (N, 3) points to the map; infinite beyond the limit."""
        return self._tree.distance(points, limit)

    def nearby(self, points: F32) -> Bool:
        """(N,) bool: whether a point of the map lies within 1 m of each of (N, 3) points."""
        return self._tree.within(points, _NEARBY)


class PrecomputedLabels:
    """Labels from the ``labels.npz`` of a run, or of another program (format.

    ``dynaviz.engine.outputs.LabelsFile``).

    Raises:
        DataError: for a file in another format, or a damaged one.
    """

    scoring = "mask"

    def __init__(self, path: Path, name: str) -> None:
        self.path = path
        self.params = NoParams()
        self._labels = RunLabels.load(path)
        legend = self._labels.legend
        self._unanswered = legend.index(UNANSWERED) if UNANSWERED in legend else None
        self._positions = {
            number: position for position, number in enumerate(self._labels.frames.tolist())
        }
        reasons = tuple(Reason(reason, "from the labels file") for reason in legend)
        self.info = MethodInfo(
            name, f"{name} (labels)", f"another run, which wrote {path.name}", reasons
        )

    @property
    def frames(self) -> Collection[int]:
        """Numbers of the frames that have labels."""
        return self._positions.keys()

    def begin(self, context: Context) -> None:
        """Nothing to prepare."""

    def label(self, scan: Scan) -> Labels:
        """The labels in the file, by the scan's index.

        Raises:
            DataError: if the file has none for it.
        """
        position = self._positions.get(scan.index)
        if position is None:
            raise DataError(
                self.path, f"has no labels for frame {scan.index}", hint="Write or copy it again"
            )
        reasons = self._labels.reasons_of(position)
        answered = (
            self._unanswered is None or not len(reasons) or bool(reasons[0] != self._unanswered)
        )
        return Labels(self._labels[position], reasons, answered)

    def check(self, sequence: str, summary: SequenceSummary) -> None:
        """Raise DataError if the labels are from a different sequence than the one with this name
        and summary.
        """
        if summary.digest != (digest := self._labels.sequence_digest):
            problem = (
                f"is from a different sequence: the labels have the digest {digest[:12]}..., "
                f"the frames of {sequence} {summary.digest[:12]}..."
            )
            raise DataError(
                self.path,
                problem,
                hint="Give the sequence of that run, and the same --frames and --stride",
            )


External = ExternalMap | PrecomputedLabels | LabelFolder


def default_name(path: str | os.PathLike[str]) -> str:
    """Name for tables: of a file, its name without the suffix.

    Of a folder, its name or that of a folder above.

    Names that say nothing about the program are skipped: ``predictions``, ``sequences``, ``08``.
    """
    path = Path(path)
    if not path.is_dir():
        return path.stem
    names = [folder.name for folder in (path.resolve(), *path.resolve().parents)]
    return next(
        (name for name in names if name and name not in _GENERIC and not name.isdigit()), "labels"
    )


def read_external(
    path: str | os.PathLike[str],
    sequence: Drive,
    *,
    radius: float = RADIUS,
    name: str | None = None,
    key: str | None = None,
) -> External:
    """Read the output of another program.

    ``labels.npz`` or the folder of a run, label files of scans, or a map.

    Args:
        path: the file or folder.
        sequence: what it belongs to.
        radius: metres; for a map.
        name: for tables; by default that of ``default_name``.
        key: name of the array in ``.npz`` files of scans.

    Raises:
        UsageError: for an invalid radius or name, or a key for anything else.
        DataError: as ``ExternalMap``, ``PrecomputedLabels`` and ``LabelFolder``.
    """
    path = Path(path)
    name = default_name(path) if name is None else name
    if not name.isprintable() or not name.strip(".") or Path(name).name != name:
        raise UsageError(f"name = {name!r}: give a name that is valid for a folder")
    labels = path / "labels.npz" if path.is_dir() else path
    if path.is_dir() and not labels.is_file():
        return LabelFolder(path, name, sequence, key)
    if key is not None:
        raise UsageError(f"key = {key}: give it only for a folder of .npz files, one per scan")
    if labels.suffix.lower() == ".npz":
        return PrecomputedLabels(labels, name)
    return ExternalMap(path, name, radius, sequence.origin)
