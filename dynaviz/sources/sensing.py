"""Estimate the facts of an unknown sensor from its scans.

Height, rows, field of view, range and rate.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynaviz.arrays import F64, Intp
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import UsageError, addressed
from dynaviz.sources.drive import Drive
from dynaviz.spatial.motion import smoothed
from dynaviz.spatial.sensor_height import sensor_height
from dynaviz.spatial.trajectory import Trajectory

ESTIMATED = ("height", "rings", "elevation", "max_range", "rate", "points_per_sweep")
SAMPLES = 7  # scans that are looked at
RINGS = ("ring", "channel", "laser_number")  # attributes with the row of a point
BIN = 0.01  # degrees; of the histogram of elevations
FEW = 0.02  # share of the median row: fewer points are not a row
MOST_ROWS = 300
BEYOND = 20.0  # metres; range at which lasers 0.2 m apart differ by 0.6 degrees
AROUND_SCAN = 2  # scans before and after a scan that show how the sensor moves
PARALLAX = 4.0  # degrees; by which lasers 0.2 m apart differ at 3 m
TICK = 100_000  # nanoseconds; a vehicle that turns by 60 degrees per second turns by 0.006 degrees
# metres between the starts of two rays of one lidar; lidars on a vehicle
SAME_PLACE = 0.03
MOST_LIDARS = 8
UPRIGHT = 0.98  # cosine between the third axes of an upright sensor and the world, at least
FEWEST_RAYS = 0.05  # share of the rays that a lidar has at least


@dataclass(frozen=True)
class ScanRays:
    """The rays of some scans in the sensor frame.

    Attributes:
        ends: (N, 3) float64, metres: points as seen from the origins of their rays.
        ranges, elevations, azimuths: (N,) float64, metres and degrees.
        lidars: (N,) int: number of the lidar that measured the point, if several were merged into
            one scan; from the places on the vehicle where rays start.
    """

    ends: F64
    ranges: F64
    elevations: F64
    azimuths: F64
    lidars: Intp

    @classmethod
    def of(cls, scan: Scan, path: Trajectory | None = None) -> ScanRays:
        """The rays of the finite points of a scan, in their order.

        Args:
            scan: the scan.
            path: poses of the sensor during the scan by time, nanoseconds: a vehicle that pitches
                turns its rays within a sweep. None to use the pose of the scan for all points.
        """
        T = scan.T_world_sensor[None]
        of = np.zeros(len(scan), np.intp)
        if path is not None and scan.times is not None and scan.stamp_ns is not None:
            moments = scan.stamp_ns + np.round(
                np.nan_to_num(scan.times.astype(np.float64)) * 1e9
            ).astype(np.int64)
            ticks, of = np.unique(moments // TICK, return_inverse=True)
            T = path.at(ticks * TICK)
        with np.errstate(invalid="ignore", over="ignore"):
            ends = np.einsum("nji,nj->ni", T[of, :3, :3], scan.points - scan.origins)
            starts = np.einsum("nji,nj->ni", T[of, :3, :3], scan.origins - T[of, :3, 3])
            ranges = np.sqrt((ends * ends).sum(1))
        chosen = np.isfinite(ranges) & (ranges > 0.1)
        ends = ends[chosen]
        ranges = ranges[chosen]
        elevations = np.degrees(np.arcsin(np.clip(ends[:, 2] / ranges, -1, 1)))
        return cls(
            ends,
            ranges,
            elevations,
            np.degrees(np.arctan2(ends[:, 1], ends[:, 0])),
            _lidars(starts[chosen]),
        )


def _lidars(starts: F64) -> Intp:
    """Number of the lidar of each ray, (N,); zeros if rays start in no small number of places."""
    numbers = np.full(len(starts), -1, np.intp)
    for lidar in range(MOST_LIDARS):
        left = np.flatnonzero(numbers < 0)
        if not len(left):
            return numbers
        near = ((starts[left] - starts[left[0]]) ** 2).sum(1) < SAME_PLACE**2
        if near.sum() < FEWEST_RAYS * len(starts):
            break
        numbers[left[near]] = lidar
    return np.zeros(len(starts), np.intp)


def estimate_sensor(sequence: Drive) -> Sensor:
    """Estimate the facts of the sensor of a sequence from a few of its scans.

    None where they do not show.

    Rows are the attribute ``ring`` if points have it, otherwise jumps of the azimuth in the order
    of the points, or peaks in the elevations; of several lidars, those of the one that has the
    most. The height is the distance of the sensor from the plane of the ground around it.

    Raises:
        DataError: for data that cannot be read.
    """
    timed = sequence[0].times is not None
    # scans with a path on both sides
    skipped = min(AROUND_SCAN, (len(sequence) - 1) // 2) if timed else 0
    positions = np.unique(
        np.linspace(skipped, len(sequence) - 1 - skipped, SAMPLES).astype(int)
    ).tolist()
    scans = [sequence[k] for k in positions]
    paths = [_path(sequence, k, scan) for k, scan in zip(positions, scans, strict=True)]
    every_ray = [ScanRays.of(scan, path) for scan, path in zip(scans, paths, strict=True)]
    known = [k for k, each in enumerate(every_ray) if len(each.ranges) > 100]
    if not known:
        return Sensor()
    rays = [every_ray[k] for k in known]
    rows = _rows(sequence, positions, rays)
    heights = [
        height
        for k, each in zip(known, rays, strict=True)
        if (height := stance(scans[k], each)[1]) is not None
    ]
    every = np.concatenate([each.elevations for each in rays])
    ranges = np.concatenate([each.ranges for each in rays])
    low, high = _ends(every, ranges, 0.05 if rows is None else 0.02)
    return Sensor(
        title="estimated from the scans",
        rings=rows,
        elevation=(round(float(low), 2), round(float(high), 2)),
        azimuth=_azimuth(np.concatenate([each.azimuths for each in rays])),
        height=round(float(np.median(heights)), 2) if heights else None,
        min_range=round(float(np.percentile(ranges, 0.1)), 2),
        max_range=round(float(ranges.max()), 1),
        rate=_rate(sequence, positions),
        points_per_sweep=None
        if rows
        else round(float(np.mean([len(each.ranges) for each in rays]))),
    )


def _path(sequence: Drive, position: int, scan: Scan) -> Trajectory | None:
    """Poses from the scan before to the one after; None if points have no times."""
    if scan.times is None or not len(scan) or not np.ptp(np.nan_to_num(scan.times)):
        return None
    near = [
        sequence[k]
        for k in range(
            max(position - AROUND_SCAN, 0), min(position + AROUND_SCAN + 1, len(sequence))
        )
    ]
    stamps = [each.stamp_ns for each in near]
    if None in stamps or len(set(stamps)) < 3:
        return None
    return smoothed(np.array(stamps, np.int64), np.array([each.T_world_sensor for each in near]))


def sentence(sensor: Sensor) -> str:
    """The estimates in one line."""
    parts = [
        None if sensor.height is None else f"{sensor.height:.2f} m above the ground",
        "no rows" if sensor.rings is None else f"{sensor.rings} rows",
        None
        if sensor.elevation is None
        else f"from {sensor.elevation[0]:.1f} to {sensor.elevation[1]:.1f} degrees",
        None
        if sensor.azimuth == (-180.0, 180.0)
        else f"azimuth {sensor.azimuth[0]:.0f} to {sensor.azimuth[1]:.0f}",
        None if sensor.max_range is None else f"up to {sensor.max_range:.0f} m",
        None if sensor.rate is None else f"{sensor.rate:.1f} Hz",
    ]
    return ", ".join(part for part in parts if part)


def with_needed_facts(
    begin: Callable[[Scan, Sensor], Any], sequence: Drive, uses: tuple[str, ...] = ()
) -> Drive:
    """The sequence with a sensor that a method can begin with, before the sequence is read.

    Args:
        begin: begins the method on one scan; raises UsageError if it lacks a fact of the sensor.
        sequence: what the method will run on.
        uses: facts that it can begin without, but should have.

    Returns:
        The same sequence, or one whose sensor has estimates in place of missing facts; then a
        warning states them.

    Raises:
        UsageError: if the method lacks a fact that cannot be estimated.
    """
    known = sequence.sensor
    if None not in (known.height, known.rings, known.elevation, known.max_range):
        return sequence
    scan = sequence[0].without_truth()
    try:
        begin(scan, known)
        if all(getattr(known, name) is not None for name in uses):
            return sequence
    except UsageError:
        pass
    found = estimate_sensor(sequence)
    facts = {name: getattr(found, name) for name in ESTIMATED if getattr(known, name) is None}
    estimated = dataclasses.replace(known, **facts)
    begin(scan, estimated)
    if all(value is None for value in facts.values()):
        return sequence
    text = f"the sensor is unknown; estimated from the scans: {sentence(found)}"
    warnings.warn(
        addressed(f"{text}. Give the true values with --sensor NAME or FILE.toml"), stacklevel=3
    )
    return sequence.with_sensor(estimated)


def _rows(sequence: Drive, positions: list[int], rays: list[ScanRays]) -> int | None:
    """Number of rows; None for a sensor without rows, or if they do not show."""
    attributes = [sequence.attributes(k) for k in positions]
    name = next((name for name in RINGS if all(name in each for each in attributes)), None)
    if any(each.lidars.any() for each in rays) and (rows := _agreed(rays)):
        return rows
    if name is not None:
        values = np.unique(np.concatenate([np.asarray(each[name]) for each in attributes]))
        if values.min() >= 0 and 1 < len(values) <= MOST_ROWS:
            return int(values.max()) + 1
    wraps = [_wraps(each) for each in rays]
    if None not in wraps and np.ptp(wraps) <= 2:  # type: ignore[arg-type]  # no None here
        return int(np.max(wraps))  # type: ignore[arg-type]  # likewise
    return _peaks(np.concatenate([each.elevations for each in rays])) or _agreed(rays)


def _agreed(rays: list[ScanRays]) -> int | None:
    """Number of peaks in the elevations of a lidar, if it is the same in most scans.

    Of the lidar that has the most.
    """
    counts = []
    for each in rays:
        found = [_peaks(each.elevations[each.lidars == lidar]) for lidar in np.unique(each.lidars)]
        counts.append(0 if None in found else max(count or 0 for count in found))
    rows = int(np.median(counts))
    return rows if rows and np.mean(np.array(counts) == rows) > 0.5 else None


def _wraps(rays: ScanRays) -> int | None:
    """Number of turns of the azimuth in the order of the points, for files that store one row after
    the other.
    """
    step = (np.diff(rays.azimuths) + 180) % 360 - 180
    if not len(step) or np.percentile(np.abs(step), 99) > 30 or np.median(np.abs(step)) > 2:
        return None
    turns = abs(float(step.sum())) / 360
    rows = round(turns)
    return (
        rows
        if 3 < rows < MOST_ROWS and abs(turns - rows) < 0.3 and len(step) / rows > 100
        else None
    )


def _peaks(elevations: F64) -> int | None:
    """Number of separate peaks in the histogram of elevations; None if they overlap."""
    counts = np.bincount(
        np.round((elevations + 90) / BIN).astype(int), minlength=int(180 / BIN) + 1
    )
    smooth = np.convolve(counts, np.ones(5), "same")
    around = np.lib.stride_tricks.sliding_window_view(np.pad(smooth, 6), 13)
    peaks = np.flatnonzero((smooth == around.max(1)) & (smooth > around[:, :6].max(1)))
    heights = smooth[peaks]
    strong = peaks[heights > FEW * np.median(np.sort(heights)[-max(len(heights) // 2, 1) :])]
    if not 2 <= len(strong) <= MOST_ROWS:
        return None
    inside = sum(counts[max(k - 4, 0) : k + 5].sum() for k in strong)
    return len(strong) if inside > 0.9 * len(elevations) else None


def _ends(elevations: F64, ranges: F64, stray: float) -> tuple[float, float]:
    """Lowest and highest elevation at which more than stray points lie.

    Their share at each end is in percent.

    Where rows overlap, lasers are mounted at different heights, as in a HDL-64E: near points are
    then seen at higher elevations than the beam has. The highest beam shows at far points.
    """
    low, high = np.percentile(elevations, [stray, 100 - stray])
    far = elevations[ranges > BEYOND]
    if len(far) > 1000 and _peaks(elevations) is None:
        beam = np.percentile(far, 100 - stray)
        # a sensor that sees the sky has no far points there
        high = beam if high - beam < PARALLAX else high
    return float(low), float(high)


def stance(scan: Scan, rays: ScanRays) -> tuple[F64, float | None]:
    """How a sensor stands on the ground.

    Up is the third axis of the sensor, or that of the world if the sensor is turned and shows more
    ground there: one that is upside down, tilted, or turns about an axis.

    Returns:
        Up in the sensor frame, (3,), and the distance of the sensor from the plane of the ground,
        metres; None if too little of it is seen.
    """
    up = np.array([0.0, 0.0, 1.0])
    height, shown = sensor_height(rays.ends)
    if scan.T_world_sensor[2, 2] <= UPRIGHT:
        away = scan.points - scan.origins
        high, seen = sensor_height(away[np.isfinite(away).all(1)])
        if seen > shown:
            return scan.T_world_sensor[2, :3], high
    return up, height if shown else None


def _azimuth(azimuths: F64) -> tuple[float, float]:
    """Start and end of the horizontal field of view, degrees.

    All around unless a sector of 20 degrees is empty.
    """
    counts = np.bincount((np.floor(azimuths).astype(int) + 180) % 360, minlength=360)
    filled = np.flatnonzero(counts > 0.05 * counts.mean())
    gaps = np.diff(filled, append=filled[0] + 360)
    widest = int(np.argmax(gaps))
    if gaps[widest] < 20:
        return -180.0, 180.0
    start = (filled[(widest + 1) % len(filled)] - 180 + 180) % 360 - 180
    end = start + 360 - gaps[widest] + 1
    return float(start), float(end)


def _rate(sequence: Drive, positions: list[int]) -> float | None:
    """Scans per second, from the stamps of neighbouring scans."""
    steps = []
    for k in positions:
        if k + 1 < len(sequence):
            first = sequence[k].stamp_ns
            second = sequence[k + 1].stamp_ns
            if first is not None and second is not None and second > first:
                steps.append(second - first)
    return round(1e9 / float(np.median(steps)), 2) if steps else None
