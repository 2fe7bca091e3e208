"""Check whether clouds and poses match, by comparing other interpretations of the same numbers.

Two measures are used. *Overlap*: with correct poses, the surfaces of two scans coincide. *Hidden points*: seen from
where it was measured, a cloud hides few of its own points, because rays do not pass through surfaces. An interpretation
is better if it increases the overlap or, at the same overlap, reduces the hidden points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dynaviz.arrays import F64
from dynaviz.diagnosis.finding import Confidence, Finding, settable
from dynaviz.diagnosis.trajectory import FAULTS, Pose, angle
from dynaviz.scan import Scan
from dynaviz.spatial import geometry
from dynaviz.spatial.grid import voxel_downsample

CELL = 0.4  # metres; voxel size for comparing scans
SAMPLE = 20_000  # points in which hidden ones are counted
REACH = 80.0  # metres from the median along each axis; farther points are too sparse
ON_SURFACE = 0.1  # metres; largest distance from a plane of a point that lies on it
GAIN, CLEAR_GAIN = 0.06, 0.15  # increase in overlap for a likely and a certain finding
LESS_HIDDEN = 1.5, 0.008  # factor and share by which another interpretation must reduce hidden points
MIN_MOVE, MIN_TURN = 1.0, 5.0  # metres and degrees between the two scans of a pair
MAX_APART = 40  # frames between the two scans of a pair


class ScanView:
    """A downsampled scan for comparison.

    Attributes:
        index: number of the frame.
        T: (4, 4) float64, metres: the given pose.
        stamp: the frame's time, nanoseconds, or None.
        points: (N, 3) float64, metres, given world frame: one point per voxel of ``CELL``.
        sample: (M, 3) float64, metres, given world frame: up to ``SAMPLE`` random points, with the density of the scan.
    """

    def __init__(self, scan: Scan) -> None:
        self.index, self.T, self.stamp = scan.index, scan.T_world_sensor, scan.stamp_ns
        xyz = scan.points[np.isfinite(scan.points).all(1)]
        middle = np.median(xyz, axis=0)
        xyz = xyz[(np.abs(xyz - middle) < REACH).all(1)]
        xyz = xyz[np.random.default_rng(0).permutation(len(xyz))]
        self.sample = xyz[:SAMPLE].astype(np.float64)
        self.points = (xyz - middle)[voxel_downsample(xyz - middle, CELL)[0]].astype(np.float64) + middle

    @cached_property
    def surface(self) -> Surface:
        """The surfaces on which the points lie."""
        return Surface(self.points)


class Surface:
    """A plane through each point and its 8 nearest neighbours.

    Args:
        points: (N, 3) float64, metres.
    """

    def __init__(self, points: F64) -> None:
        from scipy.spatial import cKDTree

        self.points, self.tree = points, cKDTree(points)
        around = points[self.tree.query(points, min(9, len(points)))[1]]
        centred = around - around.mean(1, keepdims=True)
        self.normals = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))[1][:, :, 0]

    def heights(self, points: F64) -> tuple[F64, F64]:
        """Signed height above the plane of the nearest point, (N,) metres, inf beyond 1 m, and its normal, (N, 3)."""
        distances, nearest = self.tree.query(points, distance_upper_bound=1.0)
        found = np.isfinite(distances)
        row = np.where(found, nearest, 0)
        normals = self.normals[row]
        return np.where(found, ((points - self.points[row]) * normals).sum(1), np.inf), normals

    def overlap(self, points: F64) -> float:
        """Share of points that lie on the surfaces."""
        return float((np.abs(self.heights(points)[0]) < ON_SURFACE).mean())


def hidden(points: F64, origin: F64) -> float:
    """Share of points that lie well behind others in the same direction, seen from an origin; bins of one degree."""
    rays = points - origin
    ranges = np.sqrt((rays * rays).sum(1))
    ranges = np.maximum(ranges, 1e-6)
    azimuth = np.degrees(np.arctan2(rays[:, 1], rays[:, 0])) + 180
    elevation = np.degrees(np.arcsin(np.clip(rays[:, 2] / ranges, -1, 1))) + 90
    cell = np.floor(azimuth).astype(np.intp) * 181 + np.floor(elevation).astype(np.intp)
    nearest = np.full(361 * 181, np.inf)
    np.minimum.at(nearest, cell, ranges)
    return float((ranges > 1.2 * nearest[cell] + 0.5).mean())


@dataclass(frozen=True)
class Interpretation:
    """Another meaning of the same numbers.

    Attributes:
        name: name of the finding.
        problem: what is wrong if this interpretation is correct, in words.
        fix: how to fix it, a sentence.
        move: T_world_given under this interpretation, from the given pose: moves the given points to the world frame.
        pose: T_world_sensor under this interpretation, from the given pose.
    """

    name: str
    problem: str
    fix: str
    move: Pose
    pose: Pose


def _interpretations() -> tuple[Interpretation, ...]:
    frames = (
        Interpretation("points in sensor frame", "points are in the sensor frame, not in the world frame",
                       "Read them with files:PATH --points-in sensor, or write T_world_sensor @ points to the files",
                       lambda T: T, lambda T: T),
        Interpretation("points in world frame", "points are already in the world frame, but were transformed again",
                       "Read them with files:PATH --points-in world", geometry.inverse, lambda T: T),
    )  # fmt: skip
    wrong_points = tuple(  # points in the sensor frame were transformed by a wrong pose
        Interpretation(f.name, f.problem, f.fix, lambda T, f=f: f.correct(T) @ geometry.inverse(T), f.correct)  # type: ignore[misc]
        for f in FAULTS
    )
    wrong_poses = tuple(Interpretation(f.name, f.problem, f.fix, lambda T: np.eye(4), f.correct) for f in FAULTS)
    return frames + wrong_points + wrong_poses


INTERPRETATIONS = _interpretations()
AS_GIVEN = Interpretation("", "", "", lambda T: np.eye(4), lambda T: T)


def pairs(
    positions: Sequence[int], poses: Sequence[F64], usable: Sequence[bool], number: int = 6
) -> list[tuple[int, int]]:
    """Pairs of scans over the whole sequence, apart by ``MIN_MOVE`` or ``MIN_TURN`` if possible.

    Returns:
        Pairs of rows of the arguments.
    """
    rows = [row for row, ok in enumerate(usable) if ok]
    chosen: list[tuple[int, int]] = []
    if not rows:
        return chosen
    for k in np.unique(np.linspace(0, max(len(rows) - 2, 0), number).astype(int)):
        first, last = rows[k], None
        for row in rows[k + 1 :]:
            if positions[row] - positions[first] > MAX_APART:
                break
            last = row
            if apart(poses[first], poses[row]):
                break
        if last is not None:
            chosen.append((first, last))
    return chosen


def apart(a: F64, b: F64) -> bool:
    """Whether the sensor moved or turned enough between two poses for interpretations to differ."""
    T = geometry.inverse(a) @ b
    return bool(np.linalg.norm(T[:3, 3]) > MIN_MOVE or angle(T) > MIN_TURN)


@dataclass(frozen=True)
class Evidence:
    """The measures of an interpretation.

    Attributes:
        overlap, hidden: (P,) float64, shares of points for each pair of scans.
    """

    overlap: F64
    hidden: F64


def evidence(
    interpretation: Interpretation, views: Sequence[tuple[ScanView, ScanView]], known: dict[bytes, float]
) -> Evidence:
    """Apply an interpretation to pairs of scans; ``known`` caches figures that several interpretations share."""

    def cached(number: int, T: F64, figure: Callable[[], float]) -> float:
        key = bytes([number]) + np.round(T, 6).tobytes()
        if key not in known:
            known[key] = figure()
        return known[key]

    overlaps, hides = [], []
    for k, (a, b) in enumerate(views):
        move = interpretation.move(b.T)
        T = geometry.inverse(interpretation.move(a.T)) @ move
        overlaps.append(cached(k, T, lambda a=a, b=b, T=T: a.surface.overlap(geometry.apply(T, b.points))))  # type: ignore[misc]
        # Moves the origin into the frame of the given points instead of moving the points.
        origin = geometry.apply(geometry.inverse(move), interpretation.pose(b.T)[None, :3, 3])[0]
        hides.append(cached(k, origin, lambda b=b, origin=origin: hidden(b.sample, origin)))  # type: ignore[misc]
    return Evidence(np.array(overlaps), np.array(hides))


def better_interpretation(views: Sequence[tuple[ScanView, ScanView]]) -> Iterator[Finding]:
    """A finding if an interpretation fits clouds and poses better than the given one."""
    known: dict[bytes, float] = {}
    given, *others = (evidence(each, views, known) for each in (AS_GIVEN, *INTERPRETATIONS))
    tried = list(zip(INTERPRETATIONS, others, strict=True))
    top = max(float(e.overlap.mean()) for _, e in tried)
    gain = top - float(given.overlap.mean())
    if gain > GAIN:
        near = [(i, e) for i, e in tried if e.overlap.mean() > top - 0.02]
        least = min(float(e.hidden.mean()) for _, e in near)
        best, e = next((i, e) for i, e in near if e.hidden.mean() <= LESS_HIDDEN[0] * least + LESS_HIDDEN[1])
        better = float((e.overlap > given.overlap + 0.02).mean())
        if better >= 0.6:
            confidence = Confidence.CERTAIN if gain > CLEAR_GAIN and better > 0.8 else Confidence.LIKELY
            shares = f"{e.overlap.mean():.0%} of a scan then overlaps the other, instead of {given.overlap.mean():.0%}"
            yield Finding(best.name, confidence, f"{best.problem}: {shares}", best.fix)
        return
    for each, e in sorted(tried, key=lambda pair: float(pair[1].hidden.mean())):
        if e.overlap.mean() > given.overlap.mean() - 0.03 and _hides_less(e.hidden, given.hidden):
            then, now = float(e.hidden.mean()), float(given.hidden.mean())
            shares = f"a cloud then hides {then:.1%} of its points from the sensor, instead of {now:.1%}"
            yield Finding(each.name, Confidence.LIKELY, f"{each.problem}: {shares}", each.fix)
            return


def _hides_less(other: F64, given: F64, times: float = LESS_HIDDEN[0], share: float = LESS_HIDDEN[1]) -> bool:
    """Whether hidden points decrease by a factor, in most pairs and on average, and by a share of all points."""
    in_most_pairs = (given > times * other).mean() >= 0.6
    return bool(in_most_pairs and given.mean() > max(times * other.mean(), other.mean() + share))


def moving_clouds(views: Sequence[tuple[ScanView, ScanView]]) -> tuple[str, Confidence] | None:
    """A sentence and confidence if clouds move although the poses are identical; None if they do not move."""
    gains, shifts = [], []
    for a, b in views:
        T = register(a.surface, b.points)
        gains.append(a.surface.overlap(geometry.apply(T, b.points)) - a.surface.overlap(b.points))
        shifts.append(float(np.linalg.norm((T @ a.T - a.T)[:3, 3])))
    if not views or (moved := float(np.median(shifts))) < 0.05 or (gain := float(np.median(gains))) < 0.03:
        return None
    problem = f"the clouds move by {moved:.2f} m between scans; aligning them adds {gain:.0%} to their overlap"
    return problem, Confidence.CERTAIN if gain > CLEAR_GAIN else Confidence.LIKELY


def measured_elsewhere(views: Sequence[tuple[ScanView, ScanView]], times: float) -> str | None:
    """A sentence if clouds hide many points from the given position but far fewer from another one; None otherwise.

    The view from another height differs in any case, so a raised position needs stronger evidence.
    """
    given = np.array([hidden(b.sample, b.T[:3, 3]) for _, b in views])
    for raised, factor, share in ((False, times, LESS_HIDDEN[1]), (True, 3.0, 0.05)):
        if given.mean() < share:
            break
        best = []
        for _, b in views:
            candidates = _candidate_positions(b, raised)
            hides = [hidden(b.sample, position) for position in candidates]
            k = int(np.argmin(hides))
            best.append((hides[k], float(np.linalg.norm(candidates[k] - b.T[:3, 3]))))
        less, distances = np.array(best).T
        if _hides_less(less, given, factor, share):
            return (
                f"the clouds appear to be measured up to {distances.max():.0f} m away from the given positions: "
                f"from there they hide {less.mean():.1%} of their points, from the given positions {given.mean():.1%}"
            )
    return None


def _candidate_positions(view: ScanView, raised: bool) -> F64:
    """(K, 3) metres: positions around the given one and the cloud's median; raised: 1.5 m above the ground."""
    given, middle = view.T[:3, 3].copy(), np.median(view.sample, axis=0)
    middle[2] = given[2]
    if raised:
        middle[2] = given[2] = np.percentile(view.sample[:, 2], 5) + 1.5
    azimuth = np.arange(8) * np.pi / 4
    ring = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(8)], 1)
    return np.concatenate([[middle], *(c + r * ring for c in (given, middle) for r in (1.5, 3.0, 6.0, 12.0))])


