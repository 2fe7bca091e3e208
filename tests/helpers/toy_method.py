"""A toy method from another package, little sequences as files, and a runner of cells without processes."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np

from dynaviz.benchmarking import cells
from dynaviz.benchmarking.plan import BenchCell
from dynaviz.io.pcd import write_pcd
from helpers.worlds import room

TOY = '''
"""Removes what lies between the ground and a height; and misbehaves when told to."""
import os, signal, time
from dataclasses import dataclass
import numpy as np
from dynaviz.method import MethodInfo, Reason

@dataclass(frozen=True)
class Params:
    height: float = 0.5
    steps: int = 3
    act: str = ""
    bands: tuple[float, ...] = (1.0,)

    def __post_init__(self):
        if self.height > 3:
            raise ValueError(f"height = {self.height}: give at most 3")

class Toy:
    info = MethodInfo("toy", "Toy", "nobody 2024", (Reason("low", "low"), Reason("high", "high")))
    Params = Params

    def __init__(self, params):
        self.params = params

    def begin(self, context):
        print("methods may print")

    def observe(self, scan):
        act, _, value = self.params.act.partition(":")
        if act == "raise":
            raise ValueError("this method cannot")
        if act == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if act == "wait":  # for a file
            open(value + ".part", "w").write(f"{os.getpid()} {os.getppid()}")
            os.replace(value + ".part", value + ".pid")
            while not os.path.exists(value):
                time.sleep(0.02)

    def label(self, scan):
        return (scan.points[:, 2] > 0.02) & (scan.points[:, 2] < self.params.height)

    def explain(self, scan):
        return self.label(scan).astype(np.uint8)
'''


def write_room(folder: Path, **how: int) -> Path:
    """The little room in the public benchmark's layout."""
    scans = room(**how).scans
    for scan in scans:
        fields = {**dict(zip("xyz", scan.points.T, strict=True)), "intensity": np.zeros(len(scan), np.float32)}
        write_pcd(folder / f"pcd/{scan.index:06d}.pcd", fields, scan.T_world_sensor)
    points, labels = (np.concatenate([getattr(scan, name) for scan in scans]) for name in ("points", "labels"))
    truth = {**dict(zip("xyz", points.T, strict=True)), "intensity": labels.astype(np.float32)}
    write_pcd(folder / "gt_cloud.pcd", truth)
    return folder


class Here:
    """Runs cells in this process, one after the other; remembers which."""

    ran: ClassVar[list[str]] = []

    def __init__(self, out: Path, workers: int, tell: object):
        self._out, Here.ran = out, []

    def run(self, todo: Sequence[BenchCell]) -> Iterator[BenchCell]:
        for cell in todo:
            Here.ran.append(cell.path.as_posix())
            cells.clear(self._out / cell.path)
            try:
                cells.run(cell, self._out / cell.path, 1)
            except Exception as error:
                cells.fail(cell, self._out / cell.path, cells.sentence(error))
            yield cell


def gone(pid: int) -> bool:
    """Whether a process has ended, within some seconds."""
    until = time.monotonic() + 10
    while time.monotonic() < until:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.02)
    return False


def who(gate: Path) -> tuple[int, int]:
    """The process that waits for a file, and its parent; once it does."""
    file, until = gate.with_suffix(".pid"), time.monotonic() + 60
    while not file.exists() and time.monotonic() < until:
        time.sleep(0.02)
    pid, parent = map(int, file.read_text().split())
    return pid, parent
