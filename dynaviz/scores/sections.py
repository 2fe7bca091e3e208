"""The typed parts of a result. They read and write the JSON of ``result.json``.

Unknown keys are ignored.

Percentages are None where undefined: without dynamic ground truth there is no DA, and so no AA and
no HA.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
from msgspec import Struct, field

from dynaviz.scores.failure_case import FailureCase, JoinedPoints
from dynaviz.scores.looks import Ceiling


class SequenceInfo(Struct, frozen=True):
    """What a run ran on; ``digest`` covers points, poses and labels of all frames."""

    name: str = ""
    digest: str = ""
    frames: int = 0
    points: int = 0
    at_sensor: int | None = (
        None  # points that the method did not see; None in results of earlier versions
    )


class Runtime(Struct, frozen=True):
    """Cost of the method alone, per frame; None where unknown, as for a map of another program."""

    mean_s: float | None = None
    std_s: float | None = None
    frames: int | None = None
    prepare_s: float | None = None  # before the first frame
    threads: int | None = None
    peak_rss_mb: float | None = None


class Machine(Struct, frozen=True):
    """Where a run took place."""

    system: str | None = None
    arch: str | None = None
    cores: int | None = None

    def __str__(self) -> str:
        return " ".join(
            str(value) for value in (self.system, self.arch, self.cores) if value is not None
        )


class Environment(Struct, frozen=True):
    """What may affect labels or speed.

    Package versions, the machine, the threading layer (None before any kernel).
    """

    versions: Mapping[str, str] = {}
    machine: Machine = Machine()
    threading_layer: str | None = None


class Source(Struct, frozen=True):
    """The file or folder of another program that was scored.

    The numbers of a map are None for labels.

    Attributes:
        static_within_1_m: percent of the static points with a point of the map within 1 m.
        remarks: what a user should know before trusting the scores, one line each.
        unanswered_frames, unanswered_points: positions in the run of frames without labels; their
            points, not scored.
    """

    file: str = ""
    sha256: str = ""
    points: int | None = None
    not_finite: int | None = None
    static_within_1_m: float | None = None
    remarks: tuple[str, ...] = ()
    unanswered_frames: tuple[int, ...] = ()
    unanswered_points: int = 0


class _Row(Struct, frozen=True, kw_only=True):
    """Points by ground truth and answer, with the accuracies in percent."""

    static_kept: int = 0
    static_removed: int = 0
    dynamic_removed: int = 0
    dynamic_kept: int = 0
    unlabelled: int = 0
    SA: float | None = None
    DA: float | None = None
    AA: float | None = None
    HA: float | None = None


class IntervalRow(_Row, frozen=True, kw_only=True):
    """An interval of range or height, metres; open ends are None."""

    low: float | None = field(name="from", default=None)
    high: float | None = field(name="to", default=None)


class FrameRow(_Row, frozen=True, kw_only=True):
    """A frame: its position in the run, and its number in the data set."""

    frame: int
    index: int


class ObjectRow(_Row, frozen=True, kw_only=True):
    """An object, by class and instance number.

    ``reasons``: wrongly kept points by reason, most frequent first; None in results of earlier
    versions.
    """

    class_: int | None = field(name="class", default=None)
    instance: int | None = None
    first_frame: int = 0
    last_frame: int = 0
    points: int = 0
    reasons: Mapping[str, int] | None = None


class Breakdown(Struct, frozen=True):
    """Scores by range from the sensor, height above ground, frame and object."""

    range: tuple[IntervalRow, ...] = ()
    height: tuple[IntervalRow, ...] = ()
    frame: tuple[FrameRow, ...] = ()
    object: tuple[ObjectRow, ...] = ()


class ErrorDistances(Struct, frozen=True):
    """Distances from wrong points to the nearest right ones.

    Percentiles in metres, and percent within a distance.
    """

    p10: float | None = None
    p50: float | None = None
    p90: float | None = None
    within_01: float | None = field(name="within_0.1", default=None)
    within_03: float | None = field(name="within_0.3", default=None)
    within_10: float | None = field(name="within_1.0", default=None)
    histogram: tuple[int, ...] | None = None
    count: int = 0


class CaseTotals(Struct, frozen=True):
    """Numbers of cases and of their points."""

    cases: int = 0
    points: int = 0

    def plus(self, cases: int, points: int) -> CaseTotals:
        """With further cases."""
        return CaseTotals(self.cases + cases, self.points + points)


class Failures(Struct, frozen=True):
    """Failure cases, costliest first; ``causes``: totals by kind and cause; ``others``.

    Cases that are not listed.
    """

    cases: tuple[FailureCase, ...] = ()
    causes: Mapping[str, Mapping[str, CaseTotals]] = {}
    others: CaseTotals = CaseTotals()


class RemovedInterval(Struct, frozen=True, kw_only=True):
    """Points and removed points in an interval of range, metres; the open end is None."""

    low: float | None = field(name="from", default=None)
    high: float | None = field(name="to", default=None)
    points: int = 0
    removed: int = 0


class RemovedFrame(Struct, frozen=True):
    """Points and removed points of a frame.

    Its position in the run, and its number in the data set.
    """

    frame: int
    index: int
    points: int = 0
    removed: int = 0


class RemovedCluster(JoinedPoints, frozen=True, kw_only=True):
    """Removed points that belong together, in a run without ground truth.

    Possibly right, possibly wrong.

    Attributes:
        kept_near: share of the points next to points that were kept, 0 to 1.
        suspicion: 0 (looks like a mover) to 1 (looks like a static surface); why: in words,
            strongest first.
        did: ``removed``, or of drives ``appeared`` or ``disappeared``; what: what it looks like;
            sentence: in words.
    """

    kept_near: float | None = None
    suspicion: float = 0.0
    why: tuple[str, ...] = ()
    did: str = "removed"
    what: str = ""
    sentence: str = ""


class Removals(Struct, frozen=True):
    """What a run removed, with or without ground truth.

    Attributes:
        points, removed: all points, and those that were removed.
        reasons: removed points by reason, most frequent first.
        range: by range from the sensor; frame: by frame.
        clusters: at most 100, most suspicious first; only for runs without ground truth.
        others: clusters that are not listed.
    """

    points: int = 0
    removed: int = 0
    reasons: Mapping[str, int] = {}
    range: tuple[RemovedInterval, ...] = ()
    frame: tuple[RemovedFrame, ...] = ()
    clusters: tuple[RemovedCluster, ...] = ()
    others: CaseTotals = CaseTotals()

    @property
    def percent(self) -> float | None:
        """Removed points in percent of all; None without points."""
        return 100.0 * self.removed / self.points if self.points else None


class ReasonCost(Struct, frozen=True):
    """Percentage points of SA and DA that the wrong points of a reason cost."""

    SA: float | None = None
    DA: float | None = None


class Reasons(Struct, frozen=True):
    """Points by reason for each outcome, most frequent first; costs; and the legend."""

    false_negative: Mapping[str, int] = {}
    false_positive: Mapping[str, int] = {}
    dynamic_removed: Mapping[str, int] = {}
    static_kept: Mapping[str, int] = {}
    cost: Mapping[str, ReasonCost] = {}
    legend: Mapping[str, str] = {}


class Voxelwise(Struct, frozen=True):
    """Preservation and rejection rate over voxels, percent; ``edge_m``: edge of a voxel.

    Numbers of voxels.
    """

    edge_m: float = 0.0
    PR: float | None = None
    RR: float | None = None
    F1: float | None = None
    static: int = 0
    static_kept: int = 0
    dynamic: int = 0
    dynamic_kept: int = 0


class TileRow(Struct, frozen=True):
    """The counts of a tile.

    Attributes:
        column, row: the tile spans [column, column + 1) * size_m in x, and the same with row in y.
        static_kept, static_removed, dynamic_removed, dynamic_kept: numbers of points, as in
            ``counts``.
        unlabelled_kept, unlabelled_removed: the same of points without ground truth.
    """

    column: int
    row: int
    static_kept: int = 0
    static_removed: int = 0
    dynamic_removed: int = 0
    dynamic_kept: int = 0
    unlabelled_kept: int = 0
    unlabelled_removed: int = 0


class Tiling(Struct, frozen=True):
    """How a run was divided.

    Attributes:
        size_m: edge of a tile; halo_m: distance around each within which points decided its labels.
        tiles: number of tiles with points.
        frames: frames that all tiles together have read, empty ones included.
        tile: counts of each tile.
    """

    size_m: float = 0.0
    halo_m: float = 0.0
    tiles: int = 0
    frames: int = 0
    tile: tuple[TileRow, ...] = ()


class ReviewSection(Struct, frozen=True):
    """What the decisions of a person did in a run; the labels of the run are its method's.

    Attributes:
        file: with the decisions, absolute; sha256: digest of the file.
        decisions, unmatched: how many hold, and how many of them match no point.
        kept, removed: points whose answer they change.
        metrics: SA, DA, AA and HA in percent of the answers with the decisions.
    """

    file: str
    sha256: str = ""
    decisions: int = 0
    unmatched: int = 0
    kept: int = 0
    removed: int = 0
    metrics: Mapping[str, float | None] = {}


class Sections(Struct, frozen=True, omit_defaults=True):
    """What the metrics found; None or empty where a metric did not run.

    Attributes:
        counts: points by ground truth and answer: static_kept, static_removed, dynamic_removed,
            dynamic_kept, unlabelled.
        metrics: SA, DA, AA, HA, precision and IoU in percent.
        error_distance: by kind of error.
        ceiling: what the drive showed of its moving objects, and what the method made of it.
        other: sections of metrics from other packages, as plain JSON values.
    """

    source: Source | None = None
    breakdown: Breakdown | None = None
    counts: Mapping[str, int] = {}
    metrics: Mapping[str, float | None] = {}
    error_distance: Mapping[str, ErrorDistances] = {}
    ceiling: Ceiling | None = None
    failures: Failures | None = None
    reasons: Reasons | None = None
    removals: Removals | None = None
    review: ReviewSection | None = None
    tiling: Tiling | None = None
    voxelwise: Voxelwise | None = None
    other: Mapping[str, Any] = {}

    @property
    def has_truth(self) -> bool:
        """Whether points are known to be right or wrong."""
        return self.metrics.get("SA") is not None or self.metrics.get("DA") is not None

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> Sections:
        """From plain JSON values, as metrics return them and ``result.json`` contains them.

        Raises:
            msgspec.ValidationError: for a value of the wrong type; the message names its place.
        """
        return cls().joined(plain)

    def joined(self, found: Mapping[str, Any]) -> Sections:
        """These sections and others, which replace those of the same name.

        Args:
            found: sections of this type, as ``Metric.finish`` returns them, or plain JSON values.

        Raises:
            msgspec.ValidationError: as ``of``.
        """
        names = {each.name for each in msgspec.structs.fields(Sections)} - {"other"}
        known = {key: value for key, value in found.items() if key in names}
        converted = msgspec.convert(known, Sections)
        other = {key: value for key, value in found.items() if key not in names}
        return msgspec.structs.replace(
            self,
            **{key: getattr(converted, key) for key in known},
            other={**self.other, **other},
        )

    def plain(self) -> dict[str, Any]:
        """Plain JSON values, the inverse of ``of``."""
        plain: dict[str, Any] = msgspec.to_builtins(self)
        return {**{key: value for key, value in plain.items() if key != "other"}, **self.other}


# the first conversion describes the type, which is not safe in several threads at once
msgspec.convert({}, Sections)
