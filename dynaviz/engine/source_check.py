"""Checks of another program's output against the sequence, and the section ``source`` of the
result.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from dynaviz.arrays import F64, all_finite
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
