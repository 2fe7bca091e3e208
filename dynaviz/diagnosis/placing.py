"""Whether clouds and poses are in the frames that they claim: other readings are tried and compared.

Two pieces of evidence. *Overlap*: placed rightly, the surfaces of two scans lie upon each other. *Hidden*: seen from
where it was measured, a cloud hides little of itself, for rays do not go through surfaces. A reading of the data is
better where it raises the overlap, or, at the same overlap, has the clouds hide less.
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

CELL = 0.4  # metres; one point of each cell is compared
SOME = 20_000  # points that are looked at from elsewhere
REACH = 80.0  # metres; farther points are too sparse
ON = 0.1  # metres from a plane within which a point lies upon it
GAIN, CLEAR_GAIN = 0.06, 0.15  # overlap that another reading must gain to be likely, certain
FEWER = 1.5, 0.008  # how many times less, and by which share, another reading must hide
MOVE, TURN = 1.0, 5.0  # metres, degrees between the two scans of a pair
FARTHEST = 40  # frames between them


class ScanView:
    """A scan, thinned, for comparison. Everything is relative to ``origin``, for precision far from the world's origin.

    Attributes:
        index: number of the frame.
        T: (4, 4) float64, metres: the pose as given.
        points: (N, 3) float64, metres, world frame as given: one of each cell.
        all: (M, 3) float64: some of all points, in the density of the scan.
    """

    def __init__(self, scan: Scan) -> None:
        self.index, self.T, self.stamp = scan.index, scan.T_world_sensor, scan.stamp_ns
        xyz = scan.points[np.isfinite(scan.points).all(1)]
        middle = np.median(xyz, axis=0)
        xyz = xyz[(np.abs(xyz - middle) < REACH).all(1)]
        xyz = xyz[np.random.default_rng(0).permutation(len(xyz))]
        self.all = xyz[:SOME].astype(np.float64)
        self.points = (xyz - middle)[voxel_downsample(xyz - middle, CELL)[0]].astype(np.float64) + middle

    @cached_property
    def surface(self) -> Surface:
        """The surfaces that its points lie on."""
        return Surface(self.points)


class Surface:
    """Planes through each point and its neighbours."""

    def __init__(self, points: F64) -> None:
        from scipy.spatial import cKDTree

        self.points, self.tree = points, cKDTree(points)
        around = points[self.tree.query(points, min(9, len(points)))[1]]
        centred = around - around.mean(1, keepdims=True)
        self.normals = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))[1][:, :, 0]

    def heights(self, points: F64) -> tuple[F64, F64]:
        """(N,) signed metres above the plane of the nearest point, inf beyond 1 m from it, and (N, 3) its normal."""
        far, nearest = self.tree.query(points, distance_upper_bound=1.0)
        found = np.isfinite(far)
        row = np.where(found, nearest, 0)
        normals = self.normals[row]
        return np.where(found, ((points - self.points[row]) * normals).sum(1), np.inf), normals

    def overlap(self, points: F64) -> float:
        """Share of points that lie upon the surfaces."""
        return float((np.abs(self.heights(points)[0]) < ON).mean())


def hidden(points: F64, origin: F64) -> float:
    """Share of points that lie well behind others, seen from an origin at one degree."""
    away = points - origin
    ranges = np.sqrt((away * away).sum(1))
    ranges = np.maximum(ranges, 1e-6)
    azimuth = np.degrees(np.arctan2(away[:, 1], away[:, 0])) + 180
    elevation = np.degrees(np.arcsin(np.clip(away[:, 2] / ranges, -1, 1))) + 90
    cell = np.floor(azimuth).astype(np.intp) * 181 + np.floor(elevation).astype(np.intp)
    nearest = np.full(361 * 181, np.inf)
    np.minimum.at(nearest, cell, ranges)
    return float((ranges > 1.2 * nearest[cell] + 0.5).mean())


@dataclass(frozen=True)
class Reading:
    """Another meaning of the same numbers.

    Attributes:
        move: T_world_given: moves points from where they are given to where they would be then.
        pose: T_world_sensor as it would be then.
    """

    name: str
    what: str
    mend: str
    move: Pose
    pose: Pose


def _readings() -> tuple[Reading, ...]:
    frames = (
        Reading("points in sensor frame", "points are in the sensor frame, though the world frame is claimed",
                "Read them as such: files:PATH --points-in sensor; or write T_world_sensor @ points",
                lambda T: T, lambda T: T),
        Reading("points in world frame", "points are in the world frame already, and were moved once more",
                "Read them as such: files:PATH --points-in world", geometry.inverse, lambda T: T),
    )  # fmt: skip
    moved = tuple(  # the sensor's points were placed by a wrong pose
        Reading(name, what, mend, lambda T, f=f: f(T) @ geometry.inverse(T), f)  # type: ignore[misc]
        for name, what, mend, f in FAULTS
    )
    claimed = tuple(Reading(*fault[:3], lambda T: np.eye(4), fault[3]) for fault in FAULTS)  # the points are right
    return frames + moved + claimed


READINGS = _readings()
GIVEN = Reading("", "", "", lambda T: np.eye(4), lambda T: T)


def pairs(
    positions: Sequence[int], poses: Sequence[F64], usable: Sequence[bool], number: int = 6
) -> list[tuple[int, int]]:
    """Pairs of scans over the whole sequence, each the first apart by ``MOVE`` or ``TURN``; rows of the arguments."""
    rows = [row for row, fine in enumerate(usable) if fine]
    chosen: list[tuple[int, int]] = []
    if not rows:
        return chosen
    for place in np.unique(np.linspace(0, max(len(rows) - 2, 0), number).astype(int)):
        first, last = rows[place], None
        for row in rows[place + 1 :]:
            if positions[row] - positions[first] > FARTHEST:
                break
            last = row
            if apart(poses[first], poses[row]):
                break
        if last is not None:
            chosen.append((first, last))
    return chosen


def apart(a: F64, b: F64) -> bool:
    """Whether a sensor moved or turned enough between two poses for readings to differ."""
    T = geometry.inverse(a) @ b
    return bool(np.linalg.norm(T[:3, 3]) > MOVE or angle(T) > TURN)


@dataclass(frozen=True)
class Evidence:
    """What speaks for a reading, a figure a pair."""

    overlap: F64
    hidden: F64


def evidence(reading: Reading, views: Sequence[tuple[ScanView, ScanView]], known: dict[bytes, float]) -> Evidence:
    """Try a reading on pairs of scans; ``known`` keeps figures that several readings share."""

    def ask(number: int, T: F64, figure: Callable[[], float]) -> float:
        key = bytes([number]) + np.round(T, 6).tobytes()
        if key not in known:
            known[key] = figure()
        return known[key]

    overlaps, hides = [], []
    for k, (a, b) in enumerate(views):
        move = reading.move(b.T)
        T = geometry.inverse(reading.move(a.T)) @ move
        overlaps.append(ask(k, T, lambda a=a, b=b, T=T: a.surface.overlap(geometry.apply(T, b.points))))  # type: ignore[misc]
        # Points are left where they are: the origin goes to them.
        origin = geometry.apply(geometry.inverse(move), reading.pose(b.T)[None, :3, 3])[0]
        hides.append(ask(k, origin, lambda b=b, origin=origin: hidden(b.all, origin)))  # type: ignore[misc]
    return Evidence(np.array(overlaps), np.array(hides))


def other_reading(views: Sequence[tuple[ScanView, ScanView]]) -> Iterator[Finding]:
    """The reading that fits clouds and poses better than the given one, if any."""
    known: dict[bytes, float] = {}
    given, *others = (evidence(reading, views, known) for reading in (GIVEN, *READINGS))
    tried = list(zip(READINGS, others, strict=True))
    top = max(float(e.overlap.mean()) for _, e in tried)
    gain = top - float(given.overlap.mean())
    if gain > GAIN:
        near = [(r, e) for r, e in tried if e.overlap.mean() > top - 0.02]
        least = min(float(e.hidden.mean()) for _, e in near)
        reading, e = next((r, e) for r, e in near if e.hidden.mean() <= FEWER[0] * least + FEWER[1])
        better = float((e.overlap > given.overlap + 0.02).mean())
        if better >= 0.6:
            sure = Confidence.CERTAIN if gain > CLEAR_GAIN and better > 0.8 else Confidence.LIKELY
            share = f"{e.overlap.mean():.0%} of a scan then lies upon the next one, as given {given.overlap.mean():.0%}"
            yield Finding(reading.name, sure, f"{reading.what}: {share}", reading.mend)
        return
    for reading, e in sorted(tried, key=lambda pair: float(pair[1].hidden.mean())):
        if e.overlap.mean() > given.overlap.mean() - 0.03 and _hides_less(e.hidden, given.hidden):
            then, now = float(e.hidden.mean()), float(given.hidden.mean())
            said = f"{reading.what}: a cloud then hides {then:.1%} of itself from the sensor, as given {now:.1%}"
            yield Finding(reading.name, Confidence.LIKELY, said, reading.mend)
            return


def _hides_less(other: F64, given: F64, times: float = FEWER[0], share: float = FEWER[1]) -> bool:
    """Whether clouds hide several times less, in most pairs and over all, and by some share of their points."""
    mostly = (given > times * other).mean() >= 0.6
    return bool(mostly and given.mean() > max(times * other.mean(), other.mean() + share))


def moving_clouds(views: Sequence[tuple[ScanView, ScanView]]) -> tuple[str, Confidence] | None:
    """In words, how the clouds of a sensor move that is said to stand; None where they do not."""
    gains, shifts = [], []
    for a, b in views:
        T = register(a.surface, b.points)
        gains.append(a.surface.overlap(geometry.apply(T, b.points)) - a.surface.overlap(b.points))
        shifts.append(float(np.linalg.norm((T @ a.T - a.T)[:3, 3])))
    if not views or (moved := float(np.median(shifts))) < 0.05 or (gain := float(np.median(gains))) < 0.03:
        return None
    said = f"from scan to scan the clouds move by {moved:.2f} m: then {gain:.0%} more of a scan lies upon the other"
    return said, Confidence.CERTAIN if gain > CLEAR_GAIN else Confidence.LIKELY


def elsewhere(views: Sequence[tuple[ScanView, ScanView]], times: float) -> str | None:
    """In words, where clouds hide themselves from the sensor's place, but several times less from another one, or None.

    At another height things look different anyway, so much more must speak for that.
    """
    given = np.array([hidden(b.all, b.T[:3, 3]) for _, b in views])
    for raised, factor, share in ((False, times, FEWER[1]), (True, 3.0, 0.05)):
        if given.mean() < share:
            break
        best = []
        for _, b in views:
            places = _places(b, raised)
            hides = [hidden(b.all, place) for place in places]
            k = int(np.argmin(hides))
            best.append((hides[k], float(np.linalg.norm(places[k] - b.T[:3, 3]))))
        less, away = np.array(best).T
        if _hides_less(less, given, factor, share):
            return (
                f"the clouds look as if seen from up to {away.max():.0f} m beside: "
                f"there they hide {less.mean():.1%} of their points, from the given places {given.mean():.1%}"
            )
    return None


def _places(view: ScanView, raised: bool) -> F64:
    """(K, 3) metres: places around the sensor's given one and around the middle of its cloud, or raised above there."""
    at, middle = view.T[:3, 3].copy(), np.median(view.all, axis=0)
    middle[2] = at[2]
    if raised:
        middle[2] = at[2] = np.percentile(view.all[:, 2], 5) + 1.5
    turn = np.arange(8) * np.pi / 4
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros(8)], 1)
    return np.concatenate([[middle], *(c + r * ring for c in (at, middle) for r in (1.5, 3.0, 6.0, 12.0))])


