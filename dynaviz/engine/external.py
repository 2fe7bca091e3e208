"""What other programs wrote, in the shape of a method, so that the loop scores, records and explains it like any run.

A cleaned map holds points, not labels: a point of the sequence counts as removed if the nearest point of the map is
farther than a radius (``nn``, the rule of the public benchmark). Labels of a run answer by index (``mask``).
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from dynaviz.arrays import F32, U8, Bool
from dynaviz.engine.loop import Listener, RunSpec
from dynaviz.engine.summary import SequenceSummary
from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import open_file
from dynaviz.io.npy import open_npy
from dynaviz.io.points import read_points
from dynaviz.method import Context, MethodInfo, Reason
from dynaviz.metric import Figure, Labelled
from dynaviz.scan import Label, Scan
from dynaviz.spatial.nearest import Nearest

RADIUS = 0.05  # metres: that of the public benchmark, half of its 0.1 m voxel

_NEAR, _FAR, _NOWHERE = range(3)
_REASONS = (
    Reason("near_kept_point", "kept: a point of the map lies within the radius"),
    Reason("no_kept_point_within_radius", "removed: no point of the map lies within the radius"),
    Reason("not_finite", "kept: it has no finite coordinates, so no map can hold it"),
)
_NEARBY = 1.0  # metres
_ALIEN = 1.0  # percent of static points near the map, below which map and sequence do not belong together
_SAMPLE = 50  # every which static point is asked for that


@runtime_checkable
class TakesMap(Protocol):
    """A metric that looks at a cleaned map itself, beside the labels that follow from it."""

    def cleaned_map(self, points: F32) -> None:
        """The map's points, (M, 3) float32, metres, world frame; finite. Called once, before the first scan."""
        ...


@dataclass(frozen=True)
class MapParams:
    """The scoring's parameters; those of the program that wrote the map are unknown.

    Attributes:
        radius: metres; a point that far from the map still counts as kept.
    """

    radius: float = RADIUS


@dataclass(frozen=True)
class NoParams:
    """Labels by index need none."""


class ExternalLabeller:
    """What both kinds share; all but the answers. Subclasses are methods (``dynaviz.method.Method``).

    Attributes:
        path: the file.
        scoring: how its answers come about, ``nn`` or ``mask``.
        info: what a method tells of itself.
        params: the scoring's.
        facts: for the section ``source``.
    """

    path: Path
    scoring: str
    info: MethodInfo
    params: Any
    facts: dict[str, Any]

    def begin(self, context: Context) -> None:
        """Nothing to prepare."""

    def observe(self, scan: Scan) -> None:
        """Nothing is learnt from scans."""

    def check(self, sequence: str, seen: SequenceSummary) -> None:
        """Before anything is written: whether it fits the sequence of this name."""

    def compare(self, scan: Scan) -> None:
        """Look at a scan with its ground truth, to remark on it."""

    def remarks(self) -> list[str]:
        """What a user should know before believing the scores; a line each."""
        return []


class ExternalMap(ExternalLabeller):
    """A map that another program cleaned, as a method: it answers for a point by what is left near it.

    Args:
        path: the map (``dynaviz.io.points.read_points``), in the world frame of the sequence.
        name: for tables.
        radius: metres, 0 or more.

    Raises:
        UsageError: for a radius that is none.
        DataError: for a file that cannot be read, or has no finite point.
    """

    scoring = "nn"

    def __init__(self, path: Path, name: str, radius: float = RADIUS) -> None:
        if not 0 <= radius < np.inf:
            raise UsageError(f"radius = {radius}: give metres, 0 or more; the public benchmark's is {RADIUS}")
        points = read_points(path)
        finite = _finite(points)
        self.path, self.points, self.params = path, np.compress(finite, points, 0), MapParams(radius)
        self.facts = {
            "points": len(points),
            "not_finite": len(points) - len(self.points),
            "static_within_1_m": None,
        }
        if not len(self.points):
            problem = "has no point" if not len(points) else "has no point with finite coordinates"
            raise DataError(path, problem, hint="A cleaned map holds what stands still: see what its program printed")
        title = f"{name} (a map, within {radius:g} m)"
        self.info = MethodInfo(name, title, f"another program, which wrote {path.name}", _REASONS)
        # By columns, here and below, for numpy is ten times slower along rows of three.
        self._low, self._high = (np.array([f(column) for column in self.points.T]) for f in (np.min, np.max))
        self._last: tuple[Scan, U8] | None = None
        self._sampled = self._found = 0

    def begin(self, context: Context) -> None:
        """Build the tree of what can matter to this sequence."""
        self._extent, margin = context.extent, _NEARBY + self.params.radius
        inside = np.ones(len(self.points), np.bool_)
        for column, low, high in zip(self.points.T, context.extent.low, context.extent.high, strict=True):
            inside &= (column >= low - margin) & (column <= high + margin)
        self.points = np.compress(inside, self.points, 0)
        self.tree = Nearest(self.points)

    def label(self, scan: Scan) -> Bool:
        """(N,) bool: True where no point of the map lies within the radius."""
        removed: Bool = self.explain(scan) == _FAR
        return removed

    def explain(self, scan: Scan) -> U8:
        """(N,) uint8: the reasons' codes."""
        if self._last is None or self._last[0] is not scan:
            finite = _finite(scan.points)
            near = self.tree.within(np.compress(finite, scan.points, 0), self.params.radius)
            codes = np.full(len(scan), _NOWHERE, np.uint8)
            codes[finite] = np.where(near, _NEAR, _FAR)
            self._last = scan, codes
        return self._last[1]

    def compare(self, scan: Scan) -> None:
        """Note how many of some static points lie near the map."""
        if scan.labels is not None:
            static = scan.points[np.flatnonzero(scan.labels == Label.STATIC)[::_SAMPLE]]
            static = static[_finite(static)]
            self._sampled += len(static)
            self._found += int(self.tree.within(static, _NEARBY).sum())
            self.facts["static_within_1_m"] = 100 * self._found / self._sampled if self._sampled else None

    def remarks(self) -> list[str]:
        """What a user should know before believing the scores; a line each."""
        said = []
        if dropped := self.facts["not_finite"]:
            said.append(f"{self.path.name}: {dropped:,} of {self.facts['points']:,} points are not finite and left out")
        share = self.facts["static_within_1_m"]
        if share is not None and share < _ALIEN:
            map_, sequence = _spans(self._low, self._high), _spans(self._extent.low, self._extent.high)
            said.append(
                f"{self.path.name}: only {share:.2g} % of the static points have a point of the map within 1 m, so it "
                f"seems to lie in another frame. It spans {map_}; the sequence {sequence}. "
                "Write the map in metres, in the world frame of the sequence"
            )
        return said


