"""The places of a run that are worth a decision, found without ground truth.

Kept points may be movers, removed ones may be static. Both are joined into objects over the frames,
and ordered by what a decision is expected to change: the probability that the answer is wrong,
times the number of points.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dynaviz.arrays import F64, I32, I64, Bool
from dynaviz.contracts.scan import Scan
from dynaviz.reviews.calibration import FEATURES, probability
from dynaviz.reviews.regions import ObjectRegion, Piece, clock_of, packed_cells, time_of
from dynaviz.reviews.visibility import EDGE, PlaceCounter, RangeImages, SeenPlaces

JOIN = 2  # places to an edge of the cells in which objects are joined
PASSES = 2  # scans that pass through a place that a mover left
SEEN = 0.5  # share of passes in passes and hits from which a place was empty for most of the time
STANDS = 0.5  # share of the scans, of at most ``LONG``, that hit a place where something stands
LONG = 20
LONGEST = 15.0  # metres: larger objects that were kept are no road users
LOWEST = 0.4  # metres, of their height above the ground that is left out
HIGHEST = 4.0
FEWEST = 10  # points of a candidate
KEEP = 1000  # candidates of a run
Answer = Literal["kept", "removed"]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A place or an object whose answer may be wrong.

    Attributes:
        number: 1 for the one that is expected to change most.
        answered: what the run did with it: ``kept`` or ``removed``.
        points: how many points of this answer it has.
        wrong: probability that the answer is wrong.
        first_frame, last_frame: positions of its frames.
        low, high: (3,) metres, world of the source: the box around it in all its frames.
        region: what a decision about it covers.
        features: what the probability is computed from, by name.
        key: tells it from others in a review.
    """

    number: int
    answered: Answer
    points: int
    wrong: float
    first_frame: int
    last_frame: int
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    region: ObjectRegion
    features: dict[str, float]
    key: str

    @property
    def expected(self) -> float:
        """Points that a decision is expected to change."""
        return self.wrong * self.points

    @property
    def title(self) -> str:
        """Size and place in a few words."""
        size = " x ".join(f"{b - a:.1f}" for a, b in zip(self.low, self.high, strict=True))
        middle = [(a + b) / 2 for a, b in zip(self.low, self.high, strict=True)]
        return f"{size} m at " + ", ".join(f"{value:.1f}" for value in middle)

    def __repr__(self) -> str:
        return f"<Candidate {self.number}. {self.sentence}>"

    @property
    def sentence(self) -> str:
        """The candidate in one line."""
        frames = (
            f"frame {self.first_frame}"
            if self.first_frame == self.last_frame
            else f"frames {self.first_frame} to {self.last_frame}"
        )
        what = "a mover" if self.answered == "kept" else "static"
        return (
            f"{self.answered.capitalize()}: {self.points:,} points in {frames}, {self.title}; "
            f"{self.wrong:.0%} likely to be {what}"
        )


@dataclass(frozen=True, eq=False)
class FoundCandidates:
    """The candidates of a run.

    Attributes:
        candidates: at most ``KEEP``, the one that is expected to change most first.
        looks: what the scans saw.
    """

    candidates: tuple[Candidate, ...]
    looks: RangeImages


def candidates(
    scans: Iterable[Scan], labels: Iterable[Bool], origin: F64 | None = None
) -> tuple[Candidate, ...]:
    """The candidates of a run, the one that is expected to change most first.

    Args:
        scans: of the sequence, in order.
        labels: (N,) bool for each scan, True for removed points.
        origin: (3,) float64, metres: offset of the sequence's world.

    Returns:
        At most ``KEEP``.
    """
    return found_in(zip(scans, labels, strict=True), origin).candidates


