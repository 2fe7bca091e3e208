"""A toy method from another package, small sequences as files, and an executor
without processes.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np

from dynaviz.benchmarking.cells import CellTask
from dynaviz.io.pcd import write_pcd
from dynaviz.tasks.task import clear, fail, sentence
from helpers.worlds import room

TOY = '''
"""Removes points between the ground and a height; ``act`` makes it misbehave."""
import os, signal, time
from dataclasses import dataclass
import numpy as np
from dynaviz.contracts.method import Labels, MethodInfo, Reason

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
        if act == "hold":
            self.held = np.ones(25_000_000)
        if act == "wait":  # until a file exists
            open(value + ".part", "w").write(f"{os.getpid()} {os.getppid()}")
            os.replace(value + ".part", value + ".pid")
            while not os.path.exists(value):
                time.sleep(0.02)

    def label(self, scan):
        dynamic = (scan.points[:, 2] > 0.02) & (scan.points[:, 2] < self.params.height)
        return Labels(dynamic, dynamic.astype(np.uint8))
'''


def write_room(folder: Path, **options: int) -> Path:
    """Write the small room in the public benchmark's layout."""
    scans = room(**options).scans
    for scan in scans:
        fields = {
            **dict(zip("xyz", scan.points.T, strict=True)),
            "intensity": np.zeros(len(scan), np.float32),
        }
        write_pcd(folder / f"pcd/{scan.index:06d}.pcd", fields, scan.T_world_sensor)
    points, labels = (
        np.concatenate([getattr(scan, name) for scan in scans]) for name in ("points", "labels")
    )
    truth = {**dict(zip("xyz", points.T, strict=True)), "intensity": labels.astype(np.float32)}
    write_pcd(folder / "gt_cloud.pcd", truth)
    return folder


class InProcessExecutor:
    """Runs cells one by one in this process and records their paths."""

    ran: ClassVar[list[str]] = []

    def __init__(self, out: Path, workers: int, report: object, reuse: bool):
        self._out, InProcessExecutor.ran = out, []

    def run(self, todo: Sequence[CellTask]) -> Iterator[CellTask]:
        for task in todo:
            InProcessExecutor.ran.append(task.path.as_posix())
            clear(task, self._out / task.path)
            try:
                task.run(self._out / task.path, 1)
            except Exception as error:
                fail(task, self._out / task.path, sentence(error))
            yield task


def has_ended(pid: int) -> bool:
    """Whether a process ends within 10 seconds."""
    until = time.monotonic() + 10
    while time.monotonic() < until:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.02)
    return False


def waiting_process(gate: Path) -> tuple[int, int]:
    """The process that waits for a file, and its parent; blocks until it waits."""
    file, until = gate.with_suffix(".pid"), time.monotonic() + 60
    while not file.exists() and time.monotonic() < until:
        time.sleep(0.02)
    pid, parent = map(int, file.read_text().split())
    return pid, parent
