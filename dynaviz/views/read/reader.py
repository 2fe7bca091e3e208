"""Read a recording: its properties, the label of every point, curves, and the points that were
drawn.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import os
import warnings
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader

from dynaviz.arrays import F32, F64, I64, U8
from dynaviz.contracts.method import Cause, Reason
from dynaviz.contracts.scan import Outcome, outcomes
from dynaviz.errors import DataError, DynavizError
from dynaviz.explain.dial import PointSample, unpack
from dynaviz.explain.point_ledger import PointLedger
from dynaviz.scores.case_points import CasePoints
from dynaviz.scores.comparison.frame_answers import ARCHETYPE, FrameAnswers
from dynaviz.scores.result import Result
from dynaviz.views import classes, paths, stored_ledgers, stored_points
from dynaviz.views.drawn import as_columns
from dynaviz.views.read import chunks
from dynaviz.views.record.sink import part_of

MAGIC = (b"RRF2", b"RRF0", b"RRF1")
_HINT = "Give the run.rrd of a run"
NEEDED = (  # properties that every recording of a run has
    "method", "title", "reasons_json", "sequence", "digest", "has_labels", "frames", "points",
    "mode", "params_json",
    "seed", "online", "complete",
)  # fmt: skip
REMOVED = (Outcome.DYNAMIC_REMOVED, Outcome.FALSE_POSITIVE, Outcome.UNLABELLED_REMOVED)
COUNTS = ("schema", "frames", "points", "seed")  # properties that are integers
COMPARISON = (
    "comparison"  # properties of a comparison of runs; those of a run are ``paths.PROPERTIES``
)
KINDS = {
    paths.PROPERTIES: "a run",
    COMPARISON: "a comparison",
    paths.OVERVIEW: "the overview of a run on tiles",
    paths.LIVE: "a live session",
}


@dataclass(frozen=True, slots=True, eq=False)
class DrawnPoints:
    """The drawn points of a frame.

    Attributes:
        frame: position in the run.
        xyz: (M, 3) float32, metres, world frame.
        outcome: (M,) uint8, an ``Outcome`` per point.
        point: (M,) positions in the scan.
        stands_for: (M,) how many points each stands for.
    """

    frame: int
    xyz: F32
    outcome: U8
    point: I64
    stands_for: I64


class DamagedRecordingError(DataError):
    """A recording is incomplete or damaged; ``repair`` saves all other parts."""


class AnyRecording:
    """A complete recording of dynaviz.

    Of a run, of a comparison, or the overview of a run on tiles.

    Args:
        path: the file.

    Attributes:
        kind: ``run``, ``comparison``, ``live`` or ``overview``; also the name of its properties.

    Raises:
        DataError: if the file is not a recording of dynaviz, is incomplete, or was written by a
            newer dynaviz.
    """

    def __init__(self, path: str | os.PathLike[str]):
        self.path = Path(path)
        self.store = open_store(self.path)
        with self.decoding():
            self.kind, self.properties = self._read_properties()

    @contextlib.contextmanager
    def decoding(self) -> Iterator[None]:
        """Turn the many types of errors of rerun, Arrow and numpy for damaged content into
        DataError.
        """
        try:
            yield
        except DynavizError:
            raise
        except Exception as error:
            reason = (
                " ".join(str(error).replace(str(self.path), "").split())[-80:]
                or type(error).__name__
            )
            raise _damaged(self.path, f"contains damaged data ({reason})") from error

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.span) if self.kind == paths.LIVE else int(self.properties["frames"])

    @functools.cached_property
    def span(self) -> range:
        """Frames that can be shown; a live recording may begin anywhere."""
        if self.kind != paths.LIVE:
            return range(self.frames)
        with self.decoding():
            times = self.store.stream().filter(
                content=f"/{paths.REMOVED_POINTS}/removed", has_timeline=paths.FRAME
            )
            found = [
                frame
                for chunk in times
                for frame in chunk.to_record_batch()[paths.FRAME].to_pylist()
            ]
        return range(min(found), max(found) + 1) if found else range(0)

    def facts(self) -> dict[str, str]:
        """A summary for display: names and values."""
        p = self.properties
        size = f"{self.path.stat().st_size / 1e6:.1f} MB"
        if self.kind == paths.OVERVIEW:
            return {
                "overview": p["title"],
                "sequence": p["sequence"],
                "frames": f"{self.frames:,}",
                "size": size,
            }
        if self.kind == paths.LIVE:
            span = f"{self.span[0]} to {self.span[-1]}" if self.span else "none"
            return {"live": p["method"], "source": p["source"], "frames": span, "size": size}
        with self.decoding():
            letters = {
                run["letter"]: f"{run['name']}, {run['path']}"
                for run in json.loads(p["comparison_json"])["runs"]
            }
        return {
            "comparison": p["title"],
            "sequence": p["sequence"],
            "digest": p["digest"],
            "frames": f"{self.frames:,}",
            **letters,
            "size": size,
        }

    def curve(self, path: str) -> tuple[I64, F64]:
        """Frames and values of a curve, in order; NaN where undefined.

        Empty if there is no such curve.
        """
        with self.decoding():
            rows = [(frame, float(c["Scalars:scalars"][0])) for frame, c in self.rows(path)]
        return np.array([f for f, _ in rows], np.int64), np.array([value for _, value in rows])

    def entities(self) -> list[str]:
        """All entity paths, sorted, without the leading slash."""
        with self.decoding():
            return sorted(
                str(path).removeprefix("/") for path in self.store.schema().entity_paths()
            )

    def static(self, path: str) -> dict[str, Any]:
        """Static components of an entity; the last row wins if there are several."""
        found: dict[str, Any] = {}
        with self.decoding():
            for chunk in self.store.stream().filter(content=f"/{path}", is_static=True):
                batch = chunk.to_record_batch()
                for row in range(batch.num_rows):
                    found |= _row(batch, row, chunk.timeline_names)
        return found

    def rows(self, path: str, timeline: str = paths.FRAME) -> Iterator[tuple[int, dict[str, Any]]]:
        """Rows of an entity by frame or case.

        The parts of a row may be in several chunks, in any order.
        """
        places: defaultdict[int, list[tuple[Any, int]]] = defaultdict(list)
        with self.decoding():
            for chunk in self.store.stream().filter(content=f"/{path}", has_timeline=timeline):
                batch = chunk.to_record_batch()
                for row, frame in enumerate(batch[timeline].to_pylist()):
                    places[frame].append((chunk, row))
            for frame in sorted(places):
                merged: dict[str, Any] = {}
                for chunk, row in places.pop(frame):
                    merged |= _row(chunk.to_record_batch(), row, chunk.timeline_names)
                yield frame, merged

    def _read_properties(self) -> tuple[str, dict[str, Any]]:
        for kind in KINDS:
            properties = {
                name: value[0] for name, value in self.static(f"__properties/{kind}").items()
            }
            if "schema" in properties:
                break
        else:
            raise DataError(
                self.path,
                "is a Rerun recording, but not from dynaviz",
                hint="Give the run.rrd of a run",
            )
        if properties["schema"] > paths.SCHEMA:
            raise DataError(self.path, "was written by a newer dynaviz", hint="Upgrade dynaviz")
        if kind == paths.PROPERTIES and (
            lacking := [name for name in NEEDED if name not in properties]
        ):
            problem = f"was written by an older dynaviz and lacks {', '.join(lacking)}"
            raise DataError(self.path, problem, hint="Run the method again")
        for name, value in properties.items():
            if name.endswith("_json"):
                json.loads(value)
            elif not isinstance(value, np.integer if name in COUNTS else (str, np.generic)):
                raise TypeError(f"{name} is a {type(value).__name__}")
        if properties.get("complete") and "result_json" not in properties:
            raise KeyError("result_json")
        return kind, properties


SAMPLE = f"{stored_ledgers.SAMPLE}:{stored_ledgers.COMPONENT}"


class RunRecording(AnyRecording):
    """A recording of a run.

    Raises:
        DataError: as ``AnyRecording``, and for the recording of a comparison.
    """

    def __init__(self, path: str | os.PathLike[str]):
        super().__init__(path)
        if self.kind != paths.PROPERTIES:
            raise DataError(
                self.path,
                f"contains {KINDS[self.kind]}, not a run",
                hint="Give the run.rrd of a run",
            )
        self._unscored: frozenset[int] = frozenset()
        self._truths: Mapping[int, U8] = {}

    def leave_out(self, frames: Iterable[int]) -> None:
        """Read the points of these frames as points without ground truth from now on."""
        self._unscored = frozenset(frames)

    def correct(self, truths: Mapping[int, U8]) -> None:
        """Read points with another ground truth from now on.

        Args:
            truths: (N,) uint8, a ``Label`` per point, by position of the frame.
        """
        self._truths = truths

    @property
    def complete(self) -> bool:
        """Whether the run finished."""
        return bool(self.properties["complete"])

    @property
    def result(self) -> Result | None:
        """The run's result; None if it did not finish."""
        with self.decoding():
            return (
                Result.from_dict(json.loads(self.properties["result_json"]), self.path)
                if self.complete
                else None
            )

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """The legend of the reason codes."""
        with self.decoding():
            return tuple(
                Reason(
                    reason["name"],
                    reason["meaning"],
                    Cause(reason["cause"]) if reason.get("cause") else None,
                )
                for reason in json.loads(self.properties["reasons_json"])
            )

    @property
    def compares(self) -> bool:
        """Whether "dynamic" means that a point changed between two drives.

        Earlier recordings tell it by their reasons alone.
        """
        told = (reason.meaning.startswith("changed:") for reason in self.reasons)
        return bool(self.properties.get("compares")) or any(told)

    @property
    def parameters(self) -> dict[str, Any]:
        """The method's parameters."""
        parameters: dict[str, Any] = json.loads(self.properties["params_json"])
        return parameters

    def facts(self) -> dict[str, str]:
        """A summary for display: names and values."""
        p = self.properties
        return {
            "method": f"{p['method']} ({p['title']})",
            "sequence": p["sequence"],
            "digest": p["digest"],
            "frames": f"{p['frames']:,}",
            "points": f"{p['points']:,}",
            "ground truth": "yes" if p["has_labels"] else "no",
            "mode": f"{p['mode']}, {'online' if p['online'] else 'two passes'}, seed {p['seed']}",
            "parameters": ", ".join(
                f"{name}={json.dumps(value)}" for name, value in self.parameters.items()
            ),
            "finished": "yes" if self.complete else "no, the run ended early",
            "size": f"{self.path.stat().st_size / 1e6:.1f} MB",
            "command": p.get("command", ""),
        }

    def ledgers(self, case: int) -> tuple[PointLedger, ...]:
        """The stored ledgers of a listed case, 1 for the first; none if the recording has none.

        Raises:
            DataError: for damaged content.
        """
        with self.decoding():
            packed = self._packed.get(case)
            return () if packed is None else stored_ledgers.unpack(packed)

    def explained(self, case: int) -> list[int]:
        """The rows of the points of ``ledgers`` in the scan of the worst frame.

        Raises:
            DataError: for damaged content.
        """
        with self.decoding():
            return stored_ledgers.rows(self._packed[case]) if case in self._packed else []

    @functools.cached_property
    def sample(self) -> PointSample | None:
        """The points that can be judged again; None if there are none, as in earlier recordings.

        Raises:
            DataError: for damaged content.
        """
        packed = self.static(paths.SAMPLE).get(SAMPLE)
        with self.decoding():
            return None if packed is None else unpack(packed)

    @functools.cached_property
    def case_points(self) -> CasePoints:
        """The failure cases, and points of each; without points in earlier recordings.

        Raises:
            DataError: for damaged content.
        """
        stored = self.static(paths.CASE_POINTS)
        result = self.result
        with self.decoding():
            return CasePoints([] if result is None else result.failures, stored_points.read(stored))

    @functools.cached_property
    def _packed(self) -> dict[int, U8]:
        name = f"{stored_ledgers.ARCHETYPE}:{stored_ledgers.COMPONENT}"
        return {
            case: components[name] for case, components in self.rows(paths.CASE_LEDGERS, paths.CASE)
        }

    def answers(self) -> Iterator[FrameAnswers]:
        """Label, ground truth and reason of every point, frame by frame in the order of the run.

        Raises:
            DataError: for a frame whose data are damaged.
        """
        for frame, components in self.rows(paths.ANSWERS):
            values = {
                name.removeprefix(f"{ARCHETYPE}:"): value for name, value in components.items()
            }
            try:
                answers = FrameAnswers.unpacked(frame, values)
            except Exception as error:
                raise DataError(
                    self.path,
                    f"contains damaged answers ({error})",
                    at=f"frame {frame}",
                    hint="Run the method again",
                ) from error
            if (truth := self._truths.get(frame)) is not None:
                if len(truth) != len(answers):
                    problem = f"has {len(answers)} points, of which the sequence has {len(truth)}"
                    raise DataError(
                        self.path, problem, at=f"frame {frame}", hint="Run the method again"
                    )
                answers = dataclasses.replace(answers, truth=truth)
            yield answers.unscored() if frame in self._unscored else answers

    def drawn(self) -> Iterator[DrawnPoints]:
        """The drawn points, frame by frame, of some frames none; nothing in ``scores`` mode."""
        for frame, components in self._with_scan_rows():
            if "Clear:is_recursive" in components:  # left out because of a budget
                nothing = np.empty(0, np.int64)
                yield DrawnPoints(
                    frame, np.empty((0, 3), np.float32), nothing.astype(np.uint8), nothing, nothing
                )
                continue
            if "Points3D:positions" not in components:
                continue  # the incomplete last frame of a killed run
            xyz = components["Points3D:positions"]
            every = np.arange(len(xyz))
            with self.decoding():
                outcome = classes.outcomes(components["Points3D:class_ids"])
                if frame in self._unscored:
                    outcome = np.full(len(xyz), Outcome.UNLABELLED_KEPT, np.uint8)
                point = components.get("dynaviz.Scan:point", every).astype(np.int64)
                if (truth := self._truths.get(frame)) is not None and frame not in self._unscored:
                    outcome = outcomes(truth[point], np.isin(outcome, REMOVED))
                points = DrawnPoints(
                    frame,
                    xyz,
                    outcome,
                    point,
                    components.get("dynaviz.Scan:stands_for", np.ones(len(xyz))).astype(np.int64),
                )
            yield points

    def _with_scan_rows(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """What is drawn of each scan, with the rows of its points.

        Those of earlier recordings are components of the points themselves.
        """
        details = self.rows(paths.SCAN_ROWS)
        last: tuple[int, dict[str, Any]] = (-1, {})
        for frame, components in self.rows(paths.SCAN):
            while last[0] < frame:
                last = next(details, (frame + 1, {}))
            yield frame, components | (last[1] if last[0] == frame else {})


def open_store(path: Path) -> Any:
    """Open any complete recording; chunks are checked now, and read by rerun when they are used.

    Raises:
        DataError: if the file is not a recording, is incomplete, or contains a damaged chunk.
    """
    try:
        with path.open("rb") as file:
            head = file.read(8)
    except OSError as error:
        part = part_of(path)
        hint = (
            f"The run did not finish. Salvage its recording with: dynaviz info {part}"
            if part.is_file()
            else _HINT
        )
        raise DataError(path, error.strerror or "cannot be read", hint=hint) from None
    if head[:4] not in MAGIC:
        raise DataError(path, "is not a recording", at="byte 0", hint=_HINT)
    if (
        head[:4] == MAGIC[0]
        and (damage := chunks.first_damage(path)) is not None
        and not damage.truncated
    ):
        raise _damaged(path, f"contains a damaged chunk ({damage.problem})", at=f"byte {damage.at}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about an incomplete file; reported below
            return RrdReader(path).store()
    except (RuntimeError, ValueError, OSError) as error:
        raise _broken(path, head) from error


def viewable(path: Path) -> None:
    """Check that the viewer can open a recording.

    Raises:
        DataError: as ``open_store``, and if the name does not end in ``.rrd``, which the viewer
            requires.
    """
    open_store(path)
    if path.suffix != ".rrd":
        hint = f"Rename it with: mv {path} {path.with_suffix('.rrd')}"
        raise DataError(path, "does not end in .rrd, so the viewer cannot open it", hint=hint)


def _broken(path: Path, head: bytes) -> DataError:
    """The error for a recording that does not open."""
    here = metadata.version("rerun-sdk")
    there = tuple(head[4:6])
    if head[:4] != MAGIC[0]:
        return DataError(
            path,
            "was written by a Rerun before 0.23, which cannot be read",
            hint="Run the method again",
        )
    if there > tuple(map(int, here.split(".")[:2])):
        problem = (
            f"was written by rerun {'.'.join(map(str, there))}, newer than the installed {here}"
        )
        return DataError(path, problem, hint="Upgrade dynaviz")
    hint = f"Salvage its frames with: dynaviz info {path}"
    return DamagedRecordingError(
        path, "is incomplete: its run was killed, or the file is truncated", hint=hint
    )


def _damaged(path: Path, problem: str, at: str | None = None) -> DamagedRecordingError:
    """The error for a recording of which a part is damaged."""
    return DamagedRecordingError(
        path, problem, at=at, hint=f"Save all other parts with: dynaviz info {path}"
    )


def _row(batch: pa.RecordBatch, row: int, timelines: Any) -> dict[str, Any]:
    """One row's components as arrays, fixed-size lists as columns."""
    values = {}
    for name in batch.schema.names:
        if name.startswith("rerun") or name in timelines or not batch[name][row].is_valid:
            continue
        values[name] = as_columns(batch[name][row].values)
    return values


def read(path: str | os.PathLike[str]) -> AnyRecording:
    """Open a recording of either kind; that of a run as a ``RunRecording``.

    Raises:
        DataError: as ``AnyRecording``.
    """
    recorded = AnyRecording(path)
    return RunRecording(path) if recorded.kind == paths.PROPERTIES else recorded