def found_in(scans: Iterable[tuple[Scan, Bool]], origin: F64 | None = None) -> FoundCandidates:
    """The candidates, and what the scans saw.

    Args:
        scans: each with its (N,) bool labels, in order.
        origin: as for ``candidates``.
    """
    counter = PlaceCounter()
    times: list[Scan] = []
    for scan, dynamic in scans:
        counter.add(scan, dynamic)
        times.append(without_points(scan))
    places = counter.finish()
    found = [
        *_found(places, "kept", _kept_ghosts(places)),
        *_found(places, "kept", _kept_objects(places)),
    ]
    removed = places.removed > places.kept
    empty = _looks_empty(places)
    stands = _stands(places) & ~empty
    for kind in (empty, stands, ~(empty | stands)):
        found += _found(places, "removed", removed & kind)
    order = sorted(found, key=lambda each: (-each.expected, each.rows[0]))[:KEEP]
    offset = np.zeros(3) if origin is None else origin
    named = tuple(each.named(k + 1, places, times, offset) for k, each in enumerate(order))
    return FoundCandidates(named, counter.looks)


def _stands(places: SeenPlaces) -> Bool:
    """(N,) bool: rows of places that many scans hit."""
    scans = int(places.frame.max(initial=0)) + 1
    found: Bool = places.hits[places.place] >= STANDS * min(scans, LONG)
    return found


