"""Recordings of a coarse and a fine run on the same points, in each mode."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np

import dynaviz as dv
from helpers.worlds import InMemory, room

MODES = ("full", "errors", "scores")


def odd_room() -> InMemory:
    """The room, with some points unlabelled, some not finite, and one empty scan."""
    scans = list(room(6, 2500).scans)
    for i, scan in enumerate(scans):
        labels, points = scan.labels.copy(), scan.points.copy()  # type: ignore[union-attr]
        labels[:: 5 + i] = 255
        points[7::40] = np.nan
        scans[i] = replace(scan, labels=labels, points=points)
    empty = np.empty((0, 3), np.float32)
    scans[2] = replace(scans[2], points=empty, labels=np.empty(0, np.uint8), instances=None)
    return InMemory(scans, "room")


def record_runs(folder: Path) -> dict[str, Path]:
    """Folders of the runs, by ``MODE/fine`` and ``MODE/coarse``."""
    sequence = odd_room()
    for mode, (name, size) in itertools.product(MODES, (("fine", 0.15), ("coarse", 0.6))):
        dv.run(
            "octomap",
            sequence,
            out=folder / mode / name,
            record=mode,
            settings=(f"resolution={size}",),
            threads=1,
        )  # type: ignore[arg-type]
    return {f"{mode}/{name}": folder / mode / name for mode in MODES for name in ("fine", "coarse")}


def pair(runs: dict[str, Path], mode: str, other: str | None = None) -> tuple[Path, Path]:
    """The recordings of the fine and the coarse run."""
    return runs[f"{mode}/fine"] / "run.rrd", runs[f"{other or mode}/coarse"] / "run.rrd"


def dynamic_labels(folder: Path) -> list[np.ndarray]:
    """The labels that a run wrote to ``labels.npz``, frame by frame."""
    with np.load(folder / "labels.npz") as z:
        dynamic = np.unpackbits(z["dynamic"])[: z["points"].sum()].astype(bool)
        return np.split(dynamic, np.cumsum(z["points"])[:-1])
