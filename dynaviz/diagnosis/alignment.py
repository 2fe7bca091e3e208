"""Check whether clouds and poses match, by comparing other interpretations of the same numbers.

Evidence comes from pairs of scans. *Overlap*: with correct poses, the surfaces of two scans
coincide. *Hidden points*: seen from where it was measured, a cloud hides few of its own points,
because rays do not pass through surfaces; nor do they pass through surfaces of the other scan
(*crossed* surfaces). Points are measured while the sensor moves, so only points that are hidden
from its whole way during the sweep count. *Motion*: clouds move with the sensor, which stays at one
height above the ground and faces forwards rather than backwards.

An interpretation is better if it increases the overlap or, at the same overlap, reduces both the
hidden points and those behind crossed surfaces, or moves with clouds that the given poses leave
behind. It is compared only on pairs in which it moves the cloud or the sensor farther than errors
of poses do, and it must be better on pairs from which it was not chosen as well. Interpretations
that fit alike are compared on scans that are farther apart, where small turns show. The first of
those that still fit alike is chosen, because mistakes that programs make come first; the finding
states the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, Bool
from dynaviz.diagnosis.finding import Confidence, Finding
from dynaviz.diagnosis.trajectory import (
    FAULTS,
    MAX_TILT,
    ORDER,
    W_FIRST,
    W_LAST,
    facing,
    tilt_of,
)
from dynaviz.sources.hypotheses.views import Pose, ScanView, ground_below, hidden
from dynaviz.spatial import geometry
from dynaviz.spatial.sensor_height import FLAT

Pairs = Sequence[tuple[ScanView, ScanView]]

# increase in overlap for a likely and a certain finding
GAIN = 0.06
CLEAR_GAIN = 0.15
# factor and share by which another interpretation must reduce hidden points
LESS_HIDDEN = (
    1.5,
    0.008,
)
ENOUGH = 5_000  # points by which overlap is measured
# metres; median way by which an interpretation must move a cloud: errors of poses are smaller
SHIFT = 0.3
OTHER_PLACE = 1.0  # metres; by which it must move the sensor, if only the position differs
LAG = 2.0  # metres; way by which the middle of a cloud changes even if the sensor stays in it
SAME_HEIGHT = 0.5  # metres; standard deviation of the height above the ground, at most
MOST = 0.6  # share of pairs in which an interpretation must differ and be better
ALIKE = 0.02  # difference in overlap of interpretations that fit alike


@dataclass(frozen=True)
class Interpretation:
    """Another meaning of the same numbers.

    Attributes:
        name: name of the finding.
        problem: what is wrong if this interpretation is correct, in words.
        fix: how to fix it, a sentence.
        move: T_world_given under this interpretation, from the given pose: moves the given points
            to the world frame.
        pose: T_world_sensor under this interpretation, from the given pose.
        reading: what the numbers mean, in a few words; empty if the name says it.
    """

    name: str
    problem: str
    fix: str
    move: Pose
    pose: Pose
    reading: str = ""


SENSOR_FRAME = Interpretation(
    "points in sensor frame",
    "points are in the sensor frame, not in the world frame",
    "Read them with files:PATH --points-in sensor, or write T_world_sensor @ points to the files",
    lambda T: T,
    lambda T: T,
)


WORLD_FRAME = Interpretation(
    "points in world frame",
    "points are already in the world frame, but were transformed again",
    "Read them with files:PATH --points-in world",
    geometry.inverse,
    lambda T: T,
)


def _interpretations() -> tuple[Interpretation, ...]:
    frames = SENSOR_FRAME, WORLD_FRAME
    wrong_points = tuple(  # points in the sensor frame were transformed by a wrong pose
        Interpretation(
            f.name,
            f.problem,
            f.fix,
            lambda T, f=f: f.correct(T) @ geometry.inverse(T),  # type: ignore[misc]
            f.correct,
            f.reading,
        )
        for f in FAULTS
    )
    wrong_poses = tuple(
        Interpretation(f.name, f.problem, f.fix, lambda T: np.eye(4), f.correct, f.reading)
        for f in FAULTS
    )
    return frames + wrong_points + wrong_poses


INTERPRETATIONS = _interpretations()
AS_GIVEN = Interpretation("", "", "", lambda T: np.eye(4), lambda T: T)


class Interpretations:
    """Measures of interpretations on pairs of scans.

    Interpretations that share figures compute them once.

    Args:
        views: pairs of scans.
    """

    def __init__(self, views: Pairs) -> None:
        self.views = views
        self._figures: dict[bytes, float] = {}
        self._shifts: dict[bytes, float] = {}
        self._hidden: dict[bytes, tuple[float, float]] = {}

    def overlap(self, each: Interpretation) -> F64:
        """(P,) share of a scan's points that lie on the surfaces of the other, for each pair."""
        return np.array([self._overlap(k, self._between(each, k)) for k in range(len(self.views))])

    def shifts(self, each: Interpretation) -> F64:
        """(P,) metres: median way by which an interpretation moves a scan relative to the other one
        of its pair.
        """
        return np.array([self._shift(k, self._between(each, k)) for k in range(len(self.views))])

    def moves(self, each: Interpretation) -> F64:
        """(P,) metres: way by which an interpretation moves the sensor relative to its cloud."""
        paths = [self._path(each, k)[0] - b.T[:3, 3] for k, (_, b) in enumerate(self.views)]
        ways: F64 = np.linalg.norm(np.reshape(paths, (-1, 3)), axis=1)
        return ways

    def hidden(self, each: Interpretation) -> tuple[F64, F64]:
        """(P,) each: share of a scan's points behind its own surfaces, and behind those of the
        other scan.
        """
        figures = [self._hides(each, k) for k in range(len(self.views))]
        own, other = np.reshape(figures, (-1, 2)).T
        return own, other

    def hidden_at_once(self, each: Interpretation) -> float:
        """Share of points behind their own surfaces, seen from the position of the frame.

        Mean of all pairs.
        """
        return float(
            np.mean(
                [self._hides_at_once(k, self._path(each, k)[:1]) for k in range(len(self.views))]
            )
        )

    def _between(self, each: Interpretation, k: int) -> F64:
        a, b = self.views[k]
        T: F64 = geometry.inverse(each.move(a.T)) @ each.move(b.T)
        return T

    def _path(self, each: Interpretation, k: int) -> F64:
        """The sensor's way in the frame of the given points, which moves the origin instead of the
        points.
        """
        b = self.views[k][1]
        return geometry.apply(geometry.inverse(each.move(b.T)), b.path(each.pose))

    def _overlap(self, k: int, T: F64) -> float:
        key = _key(k, T)
        if key not in self._figures:
            a, b = self.views[k]
            self._figures[key] = a.surface.overlap(
                geometry.apply(T, b.points[:: 1 + len(b.points) // ENOUGH])
            )
        return self._figures[key]

    def _shift(self, k: int, T: F64) -> float:
        key = _key(k, T)
        if key not in self._shifts:
            points = self.views[k][1].points
            self._shifts[key] = float(
                np.median(np.linalg.norm(geometry.apply(T, points) - points, axis=1))
            )
        return self._shifts[key]

    def _hides(self, each: Interpretation, k: int) -> tuple[float, float]:
        (a, b) = self.views[k]
        path = self._path(each, k)
        T = self._between(each, k)
        key = _key(k, np.concatenate([T.ravel(), path.ravel()]))
        if key not in self._hidden:
            seen = geometry.apply(T, b.sample)
            self._hidden[key] = (
                hidden(b.sample, path),
                hidden(seen, geometry.apply(T, path), a.sample),
            )
        return self._hidden[key]

    def _hides_at_once(self, k: int, path: F64) -> float:
        key = _key(k, path)
        if key not in self._figures:
            self._figures[key] = hidden(self.views[k][1].sample, path)
        return self._figures[key]


def _key(number: int, array: F64) -> bytes:
    return bytes([number]) + np.round(array, 6).tobytes()


def better_interpretation(
    views: Pairs, others: Callable[[], Pairs], distant: Callable[[], Pairs]
) -> tuple[Interpretation, Finding] | None:
    """An interpretation that fits clouds and poses better than the given one, and its finding.

    Args:
        views: pairs of scans among which the interpretation is chosen.
        others: reads further pairs, on which it is verified.
        distant: reads pairs that are farther apart, for interpretations that fit alike.
    """
    if not views:
        return None
    found = Interpretations(views)
    finding = _by_overlap(found, distant) or _by_hidden_points(found) or _by_motion(found)
    if finding is None:
        return None
    chosen, _ = finding
    again = Interpretations(others())
    if not again.views or any(
        holds(again, chosen) for holds in (_gains, _hides_less_everywhere, _accompanies)
    ):
        return finding
    return None


def _by_overlap(
    found: Interpretations, distant: Callable[[], Pairs]
) -> tuple[Interpretation, Finding] | None:
    given = found.overlap(AS_GIVEN)
    better = [each for each in INTERPRETATIONS if _gain(found, each)[0] > GAIN]
    if not better:
        return None
    most = max(found.overlap(each).mean() for each in better)
    near = [each for each in INTERPRETATIONS if found.overlap(each).mean() > most - ALIKE]
    hides = {each: found.hidden(each)[0].mean() for each in near}
    near = [
        each
        for each in near
        if hides[each] <= LESS_HIDDEN[0] * min(hides.values()) + LESS_HIDDEN[1]
    ]
    least = min(_lies(found, each) for each in near)
    alike = _at_a_distance([each for each in near if _lies(found, each) == least], distant)
    best = alike[0]
    gain, far = _gain(found, best)
    now = given[far]
    then = found.overlap(best)[far]
    if (share := float((then > now + 0.02).mean())) < MOST:
        return None
    clear = gain > CLEAR_GAIN and share > 0.8 and (usual(best) or not alike[1:])
    confidence = Confidence.CERTAIN if clear else Confidence.LIKELY
    figures = f"{then.mean():.0%} of a scan then overlaps the other, instead of {now.mean():.0%}"
    problem = f"{best.problem}: {figures}{_as_well(best, alike)}"
    return best, Finding(best.name, confidence, problem, best.fix)


def _at_a_distance(
    near: list[Interpretation], distant: Callable[[], Pairs]
) -> list[Interpretation]:
    """Those that fit best at a distance, of interpretations that fit alike nearby."""
    if len(near) == 1 or not (views := distant()):
        return near
    found = Interpretations(views)
    fits = {each: found.overlap(each).mean() for each in near}
    most = max(fits.values())
    return [each for each in near if fits[each] > most - ALIKE]


def _as_well(best: Interpretation, alike: Sequence[Interpretation]) -> str:
    """The interpretations that fit as the best one does, in words that follow a sentence."""
    words = dict.fromkeys(f"{each.name} {each.reading}".strip() for each in (best, *alike))
    others = [*words][1:]
    return f"; the same with {' or '.join(others)}" if others else ""


def usual(each: Interpretation) -> bool:
    """Whether programs are known to make the mistake: not any order of four components."""
    return each.name != ORDER or each.problem in (W_FIRST.problem, W_LAST.problem)


def _gain(found: Interpretations, each: Interpretation) -> tuple[float, Bool]:
    """Mean increase in overlap on the pairs in which an interpretation moves the cloud, and (P,)
    bool: these pairs.

    If it moves the cloud in too few pairs, no increase, and all pairs.
    """
    far = found.shifts(each) > SHIFT
    if far.mean() < MOST:
        return 0.0, np.ones(len(far), np.bool_)
    return float((found.overlap(each) - found.overlap(AS_GIVEN))[far].mean()), far


def _lies(found: Interpretations, each: Interpretation) -> bool:
    """Whether the sensor lies on its side or its back.

    Turning the whole world leaves the overlap as it is.
    """
    return tilt_of(np.array([each.pose(b.T) for _, b in found.views])) > MAX_TILT


def _gains(found: Interpretations, each: Interpretation) -> bool:
    """Whether an interpretation increases the overlap in most pairs."""
    gain = found.overlap(each) - found.overlap(AS_GIVEN)
    return bool(gain.mean() > GAIN and (gain > 0.02).mean() >= MOST)


def _by_hidden_points(found: Interpretations) -> tuple[Interpretation, Finding] | None:
    overlap = found.overlap(AS_GIVEN).mean()
    at_once = found.hidden_at_once(AS_GIVEN)
    # Hidden points seen from the frame's own position are computed first, because most
    # interpretations hide more.
    tried = sorted(
        (
            (found.hidden_at_once(each), k)
            for k, each in enumerate(INTERPRETATIONS)
            if _moves_sensor(found, each)
        ),
    )
    for share, k in tried:
        each = INTERPRETATIONS[k]
        if (
            share < at_once
            and found.overlap(each).mean() > overlap - 0.03
            and _hides_less_everywhere(found, each)
        ):
            then, now = (float(found.hidden(which)[0].mean()) for which in (each, AS_GIVEN))
            shares = (
                f"a cloud then hides {then:.1%} of its points from the sensor, instead of {now:.1%}"
            )
            return each, Finding(
                each.name, Confidence.LIKELY, f"{each.problem}: {shares}", each.fix
            )
    return None


def _by_motion(found: Interpretations) -> tuple[Interpretation, Finding] | None:
    """Poses that do not move with their clouds, although those of an interpretation do, at one
    height above ground.
    """
    for each in INTERPRETATIONS[-len(FAULTS) :]:
        if _moves_sensor(found, each) and _accompanies(found, each):
            problem = (
                f"{each.problem}: the clouds move, but the sensor then stays behind by "
                f"{_lag(found, AS_GIVEN):.0f} m"
            )
            return each, Finding(each.name, Confidence.LIKELY, problem, each.fix)
    return None


def _accompanies(found: Interpretations, each: Interpretation) -> bool:
    """Whether the sensor stays with its cloud and above the ground, as it does not with the given
    poses.
    """
    lag = _lag(found, AS_GIVEN)
    return bool(
        lag > LAG
        and _lag(found, each) < 0.4 * lag
        and _level(found, each)
        and not _level(found, AS_GIVEN)
    )


def _lag(found: Interpretations, each: Interpretation) -> float:
    """Standard deviation of the way from the sensor to the middle of its cloud, metres."""
    ways = [np.median(b.sample, axis=0) - each.pose(b.T)[:3, 3] for _, b in found.views]
    return float(np.linalg.norm(np.std(ways, axis=0)))


def _outside(found: Interpretations, each: Interpretation) -> float:
    """Share of the scans whose sensor is farther from the middle of its cloud than nine of ten
    points.
    """
    outside = []
    for _, b in found.views:
        middle = np.median(b.sample, axis=0)
        radius = np.percentile(np.linalg.norm(b.sample - middle, axis=1), 90)
        outside.append(np.linalg.norm(each.pose(b.T)[:3, 3] - middle) > radius)
    return float(np.mean(outside))


def _level(found: Interpretations, each: Interpretation) -> bool:
    """Whether the sensor is at one height above the ground in most scans."""
    layers = [
        ground_below(b, np.array([0.0, 0.0, 1.0]), each.pose(b.T)[:3, 3]) for _, b in found.views
    ]
    heights = np.array([height for height, share in layers if share >= FLAT])
    return len(heights) >= MOST * len(layers) and float(np.std(heights)) < SAME_HEIGHT


def _moves_sensor(found: Interpretations, each: Interpretation) -> bool:
    """Whether an interpretation places the sensor elsewhere in its cloud, in most pairs."""
    return bool((found.moves(each) > OTHER_PLACE).mean() >= MOST)


def _hides_less_everywhere(found: Interpretations, each: Interpretation) -> bool:
    """Whether fewer points are behind surfaces, of their own scan and of the other one, where the
    sensor moves.
    """
    if not _moves_sensor(found, each) or _lag(found, each) > _lag(found, AS_GIVEN) + LAG:
        return False
    if _outside(found, each) > _outside(
        found, AS_GIVEN
    ):  # far away, a cloud hides nothing of itself
        return False
    forwards, turned = (
        facing(np.array([which.pose(b.T) for _, b in found.views])) for which in (AS_GIVEN, each)
    )
    if forwards > 0.9 and turned < -0.5:
        return False
    elsewhere = found.moves(each) > OTHER_PLACE
    return all(
        hides_less(then[elsewhere], now[elsewhere])
        for then, now in zip(found.hidden(each), found.hidden(AS_GIVEN), strict=True)
    )


def hides_less(
    other: F64, given: F64, times: float = LESS_HIDDEN[0], share: float = LESS_HIDDEN[1]
) -> bool:
    """Whether hidden points decrease by a factor, in most pairs and on average, and by a share of
    all points.
    """
    in_most_pairs = (given > times * other).mean() >= MOST
    return bool(in_most_pairs and given.mean() > max(times * other.mean(), other.mean() + share))
