"""Salvage a recording whose writer was killed: every frame that was flushed, and the layout."""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from dynaviz.errors import DataError, UsageError
from dynaviz.viz import paths, viewer
from dynaviz.viz.reader import MAGIC, AnyRecording, RunRecording, open_store
from dynaviz.viz.sink import of_part

_HINT = "Give the run.rrd of a run, or the .run.rrd.part that a killed one left"


@dataclass(frozen=True)
class SalvagedRecording:
    """What became of a broken recording.

    Attributes:
        path: where it can be opened now; the file itself where nothing was to be done, None where nothing was left.
        answered: frames whose answers can be read.
        observed: frames of which there is anything, as many as ``answered`` or more.
        frames: frames of the whole run; 0 where even that is unknown.
        finished: whether the run itself was finished, with its result.
    """

    path: Path | None
    answered: int = 0
    observed: int = 0
    frames: int = 0
    finished: bool = False

    @property
    def whole(self) -> bool:
        """Whether no frame is missing."""
        return self.path is not None and self.answered == self.frames


def repair(broken: str | os.PathLike[str], out: str | os.PathLike[str] | None = None) -> SalvagedRecording:
    """Salvage a recording; the broken file stays as it is.

    Args:
        broken: ``run.rrd`` that was cut off, or ``.run.rrd.part``.
        out: where to write it; None for the recording's own name, or ``run-repaired.rrd`` where that is taken.

    Raises:
        DataError: where the file cannot be read, is no recording of a run, or ``out`` cannot be written.
        UsageError: where ``out`` exists.
    """
    broken = Path(broken)
    _check(broken)
    proper = of_part(broken)
    if proper is None and out is None and _opens(broken):
        return _salvage(broken)
    target = _free(proper or broken) if out is None else Path(out)
    if target.exists():
        raise UsageError(f"{target} exists already: remove it, or choose another name with -o")
    with _salvaged(broken, target) as beside:
        try:
            kind = AnyRecording(beside).kind
        except DataError:  # not even what it was
            return SalvagedRecording(None)
        if kind != paths.PROPERTIES:
            raise UsageError(f"{broken} holds a {kind}, not a run: write it again with dynaviz compare")
        found = _salvage(beside)
        if not found.observed:
            return SalvagedRecording(None, frames=found.frames)
        os.replace(beside, target)
    return SalvagedRecording(target, found.answered, found.observed, found.frames, found.finished)


def _check(broken: Path) -> None:
    try:
        with broken.open("rb") as file:
            magic = file.read(4)
    except OSError as error:
        raise DataError(broken, error.strerror or "cannot be read", hint=_HINT) from None
    if not any(known.startswith(magic) for known in MAGIC):  # it may be cut off anywhere
        raise DataError(broken, "is not a recording", at="byte 0", hint=_HINT)


def _opens(path: Path) -> bool:
    with contextlib.suppress(DataError):
        open_store(path)
        return True
    return False


def _free(name: Path) -> Path:
    """A recording that is there is left alone."""
    return name if not name.exists() else name.with_name(f"{name.stem}-repaired{name.suffix}")


@contextlib.contextmanager
def _salvaged(broken: Path, target: Path) -> Iterator[Path]:
    """Copy all whole messages to a file beside the target, and close it properly; it is gone after the block."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".repair-", dir=target.parent) as folder:
            beside = Path(folder) / "salvaged.rrd"
            command = [viewer.program(), "rrd", "merge", "--continue-on-error", str(broken), "-o", str(beside)]
            done = subprocess.run(command, capture_output=True, check=False, text=True, errors="replace")
            if done.returncode:
                said = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
                raise DataError(
                    target, f"cannot be written ({said[:200]})", hint="Free space or choose another folder with -o"
                )
            yield beside
    except OSError as error:
        raise DataError(
            target, f"cannot be written ({error.strerror})", hint="Choose another folder with -o"
        ) from error


def _salvage(path: Path) -> SalvagedRecording:
    """What a recording that opens holds of its run.

    Raises:
        DataError: where it is none of a run.
    """
    recording = RunRecording(path)
    answered = 0
    with contextlib.suppress(DataError):  # of a frame that is damaged
        for answered, _ in enumerate(recording.answers(), 1):  # noqa: B007
            pass
    observed = answered or _observed(path)
    return SalvagedRecording(path, answered, observed, int(recording.properties["frames"]), recording.complete)


def _observed(path: Path) -> int:
    """Frames of which a method showed any state; the run's own words are no frame."""
    frames: set[int] = set()
    for chunk in open_store(path).stream().filter(has_timeline=paths.FRAME):
        if chunk.entity_path != f"/{paths.LOG}":
            frames |= set(chunk.to_record_batch()[paths.FRAME].to_pylist())
    return len(frames)
