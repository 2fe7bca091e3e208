"""What SeeThrough knows about one scan: measured from all scans so far, and judged by what moved."""

from __future__ import annotations

from dataclasses import dataclass

from dynaviz.arrays import F32, I32, I64, U8, Bool


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What the scans so far show of one of them, wherever objects moved.

    Attributes:
        index: number of the scan.
        points: (N, 3) float32, metres; voxels: (N,) int64, -1 for none; places: (N,) int64, quarter columns.
        height: (N,) float32, metres above the ground; infinite if unknown. low: (N,) bool, near the ground.
        objects: (N,) int32, the object of each point, -1 for none; n: their number.
        evidence: (6, n) int64, by object: points, voting points, sum of votes, points seen clear, points seen clear
            between two hits, points seen clear after the last hit.
    """

    index: int
    points: F32
    voxels: I64
    places: I64
    height: F32
    low: Bool
    objects: I32
    n: int
    evidence: I64


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What decided the labels of the scan that was judged last.

    Attributes:
        measured: the scan.
        weighed: (10, objects) int64: points, voting points, sum of votes, points seen clear, points where an object
            moved lately, scans in which that one moved, points where the last object moved, points seen clear between
            two hits, points seen clear after the last hit, points where something was before any object moved.
        verdict: (N,) uint8: why each point's object is dynamic, or that the point is in a settled part; 0 otherwise.
    """

    measured: Measured
    weighed: I64
    verdict: U8
