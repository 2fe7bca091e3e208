"""The contract of a metric: it receives each labelled scan and adds its section to the result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from dynaviz.arrays import F32, F64, I64, U8, Bool
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.scan import Scan, outcomes


@dataclass(frozen=True, slots=True, eq=False)
class Labelled:
    """One scan with its labels.

    Attributes:
        frame: position in the run, 0, 1, ...; the recording's ``frame`` timeline.
        scan: the scan, with its ground truth if it has any.
        dynamic: (N,) bool, as in ``Labels``.
        reasons: (N,) uint8, the reason codes.
        outcome: (N,) uint8, an ``Outcome`` per point.
        answered: as in ``Labels``; if False, the scan has no ground truth here.
    """

    frame: int
    scan: Scan
    dynamic: Bool
    reasons: U8
    outcome: U8
    answered: bool = True

    @classmethod
    def of(
        cls, frame: int, scan: Scan, dynamic: Bool, reasons: U8, answered: bool = True
    ) -> Labelled:
        """Compare a scan's labels with its ground truth, unless there is no answer to compare."""
        scan = scan if answered else scan.unscored()
        return cls(frame, scan, dynamic, reasons, outcomes(scan.labels, dynamic), answered)


@dataclass(frozen=True, slots=True, eq=False)
class FrameHistograms:
    """A histogram per frame: edges (B + 1,) float64 and counts (frames, B) int64.

    The last bin is open.
    """

    title: str
    unit: str
    edges: F64
    counts: I64


@dataclass(frozen=True, slots=True, eq=False)
class CaseSample:
    """Some points of each of several cases.

    Attributes:
        case: (K,) int64: its case, 0 for the first; frames: (K,) int64, positions in the run.
        points: (K, 3) float32, metres, world frame.
    """

    case: I64
    frames: I64
    points: F32


@dataclass(frozen=True, slots=True, eq=False)
class FrameBoxes:
    """Cases located in the world, with a box in each of their frames.

    Attributes:
        labels: one line per case.
        outcomes: (C,) uint8, the ``Outcome`` of the points of each case.
        low, high: (C, 3) float32, metres, world frame: bounds of the case over all frames.
        frames: (B,) int64, case: (B,) int64: a box's frame, and its case.
        box_low, box_high: (B, 3) float32, metres, world frame.
        points: (B,) int64, points of the case in the frame; None if unknown.
        sample: some points of each case; None if unknown.
    """

    labels: tuple[str, ...]
    outcomes: U8
    low: F32
    high: F32
    frames: I64
    case: I64
    box_low: F32
    box_high: F32
    points: I64 | None = None
    sample: CaseSample | None = None


Figure = FrameHistograms | FrameBoxes


class Metric(Protocol):
    """Computes one or more sections of the result, in memory that does not grow with the number of
    points.

    Constructed for each run with the method's info. Two functions are optional: the static
    ``combine(sections)`` combines its sections of several sequences by adding counts (see
    ``Confusion``); ``cleaned_map(points)`` receives the map itself if the map of another program is
    scored (see ``Voxelwise``).
    """

    def __init__(self, info: MethodInfo) -> None: ...

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Add one scan; scans come in the order of frames.

        Returns:
            Values to plot over frames, by path (``"SA/frame"``); NaN where undefined.
        """
        ...

    def finish(self) -> Mapping[str, Any]:
        """The sections by name; called after the last frame.

        Each is of its type in ``dynaviz.scores.sections``, or, for a section that is not there,
        plain JSON values. None where undefined.
        """
        ...

    def figures(self) -> Mapping[str, Figure]:
        """Figures other than curves, by path; called after ``finish``. May be empty."""
        ...
