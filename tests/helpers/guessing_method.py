"""A method that emits every kind of state, and recordings of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import rerun as rr

from dynaviz.contracts import registry
from dynaviz.contracts.method import Context, Labels, MethodInfo, Reason
from dynaviz.contracts.metric import FrameHistograms, Labelled
from dynaviz.contracts.probe import (
    Mask,
    Plane,
    PointClasses,
    Points,
    PolarGrid,
    RangeImage,
    Scalar,
    State,
    Text,
    Voxels,
)
from dynaviz.contracts.scan import Outcome, Scan, Sequence
from dynaviz.engine.loop import RunSpec, execute
from dynaviz.progress import Progress, silent
from dynaviz.runs.execution import RunPlan, run
from dynaviz.scores.result import Result
from dynaviz.views.record.recorder import Recorder


@dataclass(frozen=True)
class GuessParams:
    """Points below a height, in a band, are labelled dynamic."""

    height: float = 1.0
    note: str = "a|b"


class Guess:
    """Removes points below a height in a band beyond the track.

    Right about the box, wrong about the floor.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "guess",
        "Guess",
        "A test's method",
        (Reason("outside", "lies outside the band"), Reason("band", "lies in the band")),
        (
            State("cells", Voxels, "cubes of half a metre", value_range=(0.0, 1.0)),
            State("plain_cells", Voxels, "cubes without values"),
            State("found", Points, "points by height", value_range=(0.0, 4.0)),
            State("kinds", PointClasses, "near and far", legend=("near", "far")),
            State("ground", Mask, "points of the floor"),
            State("plane", Plane, "the floor's plane"),
            State("ranges", RangeImage, "what the sensor sees", value_range=(0.0, 12.0)),
            State("bins", PolarGrid, "height by bin", value_range=(0.0, 4.0)),
            State("count", Scalar, "points in the band"),
            State("remark", Text, "a word"),
        ),
    )
    Params: ClassVar[type[Any]] = GuessParams

    def __init__(self, params: GuessParams):
        self.params = params

    def begin(self, context: Context) -> None:
        self.probe = context.probe
        self.cells = np.empty((0, 3), np.int32)

    def observe(self, scan: Scan) -> None:
        xyz, probe = scan.points, self.probe
        keys = np.unique(np.floor(xyz / 0.5).astype(np.int32), axis=0).reshape(-1, 3)
        self.cells = np.concatenate([self.cells[:0], keys])
        probe.emit("cells", Voxels(self.cells, 0.5, np.linspace(0, 1, len(keys), dtype=np.float32)))
        probe.emit("plain_cells", Voxels(self.cells, 0.5))
        probe.emit("found", Points(xyz, xyz[:, 2].copy()))
        probe.emit("kinds", PointClasses((np.abs(xyz[:, 0]) > 3).astype(np.uint8)))
        probe.emit("ground", Mask(xyz[:, 2] < 0.05))
        probe.emit("plane", Plane(np.array([0.0, 0.0, 2.0]), 0.0, scan.position, 4.0))
        probe.emit(
            "ranges", RangeImage(np.linspace(0, 12, 16 * 90, dtype=np.float32).reshape(16, 90))
        )
        probe.emit(
            "bins", PolarGrid(np.linspace(0, 4, 8 * 36, dtype=np.float32).reshape(8, 36), 12.0)
        )

    def _band(self, scan: Scan) -> np.ndarray:
        return (scan.points[:, 2] < self.params.height) & (scan.points[:, 1] > 2.2)

    def label(self, scan: Scan) -> Labels:
        self.probe.emit("count", Scalar(float(self._band(scan).sum())))
        self.probe.emit("remark", Text(f"scan {scan.index}"))
        dynamic = self._band(scan)
        return Labels(dynamic, dynamic.astype(np.uint8))


class Numbers:
    """Returns what real metrics return.

    Scores, undefined scores, reasons, and a histogram with an open last bin.
    """

    def __init__(self, info: MethodInfo):
        self.frames: list[np.ndarray] = []

    def update(self, labelled: Labelled) -> dict[str, float]:
        self.frames.append(np.bincount(labelled.outcome, minlength=len(Outcome)))
        kept, missed = self.frames[-1][Outcome.STATIC_KEPT], self.frames[-1][Outcome.FALSE_NEGATIVE]
        return {
            "SA/so_far": 90.0 + kept % 7,
            "DA/so_far": float("nan"),
            "SA/frame": 91.0,
            "reasons/band": float(missed),
        }

    def finish(self) -> dict[str, Any]:
        names = ("static_kept", "static_removed", "dynamic_removed", "dynamic_kept", "unlabelled")
        return {"metrics": {"SA": 90.0, "DA": None}, "counts": dict.fromkeys(names, 1)}

    def figures(self) -> dict[str, FrameHistograms]:
        edges = np.array([0.0, 0.5, 1.0, 1.5, np.inf])
        counts = np.array([[8, 4, 2, 1]] * len(self.frames), np.int64).reshape(-1, 4)
        return {"false_negative": FrameHistograms("distance", "m", edges, counts)}


def guess_run(sequence: Sequence, **changes: Any) -> RunSpec:
    """A run of the test's method."""
    params = GuessParams()
    return RunSpec(
        Guess(params), sequence, params, **{"metrics": (Numbers(Guess.info),), **changes}
    )


def run_into(
    folder: Path,
    sequence: Sequence,
    *,
    recorded: bool = True,
    progress: Progress = silent,
    **changes: Any,
) -> Result:
    """Run the test's method with all files of a run."""
    files: dict[str, Any] = (
        {"recording": folder / "run.rrd", "record": "errors"} if recorded else {}
    )
    return run(RunPlan(guess_run(sequence, folder=folder, **files, **changes)), progress)


def record(sequence: Sequence, path: Path, mode: Any = "errors", **changes: Any) -> Path:
    """Record a run; in strict mode, bad data is an error instead of a warning."""
    rr.set_strict_mode(True)
    with Recorder(path, mode) as recorder:
        execute(guess_run(sequence, **changes), [recorder], recorder)
    return path


def record_with_metrics(sequence: Sequence, path: Path, mode: Any = "errors") -> Path:
    """Record a run with the real metrics that find failures; in strict mode, as ``record``."""
    rr.set_strict_mode(True)
    names = {handle.name for handle in registry.handles("metrics")} & {
        "confusion",
        "failures",
        "removals",
    }
    metrics = tuple(registry.load("metrics", name)(Guess.info) for name in sorted(names))
    params = GuessParams()
    with Recorder(path, mode) as recorder:
        execute(RunSpec(Guess(params), sequence, params, metrics), [recorder], recorder)
    return path
