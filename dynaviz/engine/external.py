"""Labels from other programs: a cleaned map, or the labels of an earlier run, scored and recorded like any method.

A cleaned map contains points, not labels: a point of the sequence counts as removed if the nearest point of the map is
farther than a radius (scoring ``nn``, the rule of the public benchmark). Labels of a run are looked up by index
(scoring ``mask``).
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from dynaviz.arrays import F32, F64, Bool
from dynaviz.engine.loop import Listener, RunSpec
from dynaviz.engine.summary import SequenceSummary
from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import open_file
from dynaviz.io.npy import open_npy
from dynaviz.io.points import read_points
from dynaviz.method import Context, Labels, MethodInfo, Reason
from dynaviz.metric import Labelled
from dynaviz.results.sections import Source
from dynaviz.scan import Label, Scan
from dynaviz.spatial.nearest import Nearest

RADIUS = 0.05  # metres: that of the public benchmark, half of its 0.1 m voxel

_NEAR, _FAR, _NOT_FINITE = range(3)
_REASONS = (
    Reason("near_kept_point", "kept: a point of the map lies within the radius"),
    Reason("no_kept_point_within_radius", "removed: no point of the map lies within the radius"),
    Reason("not_finite", "kept: no finite coordinates, so no map can contain it"),
)
_NEARBY = 1.0  # metres
_OTHER_FRAME = 1.0  # percent of static points near the map, below which map and sequence are in different frames
_SAMPLE = 50  # use every N-th static point for that check


@runtime_checkable
class TakesMap(Protocol):
    """A metric that looks at a cleaned map itself, in addition to the labels that follow from it."""

    def cleaned_map(self, points: F32) -> None:
        """The map's points, (M, 3) float32, metres, world frame; finite. Called once, before the first scan."""
        ...


@dataclass(frozen=True)
class MapParams:
    """Parameters of the scoring; those of the program that wrote the map are unknown.

    Attributes:
        radius: metres; a point this far from the map still counts as kept.
    """

    radius: float = RADIUS


@dataclass(frozen=True)
class NoParams:
    """Labels by index have no parameters."""


class ExternalMap:
    """A map cleaned by another program, as a labeller.

    Args:
        path: the map (``dynaviz.io.points.read_points``), in the world frame of the sequence.
        name: for tables.
        radius: metres, 0 or more.

    Raises:
        UsageError: for an invalid radius.
        DataError: for a file that cannot be read, or contains no finite point.
    """

    scoring = "nn"

    def __init__(self, path: Path, name: str, radius: float = RADIUS) -> None:
        if not 0 <= radius < np.inf:
            raise UsageError(f"radius = {radius}: give metres, 0 or more; the public benchmark uses {RADIUS}")
        points = read_points(path)
        finite = _finite(points)
        self.path, self.points, self.params = path, np.compress(finite, points, 0), MapParams(radius)
        self.total, self.not_finite = len(points), len(points) - len(self.points)
        if not len(self.points):
            problem = "contains no points" if not len(points) else "contains no point with finite coordinates"
            raise DataError(path, problem, hint="A cleaned map contains the static points: check its program's output")
        title = f"{name} (a map, within {radius:g} m)"
        self.info = MethodInfo(name, title, f"another program, which wrote {path.name}", _REASONS)
        # By columns, here and below: numpy is ten times slower along rows of three.
        self.low, self.high = (np.array([f(column) for column in self.points.T]) for f in (np.min, np.max))

    def begin(self, context: Context) -> None:
        """Build the search tree of the part of the map that lies near the sequence."""
        margin = _NEARBY + self.params.radius
        inside = np.ones(len(self.points), np.bool_)
        for column, low, high in zip(self.points.T, context.extent.low, context.extent.high, strict=True):
            inside &= (column >= low - margin) & (column <= high + margin)
        self.points = np.compress(inside, self.points, 0)
        self._tree = Nearest(self.points)

    def label(self, scan: Scan) -> Labels:
        """Dynamic where no point of the map lies within the radius."""
        finite = _finite(scan.points)
        near = self._tree.within(np.compress(finite, scan.points, 0), self.params.radius)
        reasons = np.full(len(scan), _NOT_FINITE, np.uint8)
        reasons[finite] = np.where(near, _NEAR, _FAR)
        return Labels(reasons == _FAR, reasons)

    def nearby(self, points: F32) -> Bool:
        """(N,) bool: whether a point of the map lies within 1 m of each of (N, 3) points."""
        return self._tree.within(points, _NEARBY)


