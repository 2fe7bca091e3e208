"""What SeeThrough knows about one scan: measured from all scans so far, and judged by what moved."""

from __future__ import annotations

from dataclasses import dataclass

from dynaviz.arrays import F32, F64, I32, I64, Bool


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What the scans so far show of one of them, wherever objects moved.

    Attributes:
        index: number of the scan.
        points: (N, 3) float32, metres; voxels: (N,) int64, -1 for none; places: (N,) int64, quarter columns.
        height: (N,) float32, metres above the ground; infinite if unknown.
        objects: (N,) int32, the object of each point, -1 for none; n: their number.
        evidence: (6, n) int64, by object: points, voting points, sum of votes, points seen clear, points seen clear
            between two hits, points seen clear after the last hit.
        counts: (3, N) int32, number of scans that hit, passed and saw clear each point's voxel.
    """

    index: int
    points: F32
    voxels: I64
    places: I64
    height: F32
    objects: I32
    n: int
    evidence: tuple[I64, I64, I64, I64, I64, I64]
    counts: tuple[I32, I32, I32]


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What decided the labels of the scan that was judged last.

    Attributes:
        index: number of the scan.
        height: (N,) float32, metres above the ground, of each point; infinite if unknown.
        objects: (N,) int32, the object of each point, -1 for none.
        weighed: (10, objects) float64: points, voting points, sum of votes, points seen clear, points where an object
            moved lately, scans in which that one moved, points where the last object moved, points seen clear between
            two hits, points seen clear after the last hit, points where something was before any object moved.
        settled: (N,) bool, in a settled part of a dynamic object.
        under: (N,) bool, low and in or next to a dynamic object.
        level: (N,) float32, metres: height of this scan's low points around each point.
    """

    index: int
    height: F32
    objects: I32
    weighed: F64
    settled: Bool
    under: Bool
    level: F32