class PrecomputedLabels(ExternalLabeller):
    """Labels from the ``labels.npz`` of a run, or of another program (format: ``dynaviz.engine.outputs.LabelsFile``).

    Raises:
        DataError: for a file that is none, or is damaged.
    """

    scoring = "mask"

    def __init__(self, path: Path, name: str) -> None:
        self.path, self.params, self.facts = path, NoParams(), dict[str, Any]()
        with open_npy(path, "labels.npz of a run", "Give that file, or a cleaned map") as z:
            points, frames = z["points"].astype(np.int64), z["frames"].tolist()
            self._dynamic, self._reasons, self._digest = z["dynamic"], z["reasons"], str(z["sequence_digest"])
            legend = [str(reason) for reason in z["reason_names"]]
            ends = np.cumsum(points)
            rows = zip(frames, points.tolist(), ends.tolist(), strict=True)
            self._rows = {index: (end - n, end) for index, n, end in rows}
        total = int(points.sum())
        if len(self._reasons) != total or len(self._dynamic) != -(-total // 8) or len(self._rows) != len(points):
            raise DataError(path, "holds parts that do not fit together", hint="Write or copy the file again")
        reasons = tuple(Reason(reason, "as told by the labels") for reason in legend)
        self.info = MethodInfo(name, f"{name} (labels)", f"another run, which wrote {path.name}", reasons)

    def label(self, scan: Scan) -> Bool:
        """(N,) bool: as the file tells."""
        first, end = self._rows[scan.index]
        bits = np.unpackbits(self._dynamic[first // 8 : -(-end // 8)])
        return bits[first % 8 : first % 8 + end - first].astype(np.bool_)

    def explain(self, scan: Scan) -> U8:
        """(N,) uint8: as the file tells."""
        first, end = self._rows[scan.index]
        codes: U8 = self._reasons[first:end]
        return codes

    def check(self, sequence: str, seen: SequenceSummary) -> None:
        """Refuse a sequence that the labels do not belong to."""
        if seen.digest != self._digest:
            problem = (
                f"belongs to other data: the labels have the digest {self._digest[:12]}..., "
                f"the frames of {sequence} {seen.digest[:12]}..."
            )
            raise DataError(
                self.path, problem, hint="Give the sequence of that run, and the same --frames and --stride"
            )


def read_external(path: str | os.PathLike[str], radius: float = RADIUS, name: str | None = None) -> ExternalLabeller:
    """Read what another program wrote: ``labels.npz``, or else a map.

    Args:
        path: the file.
        radius: metres; for a map.
        name: for tables; the file's without its suffix by default.

    Raises:
        UsageError: for a radius or a name that is none.
        DataError: as ``ExternalMap`` and ``PrecomputedLabels``.
    """
    path = Path(path)
    name = path.stem if name is None else name
    if not name.isprintable() or not name.strip(".") or Path(name).name != name:
        raise UsageError(f"name = {name!r}: give one that a folder can have")
    return PrecomputedLabels(path, name) if path.suffix.lower() == ".npz" else ExternalMap(path, name, radius)


class SourceCheck:
    """Section ``source``: the file that was scored, its digest, and what is remarkable about it."""

    def __init__(self, read_external: ExternalLabeller) -> None:
        self._given = read_external
        with open_file(read_external.path, "Give a file") as file:
            self._sha256 = hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Compare one scan with it."""
        self._given.compare(labelled.scan)
        return {}

    def finish(self) -> Mapping[str, Any]:
        """The section."""
        facts = {"file": self._given.path.name, "sha256": self._sha256, **self._given.facts}
        return {"source": {**facts, "remarks": self._given.remarks()}}

    def figures(self) -> Mapping[str, Figure]:
        """None."""
        return {}


class ValidateInput(Listener):
    """Asks whether what was given fits the sequence, and hands a map to the metrics; goes before all that write."""

    def __init__(self, read_external: ExternalLabeller) -> None:
        self._given = read_external

    def begin(self, run: RunSpec, summary: SequenceSummary) -> None:
        """Ask, and hand over."""
        self._given.check(run.sequence.name, summary)
        if isinstance(self._given, ExternalMap):
            for metric in run.metrics:
                if isinstance(metric, TakesMap):
                    metric.cleaned_map(self._given.points)


def _finite(points: F32) -> Bool:
    """(N,) bool: which of (N, 3) points are finite."""
    x, y, z = np.isfinite(points).T
    finite: Bool = x & y & z
    return finite


def _spans(low: Any, high: Any) -> str:
    return " x ".join(f"{a:.4g}..{b:.4g}" for a, b in zip(low.tolist(), high.tolist(), strict=True)) + " m"
