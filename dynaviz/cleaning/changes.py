"""What is in one of two drives and not in the other.

A method labels both drives together, and each one alone. A point that it removes only from both
together stood in its own drive, and the free space of the other drive shows that it is not there.
In cells of ``EDGE``, most points must agree. Where no point of the other drive lies in a cell or
next to it, the other drive did not see the place.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from dynaviz.arrays import I64, Bool
from dynaviz.contracts.method import Context, Labels, MethodInfo, Reason
from dynaviz.contracts.scan import Scan, stream
from dynaviz.diagnosis.drives import DriveAgreement, compare_drives
from dynaviz.engine.cleaned_map import Judgement, MapFile, WrittenMap, write_maps
from dynaviz.engine.label_folder import NoParams
from dynaviz.engine.loop import RunSpec
from dynaviz.errors import UsageError
from dynaviz.progress import Progress
from dynaviz.runs.execution import (
    RunPlan,
    budget_of,
    metrics_of,
    recording_of,
    run,
    run_method,
)
from dynaviz.runs.options import RunOptions
from dynaviz.scores.labels import reasons_by_frame
from dynaviz.scores.result import Result
from dynaviz.scores.sections import RemovedCluster
from dynaviz.sources.datasets.drives import Drives
from dynaviz.sources.drive import Drive
from dynaviz.spatial.grid import SHIFTS, in_key_range, pack

EDGE = 0.4  # metres: edge of a cell, in which the points of a drive agree on whether they changed
MERGED = 1 << 22  # cells of scans that are summed up at a time

DISAPPEARED, APPEARED, SEEN_AGAIN, NOT_SEEN, MOVED, NOT_JUDGED = range(6)
REASONS = (
    Reason(
        "disappeared", "changed: stood in the first drive, and the second one saw its place empty"
    ),
    Reason("appeared", "changed: stood in the second drive, and the first one saw its place empty"),
    Reason("seen_again", "unchanged: the other drive has points here, too"),
    Reason(
        "not_seen", "unknown: the other drive has no points here, and did not see the place empty"
    ),
    Reason("moved", "removed from its own drive as dynamic"),
    Reason("not_judged", "no finite coordinates, or too far from the origin"),
)
NAMES = tuple(reason.name for reason in REASONS)
WRITTEN = DISAPPEARED, APPEARED, NOT_SEEN
LISTED = 10


@dataclass(frozen=True)
class Changes:
    """What changed between two drives.

    Attributes:
        result: of the comparison, with a recording; ``result.clusters`` are the changes.
        drives: names of the drives.
        counts: (2, 6) int64: points of each drive by reason, as in ``REASONS``.
        agreement: of the drives.
        maps: what was written.
        folder: files of the comparison; ``drive_1`` and ``drive_2`` are the runs on each drive
            alone.
    """

    result: Result
    drives: tuple[str, ...]
    counts: I64
    agreement: DriveAgreement
    maps: tuple[WrittenMap, ...]
    folder: Path

    @property
    def clusters(self) -> tuple[RemovedCluster, ...]:
        """Changed points that belong together, the largest first."""
        return self.result.clusters

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "drives": {
                name: dict(zip(NAMES, row, strict=True))
                for name, row in zip(self.drives, self.counts.tolist(), strict=True)
            },
            "agreement_m": self.agreement.median_m,
            "maps": [{"file": str(each.path), "points": each.points} for each in self.maps],
            "clusters": msgspec.to_builtins(self.clusters),
            "folder": str(self.folder),
        }

    def lines(self) -> Iterator[str]:
        """The section of the summary."""
        yield from ["", "## What changed", "", f"Registration: {self.agreement}.", ""]
        yield f"| drive | {' | '.join(name.replace('_', ' ') for name in NAMES)} |"
        yield f"|---|{'---:|' * len(NAMES)}"
        for name, row in zip(self.drives, self.counts.tolist(), strict=True):
            yield f"| {name} | {' | '.join(f'{count:,}' for count in row)} |"
        yield ""
        yield from (f"- `{each.path}`: {each.points:,} points" for each in self.maps)
        yield ""
        for number, each in enumerate(self.clusters[:LISTED], 1):
            low = np.array(each.low)
            high = np.array(each.high)
            middle = (low + high) / 2 + self.result.answers.sequence.origin
            size, place = (
                ", ".join(f"{value:.1f}" for value in values) for values in (high - low, middle)
            )
            what = f"{each.did.capitalize()}: {each.points:,} points in {each.frames} frames"
            yield f"{number}. {what}, ({size}) m, at ({place}) m."
        if not self.clusters:
            yield "Nothing appeared or disappeared."


@dataclass(frozen=True)
class Pair:
    """Two drives that are open as one sequence.

    Attributes:
        sequence: frames of the first drive, then of the second.
        first: number of frames of the first.
        drives: their names.
    """

    sequence: Drive
    first: int
    drives: tuple[str, ...]

    @classmethod
    def of(cls, sequence: Drive) -> Pair:
        """Find out where the second drive begins.

        Raises:
            UsageError: if the sequence does not have frames of exactly two drives.
        """
        whole = sequence.reader
        if not isinstance(whole, Drives) or len(whole.parts) != 2:
            number = len(whole.parts) if isinstance(whole, Drives) else 1
            raise UsageError(
                f"--changed compares two drives, not {number}. Give two paths: monday/ tuesday/"
            )
        end = len(whole.parts[0])
        first = bisect.bisect_left(
            range(len(sequence)), end, key=lambda position: sequence[position].index
        )
        if not 0 < first < len(sequence):
            raise UsageError(
                "--changed: --frames selects frames of one drive only. Select frames of both"
            )
        names = tuple(drive.name for drive in whole.parts)
        return cls(sequence, first, names if names[0] != names[1] else ("drive 1", "drive 2"))

    def alone(self, which: int, sequence: Drive) -> Drive:
        """One of the drives, 0 or 1, of the sequence or one with other poses."""
        rows = range(self.first) if which == 0 else range(self.first, len(sequence))
        return sequence.chosen(rows).renamed(self.drives[which])

    def compared(self) -> DriveAgreement:
        """How well the drives agree; raises DataError if they do not."""
        return compare_drives(self.alone(0, self.sequence), self.alone(1, self.sequence))


def find_changes(
    pair: Pair,
    agreement: DriveAgreement,
    together: Result,
    options: RunOptions,
    file: MapFile,
    folder: Path,
    command: str,
    progress: Progress,
) -> Changes:
    """Run the method on each drive alone, compare, and write what changed.

    Args:
        pair: the drives.
        agreement: of their surfaces.
        together: the run on both.
        options: of that run.
        file: its map; those of changes are like it.
        folder: for the files of the comparison.
        command, progress: as for ``dynaviz.run``.
    """
    sequence = together.answers.sequence
    quiet = replace(options, maps=False, record="none", record_budget=None, view=False)
    alone = [
        run_method(
            together.method,
            pair.alone(k, sequence),
            quiet,
            out=folder / f"drive_{k + 1}",
            command=command,
            progress=progress,
        )
        for k in (0, 1)
    ]

    def stood(position: int) -> tuple[Bool, Bool]:
        which, row = (0, position) if position < pair.first else (1, position - pair.first)
        own = ~alone[which].labels[row]
        return own, own & together.labels[position]

    # that file has the other run
    record = "errors" if Path(options.record).suffix == ".rrd" else options.record
    recording, mode = recording_of(record, folder)
    labeller = _Labeller(
        together.method, pair.first, stood, _cells(sequence, pair.first, stood, progress)
    )
    spec = RunSpec(
        labeller=labeller,
        # its ground truth, of what moves, says nothing about what changed
        sequence=sequence.blind(),
        params=NoParams(),
        metrics=metrics_of(labeller.info),
        threads=options.threads,
        command=command,
        record=mode,
        folder=folder,
        recording=recording,
    )
    result = run(RunPlan(spec, maps=False, budget=budget_of(options)), progress)
    files = [
        replace(
            file,
            path=folder
            / f"{NAMES[code]}{'' if file.tiled or file.tile_size else file.path.suffix}",
            removed=code != NOT_SEEN,
            marked=False,
            reason=code,
        )
        for code in WRITTEN
    ]
    judged = Judgement(result.labels, reasons_by_frame(folder / "labels.npz", result.labels))
    maps, _ = write_maps(sequence, judged, files, progress)
    return Changes(result, pair.drives, labeller.counts, agreement, tuple(maps), folder)


@dataclass(frozen=True, eq=False)
class _Cells:
    """The cells with points that stood in a drive.

    Attributes:
        keys: (K,) int64, packed, in order.
        changed: (K,) bool: most points changed.
        seen_again: (K,) bool: the other drive has unchanged points in the cell or next to it.
    """

    keys: I64
    changed: Bool
    seen_again: Bool

    def of(self, keys: I64) -> I64:
        """Rows of the cells with these keys, (N,), all of which exist."""
        rows: I64 = np.searchsorted(self.keys, keys)
        return rows


Stood = Callable[[int], tuple[Bool, Bool]]
"""Of the points of the scan at a position: whether each stood in its own drive, and of these,
whether it changed."""


def _cells(sequence: Drive, first: int, stood: Stood, progress: Progress) -> tuple[_Cells, _Cells]:
    """The cells of both drives; memory grows with the area of the map."""
    tables = _Table(), _Table()
    for position, scan in enumerate(stream(sequence)):
        own, changed = stood(position)
        rows = np.flatnonzero(own & in_key_range(scan.points, EDGE))
        tables[position >= first].add(pack(scan.points[rows], EDGE), changed[rows])
        progress("compare", position + 1, len(sequence))
    found = [table.summed() for table in tables]
    still = [keys[points > changed] for keys, points, changed in found]
    return tuple(
        _Cells(keys, 2 * changed > points, _near(keys, still[1 - k]))
        for k, (keys, points, changed) in enumerate(found)
    )  # type: ignore[return-value]


def _near(keys: I64, others: I64) -> Bool:
    """(K,) bool: whether a cell or one of its 26 neighbours is among others, which are in order."""
    found = np.zeros(len(keys), np.bool_)
    for step in np.ndindex(3, 3, 3):
        wanted = keys + int(((np.array(step) - 1) << SHIFTS).sum())
        at = np.minimum(np.searchsorted(others, wanted), max(len(others) - 1, 0))
        found |= others[at] == wanted if len(others) else False
    return found


class _Table:
    """Counts the points of cells."""

    def __init__(self) -> None:
        self._parts: list[tuple[I64, I64, I64]] = []
        self._waiting = 0

    def add(self, keys: I64, changed: Bool) -> None:
        """Count points, (N,) keys of their cells, and those of them that changed."""
        found, of = np.unique(keys, return_inverse=True)
        number = len(found)
        self._parts.append(
            (found, np.bincount(of, minlength=number), np.bincount(of[changed], minlength=number))
        )
        self._waiting += number
        if self._waiting > MERGED:
            self._parts = [self.summed()]
            self._waiting = 0

    def summed(self) -> tuple[I64, I64, I64]:
        """Keys of the cells in order, their points, and those that changed."""
        keys, points, changed = (np.concatenate(each) for each in zip(*self._parts, strict=True))
        found, of = np.unique(keys, return_inverse=True)
        sums = (np.bincount(of, each, len(found)).astype(np.int64) for each in (points, changed))
        return found, *sums  # type: ignore[return-value]


class _Labeller:
    """The answers, as of a method.

    Attributes:
        counts: (2, 6) int64: points of each drive by reason, so far.
    """

    scoring = "mask"

    def __init__(self, method: str, first: int, stood: Stood, cells: tuple[_Cells, _Cells]) -> None:
        title = f"What changed, by {method}"
        self.info = MethodInfo("changed", title, "two drives of one place", REASONS, compares=True)
        self._first = first
        self._stood = stood
        self._cells = cells
        self._next = 0
        self.counts = np.zeros((2, len(REASONS)), np.int64)

    def begin(self, context: Context) -> None:
        """Start with the first scan."""
        self._next = 0
        self.counts[:] = 0

    def label(self, scan: Scan) -> Labels:
        """Label the scans in order: "dynamic" is what changed."""
        position = self._next
        self._next = self._next + 1
        which = int(position >= self._first)
        own, changed = self._stood(position)
        reasons = np.where(own, NOT_JUDGED, MOVED).astype(np.uint8)
        rows = np.flatnonzero(own & in_key_range(scan.points, EDGE))
        cells = self._cells[which]
        at = cells.of(pack(scan.points[rows], EDGE))
        found = np.where(cells.seen_again[at], SEEN_AGAIN, NOT_SEEN)
        found[changed[rows] & cells.changed[at]] = (DISAPPEARED, APPEARED)[which]
        reasons[rows] = found
        self.counts[which] += np.bincount(reasons, minlength=len(REASONS))
        return Labels(reasons <= APPEARED, reasons)
