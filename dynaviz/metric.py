"""The contract of a metric: it watches labelled scans go by and adds its section to the result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from dynaviz.arrays import F32, F64, I64, U8, Bool
from dynaviz.method import MethodInfo
from dynaviz.scan import Scan, outcomes


@dataclass(frozen=True, slots=True, eq=False)
class Labelled:
    """One scan with a method's answer.

    Attributes:
        frame: position in the run, 0, 1, ...; the recording's ``frame`` timeline.
        scan: the scan, with its ground truth where there is any.
        dynamic: (N,) bool, the method's answer.
        reasons: (N,) uint8, the method's reason codes.
        outcome: (N,) uint8, an ``Outcome`` per point.
    """

    frame: int
    scan: Scan
    dynamic: Bool
    reasons: U8
    outcome: U8

    @classmethod
    def of(cls, frame: int, scan: Scan, dynamic: Bool, reasons: U8) -> Labelled:
        """Cross the answer with the scan's ground truth."""
        return cls(frame, scan, dynamic, reasons, outcomes(scan.labels, dynamic))


@dataclass(frozen=True, slots=True, eq=False)
class FrameHistograms:
    """A histogram for each frame: edges (B + 1,) float64 and counts (frames, B) int64. The last bin is open."""

    title: str
    unit: str
    edges: F64
    counts: I64


@dataclass(frozen=True, slots=True, eq=False)
class FrameBoxes:
    """Cases that have a place in the world, and a box in each of their frames.

    Attributes:
        labels: a line for each case.
        outcomes: (C,) uint8, the ``Outcome`` of the points of each case.
        low, high: (C, 3) float32, metres, world frame: all that a case ever covers.
        frames: (B,) int64, case: (B,) int64: a box's frame, and its case.
        box_low, box_high: (B, 3) float32, metres, world frame.
    """

    labels: tuple[str, ...]
    outcomes: U8
    low: F32
    high: F32
    frames: I64
    case: I64
    box_low: F32
    box_high: F32


Figure = FrameHistograms | FrameBoxes


class Metric(Protocol):
    """Counts what happens to the points of a run, in memory that does not grow with their number.

    Constructed anew for each run with the method's info. Two more functions are optional: ``combine(sections)``,
    static, gives its sections of runs on several sequences as one, by adding counts (see ``Confusion``); and
    ``cleaned_map(points)`` is shown the map itself, where one is scored that another program wrote (see ``Voxelwise``).
    """

    def __init__(self, info: MethodInfo) -> None: ...

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Take one scan into account, in the order of frames.

        Returns:
            Numbers to draw as curves over frames, by path (``"SA/frame"``); NaN where undefined.
        """
        ...

    def finish(self) -> Mapping[str, Any]:
        """Sections of the result, as plain JSON values (None where undefined), once all frames were seen."""
        ...

    def figures(self) -> Mapping[str, Figure]:
        """What to draw besides curves, by path, known only at the end; empty where the metric has none."""
        ...
