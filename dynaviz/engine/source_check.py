"""Checks of another program's output against the sequence, and the section ``source`` of the
result.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from dynaviz.arrays import F32, F64, all_finite
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Label
from dynaviz.engine.external import External, ExternalMap, PrecomputedLabels, TakesMap
from dynaviz.engine.label_folder import LabelFolder
from dynaviz.engine.loop import Listener, RunSpec
from dynaviz.io.atomic import open_file
from dynaviz.scores.sections import Source
from dynaviz.sources.summary import SequenceSummary

# percent of static points near the map, below which map and sequence are in different frames
_OTHER_FRAME = 1.0
_SAMPLE = 50  # use every N-th static point for that check
_KEPT = 20_000  # of these points that are kept for the checks below
_FEWEST = 1000  # of them, for these checks
_MISSED = 0.1  # share of them beyond the radius from which the reason is looked for
_HIGHEST = 4.0  # metres that a map may be too high or too low
_HEIGHTS = 0.1  # metres; steps of these heights
_FITS = 0.5  # share of the points that are in the map after it was moved
_BOXES = 20  # parts of the map in which the distance of its points is measured
_BOX = 2.0  # metres; half of their edge
_LISTED = 8  # numbers of unanswered frames in a remark, at most


class SourceCheck(Listener):
    """Checks that a file fits the sequence before anything is written, and reports on it in the
    section ``source``.

    Counts the frames that it does not answer.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._frames = 0
        self._unanswered: list[
            tuple[int, int, int]
        ] = []  # position in the run, number and points of a frame

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Count the frame."""
        self._frames += 1
        if not labelled.answered:
            self._unanswered.append((labelled.frame, labelled.scan.index, len(labelled.scan)))

    def sha256(self) -> str:
        """Digest of the file."""
        return _sha256(self._path)

    def section(self) -> Source:
        """File, digest, and the frames without an answer."""
        return Source(
            self._path.name,
            self.sha256(),
            remarks=tuple(self._remarks()),
            unanswered_frames=tuple(frame for frame, _, _ in self._unanswered),
            unanswered_points=sum(points for _, _, points in self._unanswered),
        )

    def sections(self) -> Mapping[str, Source]:
        """The section ``source`` of a result."""
        return {"source": self.section()}

    def _remarks(self) -> Iterator[str]:
        """What a user should know before trusting the scores."""
        if self._unanswered:
            numbers = ", ".join(str(index) for _, index, _ in self._unanswered[:_LISTED])
            rest = ", ..." if len(self._unanswered) > _LISTED else ""
            yield (
                f"{self._path.name}: has no labels for {len(self._unanswered):,} of "
                f"{self._frames:,} frames "
                f"({numbers}{rest}); their points are not scored"
            )


class LabelsCheck(SourceCheck):
    """Checks that the labels of a run are from the sequence."""

    def __init__(self, labels: PrecomputedLabels) -> None:
        super().__init__(labels.path)
        self._labels = labels

    def begin(self, run: RunSpec, summary: SequenceSummary) -> None:
        """Compare digests."""
        self._labels.check(run.sequence.name, summary)


class FolderCheck(SourceCheck):
    """Computes the digest of label files.

    That of the digests of all files used, in the order of frames.
    """

    def __init__(self, labels: LabelFolder) -> None:
        super().__init__(labels.path)
        self._labels = labels
        self._digest = hashlib.sha256()

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Add the file of the frame."""
        super().labelled(labelled, curves)
        if labelled.answered:
            self._digest.update(_sha256(self._labels.files[labelled.scan.index]).encode())

    def sha256(self) -> str:
        """Digest of the files."""
        return self._digest.hexdigest()


