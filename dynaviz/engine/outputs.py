"""The files of a run: labels.npz, static_map.pcd, dynamic_points.pcd, config.toml, result.json."""

from __future__ import annotations

import contextlib
import zipfile
from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from dynaviz.arrays import F64, all_finite
from dynaviz.contracts.metric import Figure, Labelled
from dynaviz.contracts.params import to_toml
from dynaviz.engine.loop import Listener, Reviewing, RunSpec
from dynaviz.io.atomic import atomic_file, remove, write_atomic
from dynaviz.io.pcd import PcdWriter
from dynaviz.scores.result import Result
from dynaviz.sources.summary import SequenceSummary

FILES = ("labels.npz", "static_map.pcd", "dynamic_points.pcd")
"""Written by the listeners in this module."""


class LabelsFile(Listener):
    """Writes ``labels.npz``.

    ``dynamic``: one bit per point in the order of the sequence, 1 if the method removed it
    (``np.unpackbits(z["dynamic"])[: z["points"].sum()]``); ``points``: (frames,) int64 points of
    each frame; ``frames``: (frames,) int64 numbers of the frames; ``reasons``: (points,) uint8
    codes; ``reason_names``: their legend; ``sequence_digest`` and ``labels_sha256``: digests of the
    sequence and of the labels.
    """

    def __init__(self, folder: Path):
        self._path = folder / "labels.npz"
        self._stack = contextlib.ExitStack()
        self._points = array("q")
        self._frames = array("q")

    def __enter__(self) -> LabelsFile:
        with contextlib.ExitStack() as stack:
            file = stack.enter_context(atomic_file(self._path))
            self._zip = stack.enter_context(
                zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
            )
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def begin(self, run: RunSpec, summary: SequenceSummary) -> None:
        """Write the legend, and open the array of reasons, which is written frame by frame."""
        self._put("sequence_digest", np.array(summary.digest))
        self._put("reason_names", np.array([reason.name for reason in run.labeller.info.reasons]))
        self._reasons: IO[bytes] = self._stack.enter_context(
            self._zip.open("reasons.npy", "w", force_zip64=True)
        )
        head = {"descr": "|u1", "fortran_order": False, "shape": (summary.points,)}
        np.lib.format.write_array_header_1_0(self._reasons, head)

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Append a frame."""
        self._points.append(len(labelled.scan))
        self._frames.append(labelled.scan.index)
        self._reasons.write(labelled.reasons.tobytes())

    def finish(self, result: Result, figures: Mapping[str, Figure]) -> None:
        """Append the labels."""
        self._reasons.close()
        self._put("dynamic", result.labels.packed)
        self._put("points", np.array(self._points, np.int64))
        self._put("frames", np.array(self._frames, np.int64))
        self._put("labels_sha256", np.array(result.labels_sha256))

    def _put(self, name: str, array: Any) -> None:
        with self._zip.open(f"{name}.npy", "w") as file:
            np.lib.format.write_array(file, array, allow_pickle=False)


class RemoveStaleOutputs(Listener):
    """Removes files of an earlier run at the end of this one.

    Put it before the listeners that write.

    It removes the files whose presence means something: ``result.json`` and ``config.toml``, which
    are written last, ``run.rrd`` if this run's recording is written elsewhere, and maps if this run
    writes none. A run that fails leaves the earlier files untouched.
    """

    def __init__(self, folder: Path, recording: Path | None, maps: bool = True):
        own = recording is not None and recording.resolve() == (folder / "run.rrd").resolve()
        stale = (
            "result.json",
            "config.toml",
            *(() if own else ("run.rrd",)),
            *(() if maps else FILES[1:]),
        )
        self._paths = [folder / name for name in stale]

    def finish(self, result: Result, figures: Mapping[str, Figure]) -> None:
        """Remove them."""
        for path in self._paths:
            remove(path)


class MapFiles(Listener):
    """Writes ``static_map.pcd`` (kept points) and ``dynamic_points.pcd`` (removed points), of the
    finite ones, with the decisions of the run's review.

    Args:
        folder: the folder.
        origin: (3,) float64, metres: added to all points, which are then float64, if it is not
            zero.
    """

    def __init__(self, folder: Path, origin: F64 | None = None):
        self._origin = np.zeros(3) if origin is None else origin
        kinds = dict.fromkeys("xyz", np.float64 if self._origin.any() else np.float32)
        self._kept = PcdWriter(folder / "static_map.pcd", kinds, np.eye(4))
        self._removed = PcdWriter(folder / "dynamic_points.pcd", kinds, np.eye(4))
        self._review: Reviewing | None = None
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> MapFiles:
        self._stack.enter_context(self._kept)
        self._stack.enter_context(self._removed)
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def begin(self, run: RunSpec, summary: SequenceSummary) -> None:
        """Take the decisions that the maps follow."""
        self._review = run.review

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Append the points of a frame."""
        finite = all_finite(labelled.scan.points)
        dynamic = labelled.dynamic
        if self._review is not None:
            dynamic, _ = self._review.answers(labelled.scan, dynamic)
        for writer, chosen in ((self._kept, ~dynamic), (self._removed, dynamic)):
            points = labelled.scan.points[chosen & finite]
            columns = (points.astype(np.float64) + self._origin if self._origin.any() else points).T
            writer.append(**dict(zip("xyz", columns, strict=True)))


def write_summary(folder: Path, run: RunSpec, result: Result) -> None:
    """Write ``config.toml`` and ``result.json``; the latter last.

    It exists only if the run is complete.

    The output of another program has no ``config.toml``.
    """
    if run.of_method:
        settings = {"online": run.online, "seed": run.seed}
        write_atomic(folder / "config.toml", to_toml(result.method, run.params, settings))
    result.save(folder / "result.json")
