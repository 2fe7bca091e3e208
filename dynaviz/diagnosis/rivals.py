"""Other explanations of poses that do not fit, and whether an explanation is good by itself.

A mount of the lidar on the vehicle and a constant delay of the poses are estimated from the scans,
and compete with the known mistakes and with drift. An explanation is good if registration hardly
moves scans that were placed by it, and if the ground is then below the sensor. If none is good,
nobody can tell what is wrong: the finding then states the measures.

If a mount and an unusual order of quaternions explain neighbouring scans alike, scans that are
farther apart decide, where small turns show. If these fit alike, too, the simpler one is chosen:
the order has no value that is fitted to the scans, so the mount must turn the lidar about one axis
only, besides quarter turns, on a vehicle that stands upright. The finding is then likely at most,
and states the other one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynaviz.arrays import F64
from dynaviz.contracts.scan import Scan
from dynaviz.diagnosis.alignment import (
    ALIKE,
    AS_GIVEN,
    GAIN,
    Interpretation,
    Interpretations,
    Pairs,
    usual,
)
from dynaviz.diagnosis.drift import Drift
from dynaviz.diagnosis.finding import Confidence, Finding
from dynaviz.diagnosis.trajectory import MAX_TILT, tilt_of
from dynaviz.sources.hypotheses.delays import estimate_delay, overlap_with
from dynaviz.sources.hypotheses.judge import ground_sides
from dynaviz.sources.hypotheses.mounts import as_option, estimate_mount, quarter_turns
from dynaviz.sources.hypotheses.registration import register
from dynaviz.sources.hypotheses.views import ScanView, angle
from dynaviz.spatial import geometry
from dynaviz.spatial.trajectory import PosesOverTime

MOUNT = "lidar mount"
DELAY = "poses late"
UNKNOWN = "poses do not fit"
# overlap that registration may add to that of a good explanation, and metres by which it moves
SETTLED = 0.12
SHIFT = 0.35
SMALLEST = 0.7, 0.1  # degrees and metres of a mount
SHORTEST = 0.03  # seconds of a delay
TURNS = 10.0  # degrees by which a vehicle must turn for a mount to be told from a drift
MOST_EXPLAINED = 0.75  # share of what registration gains, of a mount instead of a drift
EXACT = 0.15  # metres by which registration may then still move a scan
EXPLAINED = 0.6  # share of what registration gains
OVERLAPS = 0.35  # of a good explanation
UNSTEADY = 0.7  # change of the step from scan to scan, as a share of it
BETTER = 0.03  # metres by which registration must move a scan less, of a clearly better one
STRAIGHT = 3.0  # degrees about an axis, less than which is no turn
REACH = 5.0  # metres from a sensor to what it sees
POINTS = 4000  # of a scan that are registered


@dataclass(frozen=True)
class Quality:
    """How well scans fit under an explanation.

    Attributes:
        overlap, registered: mean share of a scan on the surfaces of the other one of its pair, as
            placed and after registration.
        moved: metres by which registration moves the sensor, median.
        beside: share of the scans with the ground above the sensor or on a side.
    """

    overlap: float
    registered: float
    moved: float
    beside: float

    @property
    def good(self) -> bool:
        """Whether the explanation is plausible by itself."""
        settled = self.registered - self.overlap <= SETTLED or self.moved <= SHIFT
        return settled and self.overlap >= OVERLAPS and self.beside < 0.5

    def __str__(self) -> str:
        words = (
            f"{self.overlap:.0%} of a scan lies on the other, after registration by "
            f"{self.moved:.2f} m {self.registered:.0%}"
        )
        return f"{words}, and the ground is not below the sensor" if self.beside >= 0.5 else words


def quality(views: Pairs, each: Interpretation = AS_GIVEN) -> Quality:
    """How well pairs of scans fit under an interpretation."""
    rows = []
    placed = []
    for a, b in views:
        T = geometry.inverse(each.move(a.T)) @ each.move(b.T)
        points = b.points[:: 1 + len(b.points) // POINTS]
        moved = geometry.apply(T, points)
        change = register(a.surface, moved)
        middle = np.median(moved, axis=0)
        shift = geometry.apply(change, middle[None])[0] - middle
        rows.append(
            (
                a.surface.overlap(moved),
                a.surface.overlap(geometry.apply(change, moved)),
                _far(float(np.linalg.norm(shift)), angle(change)),
            )
        )
        placed.append(_placed(b, each))
    if not rows:
        return Quality(0.0, 0.0, 0.0, 0.0)
    overlap, registered, _ = np.mean(rows, axis=0)
    moves = float(np.median([row[2] for row in rows]))
    return Quality(float(overlap), float(registered), moves, ground_sides(placed)[1])


@dataclass(frozen=True)
class MountedLidar:
    """A mount of the lidar on the vehicle, and how well scans fit with it.

    Attributes:
        T: T_vehicle_lidar, (4, 4), metres.
        given: how well they fit as given; then: with the mount.
    """

    T: F64
    given: Quality
    then: Quality

    @property
    def option(self) -> str:
        """The value of ``--extrinsic``."""
        return as_option(self.T)

    @property
    def interpretation(self) -> Interpretation:
        """Points that were placed by the poses of the vehicle, instead of those of the lidar."""
        move = lambda T: T @ self.T @ geometry.inverse(T)  # noqa: E731
        return Interpretation(MOUNT, "", "", move, lambda T: T @ self.T)

    def simple(self, views: Pairs) -> bool:
        """Whether it turns about one axis at most, besides quarter turns, on an upright vehicle."""
        upright = tilt_of(np.array([b.T for _, b in views])) <= MAX_TILT
        return upright and _about_one_axis(self.T)

    def finding(self) -> Finding:
        """What it explains, and the option that sets it."""
        problem = (
            f"the poses are those of a vehicle on which the lidar is turned or shifted "
            f"(x,y,z,roll,pitch,yaw {self.option}): {self.then.overlap:.0%} of a scan then "
            f"overlaps the other, instead of {self.given.overlap:.0%}"
        )
        fix = f"Give the pose of the lidar on the vehicle: --extrinsic {self.option}"
        clear = self.then.overlap > self.given.overlap + 2 * GAIN
        return Finding(MOUNT, Confidence.CERTAIN if clear else Confidence.LIKELY, problem, fix)


def weighed(
    each: Interpretation,
    finding: Finding,
    views: Pairs,
    others: Callable[[], Pairs],
    distant: Callable[[], Pairs],
    path: PosesOverTime | None,
) -> Finding:
    """The finding, or a better one: of a mount, of a delay, or that nobody can tell.

    Args:
        each: the interpretation of the finding.
        views: pairs of scans that were compared; others: reads pairs that are closer together.
        distant: reads pairs that are farther apart, for a mount that fits alike.
        path: the poses over time; None if they have no times.
    """
    found = quality(views, each)
    if found.good and usual(each):
        return finding
    if path and (late := delay_finding(views, others(), path)):
        return late
    mount = explaining_mount(views, others)
    if mount is not None:
        return _fitting(mount, each, found, finding, views, distant)
    if found.good or (found.beside >= 0.5 and found.overlap >= OVERLAPS):
        return finding
    problem = f"as given, {quality(views)}; nobody can tell why. Best fit: {each.name}, but {found}"
    return cannot_tell(problem)


def _fitting(
    mount: MountedLidar,
    each: Interpretation,
    found: Quality,
    finding: Finding,
    views: Pairs,
    distant: Callable[[], Pairs],
) -> Finding:
    """The finding of a mount or the one of an interpretation: what fits better, or is simpler."""
    lead = found.moved - mount.then.moved
    if not found.good or lead > BETTER:
        return mount.finding()
    if lead < -BETTER:
        return finding
    if apart := distant():
        at_a_distance = Interpretations(apart)
        ahead = at_a_distance.overlap(mount.interpretation) - at_a_distance.overlap(each)
        if abs(ahead.mean()) > ALIKE:
            return mount.finding() if ahead.mean() > 0 else finding
    if mount.simple(views):
        return _as_well(mount.finding(), f"{each.name} {each.reading}")
    return _as_well(finding, f"lidar mount {mount.option}")


def _as_well(finding: Finding, other: str) -> Finding:
    """A finding that is likely at most, because something else explains the scans alike."""
    confidence = max(finding.confidence, Confidence.LIKELY)
    problem = f"{finding.problem}; {other} fits alike"
    return replace(finding, confidence=confidence, problem=problem)


def _far(metres: float, degrees: float) -> float:
    """Metres by which a motion moves what is ``REACH`` away."""
    return metres + float(np.radians(degrees)) * REACH


def mount_finding(
    views: Pairs, others: Callable[[], Pairs], drifts: bool = False
) -> Finding | None:
    """A finding if a mount of the lidar on the vehicle explains the scans.

    Args:
        views, others, drifts: as of ``explaining_mount``.
    """
    mount = explaining_mount(views, others, drifts)
    return None if mount is None else mount.finding()


def explaining_mount(
    views: Pairs, others: Callable[[], Pairs], drifts: bool = False
) -> MountedLidar | None:
    """The mount of the lidar on the vehicle that explains the scans; None if none does.

    Args:
        views: pairs of scans on which it is verified.
        others: reads further pairs, from which it is estimated together with these.
        drifts: whether the alternative is a drift. If the vehicle hardly turns, a drift in a
            constant direction looks like a small mount, and is the likelier explanation. The
            mount is then estimated from the other pairs alone.
    """
    if drifts and _turns([*views]) < TURNS:
        return None
    T = estimate_mount(others() if drifts else [*others(), *views])
    if T is None:
        return None
    large = angle(T) >= SMALLEST[0] or float(np.linalg.norm(T[:3, 3])) >= SMALLEST[1]
    if not large:
        return None
    given = quality(views)
    mount = MountedLidar(T, given, given)
    then = quality(views, mount.interpretation)
    better = then.overlap > given.overlap + GAIN / 2 or given.beside >= 0.5 > then.beside
    share = (then.overlap - given.overlap) / max(given.registered - given.overlap, 1e-6)
    enough = share >= EXPLAINED or angle(T) >= 5
    if drifts:
        enough = share >= MOST_EXPLAINED and then.moved <= EXACT
    return replace(mount, then=then) if then.good and better and enough else None


def _about_one_axis(T: F64) -> bool:
    """Whether a mount turns the lidar about one axis at most, besides quarter turns."""
    from scipy.spatial.transform import Rotation

    left = [
        np.degrees(np.abs(Rotation.from_matrix(turn.T @ T[:3, :3]).as_rotvec()))
        for turn in quarter_turns()
    ]
    return min(int((each > STRAIGHT).sum()) for each in left) <= 1


def _turns(views: Pairs) -> float:
    """Degrees between the most different attitudes of the scans."""
    attitudes = [view.T for pair in views for view in pair]
    return max((angle(geometry.inverse(attitudes[0]) @ T) for T in attitudes), default=0.0)


def delay_finding(views: Pairs, verified: Pairs, path: PosesOverTime) -> Finding | None:
    """A finding if a constant delay of the poses explains the scans.

    Args:
        views: pairs of scans from which it is chosen; verified: pairs on which it must help, too.
        path: the poses over time.
    """
    found = estimate_delay(views, path)
    if found is None or abs(found.seconds) < SHORTEST:
        return None
    pairs = [*views, *(pair for pair in verified if None not in (pair[0].stamp, pair[1].stamp))]
    given = quality(pairs)
    then = overlap_with(pairs, path, found.seconds)
    gain = then - given.overlap
    if gain < GAIN / 2 or gain < EXPLAINED * (given.registered - given.overlap):
        return None
    late = "late" if found.seconds > 0 else "early"
    seconds = abs(found.seconds)
    unit = f"{seconds:.2f} s"
    change = f"{'Subtract' if found.seconds > 0 else 'Add'} {unit}"
    problem = (
        f"the times of the poses are {late} by {unit}: {then:.0%} of a scan then overlaps the "
        f"other, instead of {given.overlap:.0%}"
    )
    fix = f"{change} {'from' if found.seconds > 0 else 'to'} the times in the pose file"
    clear = gain > 2 * GAIN
    return Finding(DELAY, Confidence.CERTAIN if clear else Confidence.LIKELY, problem, fix)


def upside_down(views: Pairs, others: Callable[[], Pairs]) -> Finding | None:
    """A finding if the ground is above the sensor, or on a side of it, in most scans."""
    scans = [b for _, b in views]
    if not scans or ground_sides(scans)[1] < 0.5:
        return None
    mount = mount_finding(views, others)
    if mount is not None:
        return mount
    problem = "the ground is above the sensor or on a side of it, so the world is not z-up"
    fix = (
        "Rotate the poses so that z points up, or give the mount of the lidar: --extrinsic "
        "X,Y,Z,ROLL,PITCH,YAW"
    )
    return Finding("world not z-up", Confidence.LIKELY, problem, fix)


def misplaced(
    views: Pairs, others: Callable[[], Pairs], path: PosesOverTime | None, sparse: float = 1.0
) -> Finding | None:
    """A finding if registration moves most neighbouring scans far: the poses are not theirs.

    Args:
        views: pairs of neighbouring scans; others: reads further ones.
        path: the poses over time; None if they have no times.
        sparse: nothing is registered if more than this share of a scan overlaps the other.
    """
    if not views or np.mean([a.surface.overlap(b.points) for a, b in views]) > sparse:
        return None
    drifts = [Drift.between(a, b) for a, b in views]
    clear = [each for each in drifts if each.clear and _far(each.metres, each.degrees) > SHIFT]
    if len(clear) < max(2, len(views) / 2):
        return None
    explained = (path and delay_finding(views, others(), path)) or mount_finding(views, others)
    if explained:
        return explained
    return cannot_tell(f"as given, {quality(views)}; no known mistake explains it")


def unsteady_way(positions: Sequence[int], poses: Sequence[F64]) -> str:
    """How the way changes from scan to scan, in words; empty if it is smooth.

    Args:
        positions: of the scans; poses: (4, 4) of each, metres.
    """
    where = np.array(poses)[:, :3, 3]
    frames = np.asarray(positions)
    rows = np.flatnonzero((np.diff(frames[:-1]) == 1) & (np.diff(frames[1:]) == 1))
    if len(rows) < 3:
        return ""
    steps = np.diff(where, axis=0)
    change = float(np.median(np.linalg.norm(steps[rows + 1] - steps[rows], axis=1)))
    step = float(np.median(np.linalg.norm(steps[rows], axis=1)))
    if change < max(UNSTEADY * step, 0.1):
        return ""
    return (
        f"the step of {step:.2f} m from scan to scan changes by {change:.2f} m, so scans or poses "
        "are out of order"
    )


def cannot_tell(problem: str) -> Finding:
    """The finding that poses do not fit for an unknown reason."""
    fix = (
        "Check that each scan has its own pose: names or stamps of scans, clock, order. Or "
        "estimate the poses from the scans: --poses small-gicp"
    )
    return Finding(UNKNOWN, Confidence.LIKELY, problem, fix)


def _placed(view: ScanView, each: Interpretation) -> ScanView:
    """The scan as an interpretation places it."""
    points = geometry.apply(each.move(view.T), view.sample)
    return ScanView(Scan(view.index, points.astype(np.float32), each.pose(view.T), view.stamp))