class MapCheck(SourceCheck):
    """Shows a map to the metrics that ask for it, and searches static points of the sequence in it.

    If hardly any has a point of the map nearby, the map is in another frame.
    """

    def __init__(self, map_: ExternalMap) -> None:
        super().__init__(map_.path)
        self._map = map_
        self._static = self._nearby = 0  # points
        self._sample: list[F32] = []
        self._sampled = 0

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
        static = labelled.scan.points[
            np.flatnonzero(labelled.scan.labels == Label.STATIC)[::_SAMPLE]
        ]
        static = static[all_finite(static)]
        self._static += len(static)
        self._nearby += int(self._map.nearby(static).sum())
        if self._sampled < _KEPT:
            self._sample.append(static)
            self._sampled += len(static)

    def section(self) -> Source:
        """File, digest, numbers of points, and remarks on anything unusual about the map."""
        share = 100 * self._nearby / self._static if self._static else None
        remarks = tuple(self._map_remarks(share))
        return Source(
            self._path.name, self.sha256(), self._map.total, self._map.not_finite, share, remarks
        )

    def _map_remarks(self, share: float | None) -> Iterator[str]:
        name = self._path.name
        total = self._map.total
        if dropped := self._map.not_finite:
            yield f"{name}: {dropped:,} of {total:,} points are not finite and are ignored"
        if share is not None and share < _OTHER_FRAME:
            map_ = _bounds(self._map.low, self._map.high)
            sequence = _bounds(self._extent.low, self._extent.high)
            yield (
                f"{name}: only {share:.2g} % of the static points have a point of the map within 1 "
                "m, so it is "
                f"probably in another frame. The map spans {map_}; the sequence {sequence}. "
                "Write the map in metres, in the world frame of the sequence"
            )
        elif self._sampled >= _FEWEST:
            points = np.concatenate(self._sample)
            if why := _moved(self._map, points) or _thinned(self._map, points):
                yield f"{name}: {why}"


def _moved(map_: ExternalMap, points: F32) -> str:
    """That a map is too high or too low, in words; empty if it is not.

    Args:
        map_: the map.
        points: (N, 3) float32, metres: static points of the sequence.
    """
    missed = map_.distances(points, map_.params.radius) > map_.params.radius
    if missed.mean() < _MISSED:
        return ""
    points = points[:: 1 + len(points) // 3000]
    near = 2 * _HEIGHTS

    def cost(height: float) -> float:
        """Mean distance of points of the moved map, metres, at most ``near``."""
        raised = points + np.array([0.0, 0.0, height], np.float32)
        return float(np.minimum(map_.distances(raised, near), near).mean())

    coarse = np.arange(-_HIGHEST, _HIGHEST + 1e-9, _HEIGHTS).tolist()
    best = min(coarse, key=cost)
    fine = (best + np.arange(-_HEIGHTS, _HEIGHTS + 1e-9, 0.01)).tolist()
    best = min(fine, key=cost)
    if abs(best) < _HEIGHTS or cost(best) > _FITS * cost(0.0):
        return ""
    word = "higher" if best > 0 else "lower"
    change = "Subtract" if best > 0 else "Add"
    return (
        f"is {abs(best):.2f} m {word} than the sequence: moved so, its points lie "
        f"{100 * cost(best):.0f} cm from static ones instead of {100 * cost(0.0):.0f}. {change} it "
        "in z, or give the poses with which the map was made"
    )


def _thinned(map_: ExternalMap, points: F32) -> str:
    """That points of a map are farther apart than the radius, in words; empty if they are not.

    Arguments as of ``_moved``.
    """
    radius = map_.params.radius
    apart = _spacing(map_.points)
    distances = map_.distances(points, 3 * apart)
    missed = distances > radius
    filled = missed & (distances < 3 * apart)
    if apart < radius or missed.mean() < _MISSED or filled.mean() < 0.5 * missed.mean():
        return ""
    enough = float(np.percentile(distances[distances < 3 * apart], 99))
    return (
        f"its points are {apart:.2f} m apart, as if it was thinned, but the radius is {radius:g} "
        f"m: {filled.mean():.0%} of the static points count as removed for that alone. Give "
        f"--radius {np.ceil(100 * enough) / 100:g}, or the map before it was thinned"
    )


def _spacing(points: F32) -> float:
    """Metres from a point of a map to the next one, median over some parts of it."""
    from scipy.spatial import cKDTree

    random = np.random.default_rng(0)
    found = []
    for centre in points[random.integers(0, len(points), _BOXES)]:
        inside = np.ones(len(points), np.bool_)
        for column, at in zip(points.T, centre, strict=True):
            inside &= np.abs(column - at) < _BOX
        part = np.compress(inside, points, 0)
        if len(part) > 1:
            apart = np.asarray(cKDTree(part).query(part, [2])[0])  # 1 is the point itself
            found.append(float(np.median(apart)))
    return float(np.median(found)) if found else 0.0


def source_check(external: External) -> SourceCheck:
    """The check of a map or of labels."""
    if isinstance(external, LabelFolder):
        return FolderCheck(external)
    return LabelsCheck(external) if isinstance(external, PrecomputedLabels) else MapCheck(external)


def _sha256(path: Path) -> str:
    with open_file(path, "Give a file") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]


def _bounds(low: F64, high: F64) -> str:
    return (
        " x ".join(f"{a:.4g}..{b:.4g}" for a, b in zip(low.tolist(), high.tolist(), strict=True))
        + " m"
    )