def _kept_objects(places: SeenPlaces) -> Bool:
    """(N,) bool: rows of kept objects with the size of a road user, which were not seen through."""
    rows = np.flatnonzero(
        (places.kept >= np.maximum(places.removed, 1)) & ~places.ground & ~_looks_empty(places)
    )
    found = np.zeros(len(places.place), np.bool_)
    if not len(rows):
        return found
    cell = places.cell[places.place[rows]]
    objects = joined(np.zeros(len(rows), np.int32), cell // JOIN)
    order = np.argsort(objects, kind="stable")
    starts = np.flatnonzero(np.diff(objects[order], prepend=-1))
    low = np.minimum.reduceat(cell[order], starts)
    high = np.maximum.reduceat(cell[order], starts)
    size = (high - low + 1) * EDGE
    fits = (size[:, :2].max(1) < LONGEST) & (size[:, 2] > LOWEST) & (size[:, 2] < HIGHEST)
    found[rows] = fits[objects]
    return found


@dataclass(frozen=True, eq=False)
class _Found:
    """A candidate as rows of the places."""

    answered: Answer
    rows: I64
    points: int
    features: dict[str, float]
    wrong: float

    @property
    def expected(self) -> float:
        return self.wrong * self.points

    def named(self, number: int, places: SeenPlaces, times: list[Scan], origin: F64) -> Candidate:
        frames = places.frame[self.rows]
        cells = places.cell[places.place[self.rows]].astype(np.int64)
        clock = clock_of(times[int(frames[0])])
        pieces = []
        order = np.argsort(frames, kind="stable")
        starts = np.flatnonzero(np.diff(frames[order], prepend=-1))
        for part in np.split(order, starts[1:]):
            frame = int(frames[part[0]])
            inside = cells[part]
            low = inside.min(0)
            time = time_of(times[frame], clock)
            assert time is not None
            pieces.append(
                Piece(
                    time,
                    tuple((low * EDGE + origin).tolist()),
                    tuple(((inside.max(0) + 1) * EDGE + origin).tolist()),
                    packed_cells(inside - low),
                )
            )
        pieces.sort(key=lambda piece: piece.time)
        low = cells.min(0) * EDGE + origin
        high = (cells.max(0) + 1) * EDGE + origin
        region = ObjectRegion(clock, tuple(pieces), EDGE)
        text = f"{self.answered} {pieces[0].time} {pieces[-1].time} {low} {high} {self.points}"
        return Candidate(
            number,
            self.answered,
            self.points,
            self.wrong,
            int(frames.min()),
            int(frames.max()),
            tuple(low.tolist()),
            tuple(high.tolist()),
            region,
            self.features,
            hashlib.sha256(text.encode()).hexdigest()[:12],
        )


def _looks_empty(places: SeenPlaces) -> Bool:
    """(N,) bool: rows of places that rays passed through in most of the scans that saw them."""
    passes = places.passes[places.place]
    hits = places.hits[places.place]
    found: Bool = (passes >= PASSES) & (passes >= SEEN * (passes + hits))
    return found


def _kept_ghosts(places: SeenPlaces) -> Bool:
    """(N,) bool: rows with kept points in places that were empty for most of the time."""
    mostly = places.kept >= np.maximum(places.removed, 1)
    found: Bool = mostly & ~places.ground & _looks_empty(places)
    return found


def _found(places: SeenPlaces, answered: Answer, chosen: Bool) -> list[_Found]:
    """Objects of chosen rows, with the probability that their answer is wrong."""
    rows = np.flatnonzero(chosen)
    if not len(rows):
        return []
    objects = joined(places.frame[rows], places.cell[places.place[rows]] // JOIN)
    own = places.kept if answered == "kept" else places.removed
    other = places.removed if answered == "kept" else places.kept
    points = np.bincount(objects, own[rows]).astype(np.int64)
    order = np.argsort(objects, kind="stable")
    starts = np.searchsorted(objects[order], np.arange(len(points) + 1))
    found = []
    for k in np.flatnonzero(points >= FEWEST).tolist():
        of = rows[order[starts[k] : starts[k + 1]]]
        features = _features(places, answered, of, own, other)
        wrong = probability(answered, features)
        found.append(_Found(answered, of, int(points[k]), features, wrong))
    return found


def joined(frame: I32, cell: I32) -> I64:
    """(N,) object of each row: cells that touch in a frame, or from one frame to the next."""
    at = np.column_stack([frame, cell]).astype(np.int64)
    at -= at.min(0) - 1
    sizes = at.max(0) + 2
    steps = np.array([sizes[1:].prod(), sizes[2:].prod(), sizes[3], 1])
    keys, inverse = np.unique(at @ steps, return_inverse=True)
    ends: list[tuple[I64, I64]] = []
    around = list(itertools.product((-1, 0, 1), repeat=3))
    shifts = [(0, *each) for each in around if each > (0, 0, 0)]
    shifts += [(1, *each) for each in around] + [(2, 0, 0, 0)]
    for shift in shifts:
        wanted = keys + np.array(shift) @ steps
        k = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        same = np.flatnonzero(keys[k] == wanted)
        ends.append((same, k[same]))
    first = np.concatenate([one for one, _ in ends])
    second = np.concatenate([two for _, two in ends])
    graph = coo_array((np.ones(len(first), np.bool_), (first, second)), (len(keys), len(keys)))
    _, objects = connected_components(graph, directed=False)
    found: I64 = objects[inverse].astype(np.int64)
    return found


def _features(
    places: SeenPlaces, answered: Answer, rows: I64, own: I32, other: I32
) -> dict[str, float]:
    """The features of an object, by the names in ``FEATURES``."""
    weights = own[rows].astype(np.float64)
    place = places.place[rows]
    passes = places.passes[place].astype(np.float64)
    hits = places.hits[place].astype(np.float64)
    frames = places.frame[rows]
    first = frames == frames.min()
    last = frames == frames.max()
    middle = [places.cell[place[part]].mean(0) * EDGE for part in (first, last)]
    low = places.cell[place].min(0)
    high = places.cell[place].max(0) + 1
    values = {
        "passed": np.average(passes / (passes + hits), weights=weights),
        "passes": np.log1p(np.average(passes, weights=weights)),
        "hits": np.log1p(np.average(hits, weights=weights)),
        "frames": np.log1p(len(np.unique(frames)) - 1),
        "ground": np.average(places.ground[rows], weights=weights),
        "mixed": other[rows].sum() / (other[rows].sum() + weights.sum()),
        "moved": np.log1p(np.linalg.norm(middle[1] - middle[0])),
        "size": np.log1p((high - low)[:2].max() * EDGE),
        "height": np.log1p((high - low)[2] * EDGE),
        "points": np.log1p(weights.sum()),
    }
    assert tuple(values) == FEATURES
    return {name: float(value) for name, value in values.items()}


def without_points(scan: Scan) -> Scan:
    """The scan with its times alone."""
    return Scan(scan.index, np.empty((0, 3), np.float32), scan.T_world_sensor, scan.stamp_ns)
