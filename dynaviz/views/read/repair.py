"""Salvage a recording that a killed run left behind, or that is damaged.

Every undamaged chunk, and the layout.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from dynaviz.errors import DataError, UsageError
from dynaviz.views import paths, viewer
from dynaviz.views.read import chunks
from dynaviz.views.read.reader import (
    COMPARISON,
    KINDS,
    AnyRecording,
    DamagedRecordingError,
    RunRecording,
    open_store,
)
from dynaviz.views.record.sink import of_part

_HINT = "Free space, or copy the recording to another folder"


@dataclass(frozen=True)
class SalvagedRecording:
    """What was salvaged from a broken recording.

    Attributes:
        answered: frames whose labels can be read.
        observed: frames with any data, at least ``answered``; without any, nothing was written.
        frames: frames of the whole run; 0 if unknown.
        damaged: number of damaged chunks, which are left out.
    """

    answered: int = 0
    observed: int = 0
    frames: int = 0
    damaged: int = 0


def repaired(recording: Path) -> Path:
    """The recording itself, or if it is incomplete or damaged, what ``salvage`` saves of it in
    ``*-repaired.rrd``.

    A warning says what was saved. A repaired file that is newer than the recording is used again.

    Raises:
        DataError: for a file that is no recording, or of which nothing can be saved.
    """
    proper = of_part(recording)
    try:
        open_store(recording)
        if proper is None:
            return recording
        problem = "is the recording of a run that did not finish"
    except DamagedRecordingError as error:
        problem = error.problem
    name = proper or recording
    target = name.with_name(f"{name.stem}-repaired.rrd")
    if target.exists() and target.stat().st_mtime >= recording.stat().st_mtime:
        warnings.warn(f"{recording}: {problem}. Reading {target}, repaired before", stacklevel=2)
        return target
    target.unlink(missing_ok=True)
    found = salvage(recording, target)
    if not found.observed:
        raise DataError(
            recording, f"{problem}, and nothing of it can be saved", hint="Run the method again"
        )
    damaged = (
        f", without {found.damaged} damaged chunk{'s' * (found.damaged != 1)}"
        if found.damaged
        else ""
    )
    frames = f"{found.answered} of {found.frames} frames"
    if not found.answered:
        frames = f"states of {found.observed} of {found.frames} frames"
    warnings.warn(f"{recording}: {problem}. Saved {frames}{damaged} in {target}", stacklevel=2)
    return target


def salvage(broken: Path, target: Path) -> SalvagedRecording:
    """Write what can be read of a recording to another file; the broken file is not changed.

    Raises:
        DataError: if the target cannot be written.
        UsageError: if it is not the recording of a run or of a live session.
    """
    with _complete_copy(broken, target) as (salvaged, damaged):
        try:
            kind = AnyRecording(salvaged).kind
        except DataError:  # not even the properties were written, or they are damaged
            return SalvagedRecording(damaged=damaged)
        if kind not in (paths.PROPERTIES, paths.LIVE):
            again = (
                "Write it again with dynaviz compare"
                if kind == COMPARISON
                else "Run the method again"
            )
            raise UsageError(f"{broken} contains {KINDS[kind]}, not a run. {again}")
        found = _count_frames(salvaged)
        if found.observed:
            os.replace(salvaged, target)
    return replace(found, damaged=damaged)


@contextlib.contextmanager
def _complete_copy(broken: Path, target: Path) -> Iterator[tuple[Path, int]]:
    """Copy all undamaged chunks to a file next to the target, deleted after the block.

    And the number of damaged ones.

    The end of a truncated file does not count.
    """
    try:
        with tempfile.TemporaryDirectory(prefix=".repair-", dir=target.parent) as folder:
            salvaged = Path(folder) / "salvaged.rrd"
            source = broken
            damaged = 0
            if (
                first := chunks.first_damage(broken)
            ) is not None and not first.truncated:  # some end the program
                source = Path(folder) / "undamaged.rrd"
                damaged = chunks.copy_undamaged(broken, source)
            command = [
                viewer.program(),
                "rrd",
                "merge",
                "--continue-on-error",
                str(source),
                "-o",
                str(salvaged),
            ]
            done = subprocess.run(
                command, capture_output=True, check=False, text=True, errors="replace"
            )
            if done.returncode:
                message = (done.stderr.strip().splitlines() or ["no message"])[-1]
                raise DataError(target, f"cannot be written ({message[:200]})", hint=_HINT)
            yield salvaged, damaged
    except OSError as error:
        raise DataError(target, f"cannot be written ({error.strerror})", hint=_HINT) from error


def _count_frames(path: Path) -> SalvagedRecording:
    """Count the frames in a recording that opens."""
    if (live := AnyRecording(path)).kind == paths.LIVE:
        return SalvagedRecording(live.frames, live.frames, live.frames)
    recording = RunRecording(path)
    answered = 0
    with contextlib.suppress(DataError):  # for a damaged frame
        for answered, _ in enumerate(recording.answers(), 1):  # noqa: B007
            pass
    return SalvagedRecording(
        answered, answered or _observed(path), int(recording.properties["frames"])
    )


def _observed(path: Path) -> int:
    """Number of frames with any state of the method; log lines do not count."""
    frames: set[int] = set()
    recording = AnyRecording(path)
    with recording.decoding():
        for chunk in recording.store.stream().filter(has_timeline=paths.FRAME):
            if chunk.entity_path != f"/{paths.LOG}":
                frames |= set(chunk.to_record_batch()[paths.FRAME].to_pylist())
    return len(frames)