class PrecomputedLabels:
    """Labels from the ``labels.npz`` of a run, or of another program (format: ``dynaviz.engine.outputs.LabelsFile``).

    Raises:
        DataError: for a file in another format, or a damaged one.
    """

    scoring = "mask"

    def __init__(self, path: Path, name: str) -> None:
        self.path, self.params = path, NoParams()
        with open_npy(path, "labels.npz of a run", "Give that file, or a cleaned map") as z:
            for key, kinds in (("points", "iu"), ("frames", "iu"), ("dynamic", "u"), ("reasons", "u")):
                if z[key].ndim != 1 or z[key].dtype.kind not in kinds or (kinds == "u" and z[key].dtype != np.uint8):
                    raise ValueError(f"{key} is an array {z[key].shape} of {z[key].dtype}")
            points, frames = z["points"].astype(np.int64), z["frames"].tolist()
            self._dynamic, self._reasons, self._digest = z["dynamic"], z["reasons"], str(z["sequence_digest"])
            legend = [str(reason) for reason in z["reason_names"]]
            ends = np.cumsum(points)
            rows = zip(frames, points.tolist(), ends.tolist(), strict=True)
            self._rows = {index: (end - n, end) for index, n, end in rows}
        total = int(points.sum())
        if (
            (points < 0).any()
            or len(self._reasons) != total
            or len(self._dynamic) != -(-total // 8)
            or len(self._rows) != len(points)
        ):
            raise DataError(path, "is inconsistent: its arrays have different lengths", hint="Write or copy it again")
        reasons = tuple(Reason(reason, "from the labels file") for reason in legend)
        self.info = MethodInfo(name, f"{name} (labels)", f"another run, which wrote {path.name}", reasons)

    def begin(self, context: Context) -> None:
        """Nothing to prepare."""

    def label(self, scan: Scan) -> Labels:
        """The labels in the file, by the scan's index.

        Raises:
            DataError: if the file has none for it.
        """
        if scan.index not in self._rows:
            raise DataError(self.path, f"has no labels for frame {scan.index}", hint="Write or copy it again")
        first, end = self._rows[scan.index]
        bits = np.unpackbits(self._dynamic[first // 8 : -(-end // 8)])
        return Labels(bits[first % 8 : first % 8 + end - first].astype(np.bool_), self._reasons[first:end])

    def check(self, sequence: str, summary: SequenceSummary) -> None:
        """Raise DataError if the labels are from a different sequence than the one with this name and summary."""
        if summary.digest != self._digest:
            problem = (
                f"is from a different sequence: the labels have the digest {self._digest[:12]}..., "
                f"the frames of {sequence} {summary.digest[:12]}..."
            )
            raise DataError(
                self.path, problem, hint="Give the sequence of that run, and the same --frames and --stride"
            )


External = ExternalMap | PrecomputedLabels


def read_external(path: str | os.PathLike[str], radius: float = RADIUS, name: str | None = None) -> External:
    """Read the output of another program: ``labels.npz``, or else a map.

    Args:
        path: the file.
        radius: metres; for a map.
        name: for tables; by default the file's name without its suffix.

    Raises:
        UsageError: for an invalid radius or name.
        DataError: as ``ExternalMap`` and ``PrecomputedLabels``.
    """
    path = Path(path)
    name = path.stem if name is None else name
    if not name.isprintable() or not name.strip(".") or Path(name).name != name:
        raise UsageError(f"name = {name!r}: give a name that is valid for a folder")
    return PrecomputedLabels(path, name) if path.suffix.lower() == ".npz" else ExternalMap(path, name, radius)


class SourceCheck(Listener):
    """Checks that a file fits the sequence before anything is written, and reports on it in the section ``source``."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with open_file(path, "Give a file") as file:
            self._sha256 = hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]

    def section(self) -> Source:
        """File and digest."""
        return Source(self._path.name, self._sha256)


class LabelsCheck(SourceCheck):
    """Checks that labels are from the sequence of the run."""

    def __init__(self, labels: PrecomputedLabels) -> None:
        super().__init__(labels.path)
        self._labels = labels

    def begin(self, run: RunSpec, summary: SequenceSummary) -> None:
        """Compare digests."""
        self._labels.check(run.sequence.name, summary)


class MapCheck(SourceCheck):
    """Shows a map to the metrics that ask for it, and searches static points of the sequence in it.

    If hardly any has a point of the map nearby, the map is in another frame.
    """

    def __init__(self, map_: ExternalMap) -> None:
        super().__init__(map_.path)
        self._map = map_
        self._static = self._nearby = 0  # points

    def begin(self, run: RunSpec, summary: SequenceSummary) -> None:
        """Show the map to the metrics."""
        self._extent = summary.extent
        for metric in run.metrics:
            if isinstance(metric, TakesMap):
                metric.cleaned_map(self._map.points)

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Search some static points of the scan in the map."""
        if labelled.scan.labels is None:
            return
        static = labelled.scan.points[np.flatnonzero(labelled.scan.labels == Label.STATIC)[::_SAMPLE]]
        static = static[_finite(static)]
        self._static += len(static)
        self._nearby += int(self._map.nearby(static).sum())

    def section(self) -> Source:
        """File, digest, numbers of points, and remarks on anything unusual about the map."""
        share = 100 * self._nearby / self._static if self._static else None
        remarks = tuple(self._remarks(share))
        return Source(self._path.name, self._sha256, self._map.total, self._map.not_finite, share, remarks)

    def _remarks(self, share: float | None) -> Iterator[str]:
        """What a user should know before trusting the scores."""
        name, total = self._path.name, self._map.total
        if dropped := self._map.not_finite:
            yield f"{name}: {dropped:,} of {total:,} points are not finite and are ignored"
        if share is not None and share < _OTHER_FRAME:
            map_, sequence = _bounds(self._map.low, self._map.high), _bounds(self._extent.low, self._extent.high)
            yield (
                f"{name}: only {share:.2g} % of the static points have a point of the map within 1 m, so it is "
                f"probably in another frame. The map spans {map_}; the sequence {sequence}. "
                "Write the map in metres, in the world frame of the sequence"
            )


def source_check(external: External) -> SourceCheck:
    """The check of a map or of labels."""
    return LabelsCheck(external) if isinstance(external, PrecomputedLabels) else MapCheck(external)


def _finite(points: F32) -> Bool:
    """(N,) bool: which of (N, 3) points are finite."""
    x, y, z = np.isfinite(points).T
    finite: Bool = x & y & z
    return finite


def _bounds(low: F64, high: F64) -> str:
    return " x ".join(f"{a:.4g}..{b:.4g}" for a, b in zip(low.tolist(), high.tolist(), strict=True)) + " m"
