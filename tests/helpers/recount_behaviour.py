"""Recounts the behaviour of failure cases from all points of a drive.

Uses none of the product's code for tracks, motion or visits; only the points of each case are
grouped by it, as in ``recount``. ``eval/README.md`` states the criteria.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynaviz.contracts.scan import Scan
from dynaviz.scores.failure_case import FailureCase
from dynaviz_eval.ground import scan_heights
from helpers.recount import DRAWN, CasePoints

WINDOW = 10  # frames
STILL = 0.5  # metres
END = 10  # frames
LATE = 0.75  # of the drive
FAR = 30.0  # metres
BRIEF = 5  # frames
CELL = 0.5  # metres


@dataclass(frozen=True)
class RecountedBehaviour:
    """A listed case: what it is said to have done, and the words that its points allow."""

    run: Path
    number: int
    case: FailureCase
    allowed: frozenset[str | None]
    figures: str

    @property
    def holds(self) -> bool:
        """Whether the points allow what was said."""
        return self.case.behaviour in self.allowed

    def __str__(self) -> str:
        case = self.case
        return (
            f"{self.run.name} {self.number} {case.kind} {case.what} {case.instance} in "
            f"{case.first_frame}-{case.last_frame}: {case.behaviour!r}, recounted "
            f"{sorted(map(str, self.allowed))} {self.figures}"
        )


def cells_of(points: np.ndarray, size: float, axes: int) -> np.ndarray:
    """(K, axes) cells of points."""
    return np.floor(points[:, :axes] / size).astype(np.int64)


def keys(cells: np.ndarray) -> np.ndarray:
    """(K,) one number for each cell."""
    return cells @ np.array([1, 1 << 20, 1 << 40])[: cells.shape[1]]


class Neighbourhood:
    """Cells of points, and those that touch them."""

    def __init__(self, points: np.ndarray, axes: int) -> None:
        self.axes = axes
        steps = np.stack(np.meshgrid(*[[-1, 0, 1]] * axes), -1).reshape(-1, axes)
        cells = np.unique(cells_of(points, CELL, axes), axis=0)
        self.keys = np.unique(keys((cells[:, None] + steps).reshape(-1, axes)))

    def reached(self, points: np.ndarray) -> np.ndarray:
        """(K,) bool: which points lie in it."""
        return np.isin(keys(cells_of(points, CELL, self.axes)), self.keys)


class Frames:
    """Scans, and where their movers and what stands there reach."""

    def __init__(self, scans: list[Scan]) -> None:
        self.scans = scans
        self.last = len(scans) - 1
        self._movers: dict[int, Neighbourhood] = {}
        self._standing: dict[int, Neighbourhood] = {}

    def movers(self, k: int) -> Neighbourhood:
        """Around the dynamic points of a scan."""
        if k not in self._movers:
            scan = self.scans[k]
            dynamic = (np.asarray(scan.labels) == 1) & finite(scan)
            self._movers[k] = Neighbourhood(np.asarray(scan.points[dynamic], float), 3)
        return self._movers[k]

    def standing(self, k: int) -> Neighbourhood:
        """Around the static points of a scan at 0.25 to 3 m above the ground, in columns."""
        if k not in self._standing:
            scan = self.scans[k]
            heights = scan_heights(scan)
            static = (np.asarray(scan.labels) == 0) & (heights >= 0.25) & (heights < 3.0)
            points = np.asarray(scan.points[static & finite(scan)], float)
            self._standing[k] = Neighbourhood(points, 2)
        return self._standing[k]


def finite(scan: Scan) -> np.ndarray:
    return np.isfinite(np.asarray(scan.points, float)).all(1)


class ObjectTrack:
    """All dynamic points of one object of the truth, frame by frame."""

    def __init__(self, case: FailureCase, drive: Frames) -> None:
        self.frames = []
        self.low = []
        self.high = []
        self.ranges = []
        self.touching = []
        for k, scan in enumerate(drive.scans):
            own = (np.asarray(scan.instances) == case.instance) & (np.asarray(scan.labels) == 1)
            own &= finite(scan)
            if case.class_ is not None:
                own &= np.asarray(scan.classes) == case.class_
            if not own.any():
                continue
            points = np.asarray(scan.points[own], float)
            self.frames.append(k)
            self.low.append(points[:, :2].min(0))
            self.high.append(points[:, :2].max(0))
            origins = np.broadcast_to(scan.origins, scan.points.shape)[own]
            self.ranges.append(np.linalg.norm(points - origins, axis=1))
            here = case.first_frame <= k <= case.last_frame
            none = np.zeros(0, bool)
            self.touching.append(drive.standing(k).reached(points) if here else none)

    def standing(self, still: float) -> set[int]:
        """Frames in which both ends of its box moved by less than this in ten frames."""
        found = set()
        for i, first in enumerate(self.frames):
            later = [j for j, frame in enumerate(self.frames) if frame >= first + WINDOW]
            if not later:
                continue
            j = later[0]
            low = self.low[j] - self.low[i]
            high = self.high[j] - self.high[i]
            same = np.sign(low) * np.sign(high) > 0
            moved = np.where(same, np.minimum(np.abs(low), np.abs(high)), 0.0)
            if np.linalg.norm(moved) < still:
                found |= set(self.frames[i : j + 1])
        return found

    def behaviour(self, case: FailureCase, end: int, still: float) -> str | None:
        """What it did in the frames of a case."""
        stood = self.standing(still)
        own = [k for k in self.frames if case.first_frame <= k <= case.last_frame]
        if all(k in stood for k in self.frames if k >= own[-1]):
            share = np.mean([k in stood for k in own])
            return "stood still until the end" if share >= 0.5 else "came to a stop"
        if all(k in stood for k in self.frames if k <= own[0]):
            return "waited first"
        if any(k in stood for k in own):
            return "stopped on its way"
        if self.frames[0] > max(end - END, LATE * end):
            return "end of the drive"
        if self.frames[0] > LATE * end and self.frames[-1] > end - END:
            return "arrived late"
        rows = [self.frames.index(k) for k in own]
        if np.concatenate([self.ranges[row] for row in rows]).mean() > FAR:
            return "far away"
        touching = np.concatenate([self.touching[row] for row in rows]).mean()
        if touching > 0.5:
            return "touched something"
        return "passed by" if len(self.frames) > 1 else None


def place_words(each: CasePoints, drive: Frames) -> frozenset[str]:
    """What a static place may have done: by samples of the points of its case."""
    near = np.zeros(len(each.points), bool)
    away = np.zeros(len(each.points))
    for k in np.unique(each.frames):
        own = each.frames == k
        near[own] = drive.movers(k).reached(each.points[own])
        away[own] = np.linalg.norm(each.points[own] - drive.scans[k].origins.mean(0), axis=1)
    rng = np.random.default_rng(3)
    words = []
    count = max(len(near) // 2, 1)  # what the run found is a sample, too
    chosen = [rng.integers(0, len(near), count) for _ in range(DRAWN - 1)]
    for rows in [np.arange(len(near)), *chosen]:
        hits = np.median(each.seen["hit"][rows]) + 1
        first = np.median(each.seen["first"][rows])
        last = np.median(each.seen["last"][rows])
        if near[rows].mean() > 0.5:
            words.append("next to a mover")
        elif away[rows].mean() > FAR:
            words.append("far away")
        elif hits <= BRIEF:
            words.append("seen briefly")
        elif first > LATE * drive.last:
            words.append("seen late")
        else:
            gaps = 2 * hits < last - first + 1
            words.append("seen on and off" if gaps else "always in view")
    some = {word for word in words if words.count(word) >= 0.025 * DRAWN}
    return frozenset({words[0], *some})


def recounted_behaviours(
    cases: Iterable[CasePoints], scans: list[Scan]
) -> list[RecountedBehaviour]:
    """The behaviours of cases on a drive, except those of objects without a number."""
    drive = Frames(scans)
    found = []
    tracks: dict[tuple[int | None, int, int, int], ObjectTrack] = {}
    for each in cases:
        case = each.case
        if case.kind == "false_positive":
            words = place_words(each, drive)
            figures = str({name: np.median(each.seen[name]) for name in ("hit", "first", "last")})
        elif case.instance is None:
            continue
        else:
            key = case.class_, case.instance, case.first_frame, case.last_frame
            if key not in tracks:
                tracks[key] = ObjectTrack(case, drive)
            track = tracks[key]
            # a box that moves by 0.5 m, to a centimetre, may have stood or not
            near = (STILL - 0.01, STILL, STILL + 0.01)
            words = frozenset(track.behaviour(case, drive.last, still) for still in near)
            figures = f"seen {track.frames[0]}-{track.frames[-1]}"
        found.append(RecountedBehaviour(each.run, each.number, case, words, figures))
    return found
