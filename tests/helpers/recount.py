"""Recounts the causes of failure cases from the scans and the labels of a run.

Looks at other points than the run did, by ``reference.looks``, and uses none of the product's code
for looks, surfaces or causes. ``eval/README.md`` states the criteria.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from scipy.spatial import cKDTree

import dynaviz as dv
from dynaviz.contracts.scan import Scan
from helpers.reference.looks import GRAZING, HIT, NAMES, THROUGH, Returns

SAMPLE = 128
SAMPLES = 200  # of the points of a case, drawn with replacement


@dataclass(frozen=True)
class Recounted:
    """A listed case: what was stated, and what was found at other points of it.

    Attributes:
        shares: how often samples of these points give each cause.
        figures: of all of them.
    """

    number: int
    kind: str
    what: str
    stated: str
    found: str
    shares: dict[str, float]
    figures: dict[str, float]

    @property
    def holds(self) -> bool:
        """Whether other points of the case may have the stated cause."""
        return self.shares.get(self.stated, 0.0) >= 0.025


class Surroundings(Returns):
    """The returns of one scan, also by place, and its dynamic points."""

    def __init__(self, scan: Scan) -> None:
        super().__init__(scan)
        self.points = np.asarray(scan.points, float)
        self.space = cKDTree(np.nan_to_num(self.points, nan=1e9, posinf=1e9, neginf=1e9))
        labels = np.asarray(scan.labels)
        self.movers = cKDTree(self.points[labels == 1]) if (labels == 1).any() else None

    def normals(self, places: np.ndarray) -> np.ndarray:
        """(K, 3) unit normals of the surfaces through own points; NaN where they are on none."""
        found = np.full((len(places), 3), np.nan)
        for k, place in enumerate(places):
            for reach in (0.4, 0.8, 1.6):
                around = self.space.query_ball_point(place, reach)
                if len(around) < 4:
                    continue
                spread, axes = np.linalg.eigh(np.cov(self.points[around].T))
                if spread[0] < 0.07**2 and spread[1] > 0.15**2:
                    found[k] = axes[:, 0]
                    break
        ways = (places - self.sensor) / np.linalg.norm(places - self.sensor, axis=1)[:, None]
        along_ring = np.abs((ways * found).sum(1)) < np.sin(np.radians(1.0))
        found[along_ring] = np.nan
        return found


def wrong_points(
    case: dict[str, Any], scans: list[Any], removed: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """(K, 3) points of a case, and the frames that measured them."""
    kept = case["kind"] == "false_negative"
    rounded = 0.006  # metres: corners have two decimals
    low = np.array(case["low"]) - rounded
    high = np.array(case["high"]) + rounded
    points = []
    frames = []
    for k in range(case["first_frame"], case["last_frame"] + 1):
        scan = scans[k]
        place = np.asarray(scan.points, float)
        chosen = (place >= low).all(1) & (place <= high).all(1)
        chosen &= (removed[k] != kept) & (np.asarray(scan.labels) == (1 if kept else 0))
        if case.get("instance") is not None and scan.instances is not None:
            chosen &= np.asarray(scan.instances) == case["instance"]
        if case.get("class") is not None and scan.classes is not None:
            chosen &= np.asarray(scan.classes) == case["class"]
        points.append(place[chosen])
        frames.append(np.full(int(chosen.sum()), k))
    return np.concatenate(points), np.concatenate(frames)


def looked_at(
    points: np.ndarray, frames: np.ndarray, every: list[Surroundings], cap: float
) -> dict[str, np.ndarray]:
    """What the other scans saw at each point: (K,) of each name."""
    normals = np.full(points.shape, np.nan)
    mover = np.full(len(points), np.inf)
    for k in np.unique(frames):
        own = frames == k
        normals[own] = every[k].normals(points[own])
        if every[k].movers is not None:
            mover[own] = every[k].movers.query(points[own])[0]
    looks = np.empty((len(every), len(points)), int)
    grazing = np.zeros(looks.shape, bool)
    close = np.zeros(looks.shape, bool)
    for k, returns in enumerate(every):
        code, behind, ways = returns.look(points, cap)
        looks[k] = np.where(frames == k, -1, code)
        grazing[k] = np.abs((ways * normals).sum(1)) < GRAZING
        close[k] = behind < 1.0
    through = looks == THROUGH
    hit = looks == HIT
    hit[frames, np.arange(len(frames))] = True
    first = hit.argmax(0)
    last = len(every) - 1 - hit[::-1].argmax(0)
    number = np.arange(len(every))[:, None]
    known = np.isfinite(normals[:, 0])
    return {
        **{name: (looks == code).sum(0) for code, name in enumerate(NAMES)},
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
    drawn = [decide(figures(found, rng.integers(0, count, count)), word) for _ in range(SAMPLES)]
    names, times = np.unique(drawn, return_counts=True)
    shares = dict(zip(names.tolist(), (times / SAMPLES).tolist(), strict=True))
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


class Drive:
    """All scans of a sequence, ready to be searched."""

    def __init__(self, sequence: str) -> None:
        opened = dv.open(sequence)
        self.scans = [opened[k] for k in range(len(opened))]
        self.every = [Surroundings(scan) for scan in self.scans]
        self.cap = self.every[0].spacing()


def recounted(run: Path, drive: Drive, first: int = 100) -> list[Recounted]:
    """The listed cases of a run on a drive, recounted."""
    result = msgspec.json.decode((run / "result.json").read_bytes())
    stored = np.load(run / "labels.npz")
    ends = np.r_[0, np.cumsum(stored["points"])]
    dynamic = np.unpackbits(stored["dynamic"])[: ends[-1]].astype(bool)
    removed = [dynamic[ends[k] : ends[k + 1]] for k in range(len(drive.scans))]
    rng = np.random.default_rng(1)
    found = []
    for number, case in enumerate(result["failures"]["cases"][:first], 1):
        points, frames = wrong_points(case, drive.scans, removed)
        assert len(points), f"case {number} has no point: {case}"
        chosen = rng.choice(len(points), min(SAMPLE, len(points)), replace=False)
        kept = case["kind"] == "false_negative"
        seen = looked_at(points[chosen], frames[chosen], drive.every, drive.cap)
        cause, shares = causes_of(kept, seen, case.get("word"))
        every_point = figures(seen, np.arange(len(chosen)))
        found.append(
            Recounted(number, case["kind"], case["what"], case["cause"], cause, shares, every_point)
        )
    return found