def register(surface: Surface, points: F64) -> F64:
    """T_a_b that aligns points with surfaces: point-to-plane ICP with a shrinking distance limit."""
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    for step in range(30):
        moved = geometry.apply(T, points)
        heights, normals = surface.heights(moved)
        near = np.abs(heights) < max(1.0 - step / 15, 0.2)
        if near.sum() < 20:
            break
        middle = moved[near].mean(0)
        A = np.hstack([np.cross(moved[near] - middle, normals[near]), normals[near]])
        x = np.linalg.lstsq(A.T @ A + 1e-3 * np.eye(6), -A.T @ heights[near], rcond=None)[0]
        delta = np.eye(4)
        delta[:3, :3] = Rotation.from_rotvec(x[:3]).as_matrix()
        delta[:3, 3] = middle + x[3:] - delta[:3, :3] @ middle
        T = delta @ T
    return T


def ground(views: Sequence[tuple[ScanView, ScanView]], height: float | None, sensor: str) -> Iterator[Finding]:
    """Compare the sensor's height above the ground with the height in its file."""
    found = [h for _, b in views if (h := ground_height(b)) is not None]
    if height is None or len(found) < max(1, len(views) // 2):
        return
    measured = float(np.median(found))
    if abs(measured - height) > max(0.5, 0.35 * height):
        problem = (
            f"the ground is {measured:.1f} m below the sensor, but the mounting height of {sensor} is {height:.1f} m"
        )
        option = settable("sensor_height", f"{measured:.2f}")
        fix = f"Give the sensor with --sensor NAME (see 'dynaviz list sensors'), or its height: {option}"
        yield Finding("ground height", Confidence.LIKELY, problem, fix)


def ground_height(view: ScanView) -> float | None:
    """Height of the sensor above the ground, metres: from the lowest point of each square metre around it; or None."""
    local = view.sample - view.T[:3, 3]
    distance = np.hypot(local[:, 0], local[:, 1])
    local = local[(distance > 1.5) & (distance < 15) & (local[:, 2] < -0.2) & (local[:, 2] > -8)]
    if len(local) < 200:
        return None
    square = np.floor(local[:, :2]).astype(np.int64) @ np.array([1000, 1])
    order = np.lexsort((local[:, 2], square))
    first = np.flatnonzero(np.diff(square[order], prepend=square.min() - 1))
    lowest = local[order[first], 2]
    layers = np.histogram(lowest, np.arange(-8, 0.01, 0.1))[0]
    smoothed = np.convolve(layers, np.ones(3), "same")
    best = int(np.argmax(smoothed))
    if len(lowest) < 30 or smoothed[best] < 0.3 * len(lowest):
        return None
    return float(-np.median(lowest[np.abs(lowest - (-8 + 0.1 * best + 0.05)) < 0.15]))
