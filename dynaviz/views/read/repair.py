"""Salvage a recording that a killed run left behind, or that is damaged: every undamaged chunk, and the layout."""

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
    MAGIC,
    AnyRecording,
    DamagedRecordingError,
    RunRecording,
    open_store,
)
from dynaviz.views.record.sink import of_part

_HINT = "Give the run.rrd of a run, the .run.rrd.part of a killed run, or a live-N.rrd"


@dataclass(frozen=True)
class SalvagedRecording:
    """What was salvaged from a broken recording.

    Attributes:
        path: the file to open: the input itself if it needed no repair, None if nothing could be salvaged.
        answered: frames whose labels can be read.
        observed: frames with any data, at least ``answered``.
        frames: frames of the whole run; 0 if unknown.
        finished: whether the run finished, so that its result is there.
        damaged: number of damaged chunks, which are left out.
        live: whether it is of a live session, which has no result and no number of frames of its own.
    """

    path: Path | None
    answered: int = 0
    observed: int = 0
    frames: int = 0
    finished: bool = False
    damaged: int = 0
    live: bool = False

    @property
    def whole(self) -> bool:
        """Whether no frame is missing."""
        return self.path is not None and self.answered == self.frames


def repair(broken: str | os.PathLike[str], out: str | os.PathLike[str] | None = None) -> SalvagedRecording:
    """Salvage a recording; the broken file is not changed.

    Args:
        broken: a truncated ``run.rrd``, or ``.run.rrd.part``.
        out: where to write it; None for the recording's own name, or ``run-repaired.rrd`` if that exists.

    Raises:
        DataError: if the file cannot be read, is not the recording of a run or of a live session, or ``out`` cannot
            be written.
        UsageError: if ``out`` exists, or the file is the recording of a comparison.
    """
    broken = Path(broken)
    _check(broken)
    proper = of_part(broken)
    if proper is None and out is None and _opens(broken):
        return _count_frames(broken)
    target = _free(proper or broken) if out is None else Path(out)
    if target.exists():
        raise UsageError(f"{target} exists already. Remove it, or choose another name with -o")
    with _complete_copy(broken, target) as (salvaged, damaged):
        try:
            kind = AnyRecording(salvaged).kind
        except DataError:  # not even the properties were written, or they are damaged
            return SalvagedRecording(None, damaged=damaged)
        if kind not in (paths.PROPERTIES, paths.LIVE):
            again = "Write it again with dynaviz compare" if kind == COMPARISON else "Run the method again"
            raise UsageError(f"{broken} contains {KINDS[kind]}, not a run. {again}")
        found = _count_frames(salvaged)
        if not found.observed:
            return SalvagedRecording(None, frames=found.frames, damaged=damaged)
        os.replace(salvaged, target)
    return replace(found, path=target, damaged=damaged)


def repaired(recording: Path) -> Path:
    """The recording itself, or if it is incomplete or damaged, what ``repair`` saves of it in ``*-repaired.rrd``.

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
    found = repair(recording, target)
    if found.path is None:
        raise DataError(recording, f"{problem}, and nothing of it can be saved", hint="Run the method again")
    damaged = f", without {found.damaged} damaged chunk{'s' * (found.damaged != 1)}" if found.damaged else ""
    frames = f"{found.answered} of {found.frames} frames"
    if not found.answered:
        frames = f"states of {found.observed} of {found.frames} frames"
    warnings.warn(f"{recording}: {problem}. Saved {frames}{damaged} in {target}", stacklevel=2)
    return target


def _check(broken: Path) -> None:
    try:
        with broken.open("rb") as file:
            magic = file.read(4)
    except OSError as error:
        raise DataError(broken, error.strerror or "cannot be read", hint=_HINT) from None
    if not any(known.startswith(magic) for known in MAGIC):  # the file may be truncated anywhere
        raise DataError(broken, "is not a recording", at="byte 0", hint=_HINT)


def _opens(path: Path) -> bool:
    with contextlib.suppress(DataError):
        open_store(path)
        return True
    return False


def _free(name: Path) -> Path:
    """A name that does not overwrite an existing recording."""
    return name if not name.exists() else name.with_name(f"{name.stem}-repaired{name.suffix}")


@contextlib.contextmanager
def _complete_copy(broken: Path, target: Path) -> Iterator[tuple[Path, int]]:
    """Copy all undamaged chunks to a file next to the target, deleted after the block; and the number of damaged ones.

    The end of a truncated file does not count.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".repair-", dir=target.parent) as folder:
            salvaged, source, damaged = Path(folder) / "salvaged.rrd", broken, 0
            if (first := chunks.first_damage(broken)) is not None and not first.truncated:  # some end the program
                source = Path(folder) / "undamaged.rrd"
                damaged = chunks.copy_undamaged(broken, source)
            command = [viewer.program(), "rrd", "merge", "--continue-on-error", str(source), "-o", str(salvaged)]
            done = subprocess.run(command, capture_output=True, check=False, text=True, errors="replace")
            if done.returncode:
                message = (done.stderr.strip().splitlines() or ["no message"])[-1]
                raise DataError(
                    target, f"cannot be written ({message[:200]})", hint="Free space or choose another folder with -o"
                )
            yield salvaged, damaged
    except OSError as error:
        raise DataError(
            target, f"cannot be written ({error.strerror})", hint="Choose another folder with -o"
        ) from error


def _count_frames(path: Path) -> SalvagedRecording:
    """Count the frames in a recording that opens.

    Raises:
        DataError: if it is not the recording of a run or of a live session.
    """
    if (live := AnyRecording(path)).kind == paths.LIVE:
        return SalvagedRecording(path, live.frames, live.frames, live.frames, finished=True, live=True)
    recording = RunRecording(path)
    answered = 0
    with contextlib.suppress(DataError):  # for a damaged frame
        for answered, _ in enumerate(recording.answers(), 1):  # noqa: B007
            pass
    observed = answered or _observed(path)
    return SalvagedRecording(path, answered, observed, int(recording.properties["frames"]), recording.complete)


def _observed(path: Path) -> int:
    """Number of frames with any state of the method; log lines do not count."""
    frames: set[int] = set()
    recording = AnyRecording(path)
    with recording.decoding():
        for chunk in recording.store.stream().filter(has_timeline=paths.FRAME):
            if chunk.entity_path != f"/{paths.LOG}":
                frames |= set(chunk.to_record_batch()[paths.FRAME].to_pylist())
    return len(frames)