def register(surface: Surface, points: F64) -> F64:
    """T_a_b that lays points upon surfaces: point-to-plane steps with a shrinking reach."""
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
    """The sensor's height above the ground around it, against its file."""
    found = [h for _, b in views if (h := ground_height(b)) is not None]
    if height is None or len(found) < max(1, len(views) // 2):
        return
    seen = float(np.median(found))
    if abs(seen - height) > max(0.5, 0.35 * height):
        what = f"the ground lies {seen:.1f} m below the sensor, but {sensor} is said to be mounted at {height:.1f} m"
        by_hand = settable("sensor_height", f"{seen:.2f}")
        mend = f"Name the sensor with --sensor NAME (dynaviz list sensors), or give methods its height: {by_hand}"
        yield Finding("ground height", Confidence.LIKELY, what, mend)


def ground_height(view: ScanView) -> float | None:
    """Metres from the ground up to the sensor: where the lowest points of most square metres around lie; or None."""
    away = view.all - view.T[:3, 3]
    far = np.hypot(away[:, 0], away[:, 1])
    away = away[(far > 1.5) & (far < 15) & (away[:, 2] < -0.2) & (away[:, 2] > -8)]
    if len(away) < 200:
        return None
    square = np.floor(away[:, :2]).astype(np.int64) @ np.array([1000, 1])
    order = np.lexsort((away[:, 2], square))
    first = np.flatnonzero(np.diff(square[order], prepend=square.min() - 1))
    lowest = away[order[first], 2]
    layers = np.histogram(lowest, np.arange(-8, 0.01, 0.1))[0]
    thick = np.convolve(layers, np.ones(3), "same")
    best = int(np.argmax(thick))
    if len(lowest) < 30 or thick[best] < 0.3 * len(lowest):
        return None
    return float(-np.median(lowest[np.abs(lowest - (-8 + 0.1 * best + 0.05)) < 0.15]))
