"""Recounts the causes of failure cases from the scans and the labels of runs.

Looks at other points of the cases than the runs did, by ``reference.looks``, and uses none of the
product's code for looks, surfaces or causes; only the points of each case are grouped by it, since
boxes of cases overlap. ``eval/README.md`` states the criteria.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from scipy.spatial import cKDTree

import dynaviz as dv
from dynaviz.contracts import registry
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Scan
from dynaviz.runs.run import open_run
from dynaviz.scores.failure_case import ROUNDED, FailureCase
from dynaviz_eval import failures
from helpers.reference.looks import GRAZING, HIT, NAMES, THROUGH, Returns

SAMPLE = 128
LEAST = 64  # other points than those of the run; else these count as well
DRAWN = 200  # samples of the points of a case
MOST = failures.MOST_LOOKED_AT  # points of a case that a run looks at


@dataclass(frozen=True)
class Recounted:
    """A listed case: what was stated, and what was found at other points of it.

    Attributes:
        run: its folder; number: of the case.
        shares: how often samples of these points give each cause.
        figures: of all of them.
    """

    run: Path
    number: int
    case: FailureCase
    found: str
    shares: dict[str, float]
    figures: dict[str, float]

    @property
    def holds(self) -> bool:
        """Whether other points of the case may have the stated cause."""
        stated = self.case.cause or ""
        return self.found == stated or self.shares.get(stated, 0.0) >= 0.025

    def __str__(self) -> str:
        case = self.case
        figures = {name: round(value, 2) for name, value in self.figures.items()}
        return (
            f"{self.run.name} {self.number} {case.kind} {case.what}: {case.cause!r}, "
            f"recounted {self.found!r} {figures}"
        )


@dataclass(frozen=True)
class CasePoints:
    """Points of a listed case.

    Attributes:
        run: its folder; number: of the case.
        points: (K, 3) metres, world frame; frames: (K,) that measured them.
        seen: (K,) of each name: what the other scans saw there, from ``look_at``.
    """

    run: Path
    number: int
    case: FailureCase
    points: np.ndarray
    frames: np.ndarray
    seen: dict[str, np.ndarray] = field(default_factory=dict)


class Surroundings:
    """The returns of one scan by place, and its dynamic points."""

    def __init__(self, scan: Scan) -> None:
        points = np.asarray(scan.points, float)
        self.sensor = np.asarray(scan.origins[0], float)
        self.points = points[np.isfinite(points).all(1)]
        self.space = cKDTree(self.points)
        dynamic = np.isfinite(points).all(1) & (np.asarray(scan.labels) == 1)
        self.movers = cKDTree(points[dynamic]) if dynamic.any() else None

    def normals(self, places: np.ndarray) -> np.ndarray:
        """(K, 3) unit normals of the surfaces through own points; NaN where they are on none."""
        found = np.full((len(places), 3), np.nan)
        left = np.arange(len(places))
        for reach in (0.4, 0.8, 1.6):  # half the edges of cubes
            around = self.space.query_ball_point(places[left], reach, p=np.inf)
            flat = np.zeros(len(left), bool)
            for k, (at, near) in enumerate(zip(left, around, strict=True)):
                if len(near) < 4:
                    continue
                spread, axes = np.linalg.eigh(np.cov(self.points[near].T))
                flat[k] = spread[0] < 0.07**2 and spread[1] > 0.15**2
                if flat[k]:
                    found[at] = axes[:, 0]
            left = left[~flat]
        ways = (places - self.sensor) / np.linalg.norm(places - self.sensor, axis=1)[:, None]
        with np.errstate(invalid="ignore"):
            along_ring = np.abs((ways * found).sum(1)) < np.sin(np.radians(1.0))
        found[along_ring] = np.nan
        return found


def points_of_cases(folder: Path, scans: list[Scan]) -> list[CasePoints]:
    """Up to ``SAMPLE`` points of each listed case that its run did not look at.

    All points of a case that has too few others.
    """
    run = open_run(folder)
    labels = run.labeller
    with mock.patch.multiple(failures, LOOKED_AT=2 * MOST, MOST_LOOKED_AT=2 * MOST):
        metric = failures.FailuresMetric(registry.load("methods", run.result.method).info)
        for k, scan in enumerate(scans):
            answer = labels.label(scan)
            metric.update(Labelled.of(k, scan, answer.dynamic, answer.reasons, answer.answered))
        metric.places()
        found = [each.sample for each in metric._found]
    cases = run.result.failures
    assert len(found) == len(cases)
    every = []
    for number, (case, sample) in enumerate(zip(cases, found, strict=True), 1):
        sample = sample[np.argsort(sample["priority"])]
        assert len(sample) == min(case.points, 2 * MOST), f"case {number} has other points"
        taken = case.looks.points if case.looks else 0
        others = sample[taken : taken + SAMPLE]
        chosen = others if len(others) >= LEAST else sample
        check_points(case, chosen, scans, labels)
        points = chosen["xyz"].astype(float)
        every.append(CasePoints(folder, number, case, points, chosen["frame"].astype(int)))
    return every


def check_points(case: FailureCase, chosen: np.ndarray, scans: list[Scan], labels: Any) -> None:
    """Check that points of a case are wrong, of its object and class, and in its box and frames."""
    kept = case.kind == "false_negative"
    assert (chosen["xyz"] >= np.array(case.low) - ROUNDED).all()
    assert (chosen["xyz"] <= np.array(case.high) + ROUNDED).all()
    for k in np.unique(chosen["frame"]):
        assert case.first_frame <= k <= case.last_frame
        rows = chosen["row"][chosen["frame"] == k]
        scan = scans[k]
        assert (np.asarray(scan.labels)[rows] == kept).all()
        assert (labels.label(scan).dynamic[rows] != kept).all()
        if case.instance is not None:
            assert (np.asarray(scan.instances)[rows] == case.instance).all()
        if case.class_ is not None:
            assert (np.asarray(scan.classes)[rows] == case.class_).all()


def looked_at(points: np.ndarray, frames: np.ndarray, scans: list[Scan]) -> dict[str, np.ndarray]:
    """What the other scans saw at each point: (K,) of each name."""
    normals = np.full(points.shape, np.nan)
    mover = np.full(len(points), np.inf)
    for k in np.unique(frames):
        own = frames == k
        around = Surroundings(scans[k])
        normals[own] = around.normals(points[own])
        if around.movers is not None:
            mover[own] = around.movers.query(points[own])[0]
    looks = np.empty((len(scans), len(points)), np.int8)
    grazing = np.zeros(looks.shape, bool)
    close = np.zeros(looks.shape, bool)
    cap = Returns(scans[0]).parts[0].spacing()
    for k, scan in enumerate(scans):
        code, behind, ways = Returns(scan).look(points, cap)
        looks[k] = np.where(frames == k, -1, code)
        with np.errstate(invalid="ignore"):
            grazing[k] = np.abs((ways * normals).sum(1)) < GRAZING
        close[k] = behind < 1.0
    through = looks == THROUGH
    hit = looks == HIT
    hit[frames, np.arange(len(frames))] = True
    first = hit.argmax(0)
    last = len(scans) - 1 - hit[::-1].argmax(0)
    number = np.arange(len(scans))[:, None]
    known = np.isfinite(normals[:, 0])
    return {
        **{name: (looks == code).sum(0) for code, name in enumerate(NAMES)},
        "first": first,
        "last": last,
        "before": (through & (number < first)).sum(0),
        "after": (through & (number > last)).sum(0),
        "close": (through & close).sum(0),
        "grazing": (through & grazing).sum(0) * known,
        "known": through.sum(0) * known,
        "surface": known,
        "mover": mover,
    }


def figures(found: dict[str, np.ndarray], rows: np.ndarray) -> dict[str, float]:
    """Sums and shares over some of the points."""
    some = {name: values[rows] for name, values in found.items()}
    passes = max(float(some["through"].sum()), 1.0)
    return {
        **{name: float(some[name].sum()) for name in NAMES},
        "seen": float((some["through"] > 0).mean()),
        "hits": float(np.median(some["hit"])),
        "before": float(some["before"].sum()) / passes,
        "after": float(some["after"].sum()) / passes,
        "close": float(some["close"].sum()) / passes,
        "grazing": float(some["grazing"].sum()) / max(float(some["known"].sum()), 1.0),
        "surface": float(some["surface"].mean()),
        "mover": float(np.median(some["mover"])),
    }


def causes_of(kept: bool, found: dict[str, np.ndarray], word: Any) -> tuple[str, dict[str, float]]:
    """The cause that the criteria give, and the share of samples of the points with each cause."""
    count = len(found["hit"])
    decide = kept_cause if kept else removed_cause
    rng = np.random.default_rng(2)
    size = max(count // 2, 1)  # what the run found is a sample, too
    drawn = [decide(figures(found, rng.integers(0, count, size)), word) for _ in range(DRAWN)]
    names, times = np.unique(drawn, return_counts=True)
    shares = dict(zip(names.tolist(), (times / DRAWN).tolist(), strict=True))
    return decide(figures(found, np.arange(count)), word), shares


def kept_cause(found: dict[str, float], word: Any) -> str:
    stood = found["hit"] >= 4 * found["through"]
    stood = stood and found["hit"] > 0
    stood = stood and found["hit"] >= max(found["hidden"], found["between"])
    if found["seen"] >= 0.5 and not stood:
        if word == "taken for ground":
            return "seen through, but taken for ground"
        if word in ("height limit", "out of range"):
            return "seen through, but beyond a limit"
        if found["hit"] >= found["through"]:
            return "seen through, but hits outweigh"
        if found["before"] >= 0.5 and found["hits"] >= 1:
            return "seen through before it came"
        return "seen through, but the method demands more"
    names = {"stood there": "hit", "hidden": "hidden", "between rays": "between"}
    most = max(names, key=lambda name: found[names[name]])
    if found[names[most]]:
        return most
    return "outside of the view" if found["outside"] else "cannot be told"


def removed_cause(found: dict[str, float], word: Any) -> str:
    if found["hit"] + found["through"] + found["hidden"] == 0 and np.isinf(found["mover"]):
        return "cannot be told"
    if found["seen"] < 0.5:
        near = "no mover near" if found["mover"] > 3.0 else "a mover near"
        near = "a mover in its cell" if found["mover"] <= 0.5 else near
        return f"no ray through most of it: {near}"
    if found["hits"] <= 1:
        return "seen in one or two scans only"
    if found["grazing"] > 0.5 and found["surface"] >= 0.25:
        return "grazing rays"
    if found["surface"] >= 0.5 and found["close"] >= 0.5:
        return "poses disagree"
    apart = found["before"] + found["after"]
    return "seen through at other times" if apart > 0.5 else "thin or rough"


def scans_of(sequence: str) -> list[Scan]:
    """All scans of a sequence."""
    opened = dv.open(sequence)
    return [opened[k] for k in range(len(opened))]


def look_at(runs: Iterable[Path], scans: list[Scan]) -> list[CasePoints]:
    """Points of the listed cases of runs on a drive, and what the other scans saw there."""
    cases = [each for folder in runs for each in points_of_cases(folder, scans)]
    seen = looked_at(
        np.concatenate([each.points for each in cases]),
        np.concatenate([each.frames for each in cases]),
        scans,
    )
    found = []
    start = 0
    for each in cases:
        rows = slice(start, start + len(each.points))
        start = rows.stop
        found.append(replace(each, seen={name: values[rows] for name, values in seen.items()}))
    return found


def recounted(cases: Iterable[CasePoints]) -> list[Recounted]:
    """The causes of cases, recounted."""
    found = []
    for each in cases:
        kept = each.case.kind == "false_negative"
        cause, shares = causes_of(kept, each.seen, each.case.word)
        every_point = figures(each.seen, np.arange(len(each.points)))
        found.append(Recounted(each.run, each.number, each.case, cause, shares, every_point))
    return found
