"""The file of a recording: written beside, flushed every frame, renamed when whole; a live viewer may look on."""

from __future__ import annotations

import hashlib
import os
import re
import uuid
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from dynaviz.errors import DataError
from dynaviz.viz import paths

FLUSH_SECONDS = 60.0


def part_of(path: Path) -> Path:
    """Where a recording is written until it is whole; what a killed run leaves behind."""
    return path.with_name(f".{path.name}.part")


def sha256(path: str | os.PathLike[str]) -> str:
    """Digest of a finished recording's file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class Sink:
    """An open recording.

    Args:
        path: the recording; its folder is made. The file appears with ``finish``.
        layout_id: recordings of one id share the viewer's layout.
        name: of the recording, for its reader.
        blueprint: the viewer's layout.
        live: open a viewer that looks on.

    Raises:
        DataError: where the folder cannot be written.
    """

    def __init__(self, path: Path, layout_id: str, name: str, blueprint: Any, live: bool = False) -> None:
        self.path = path
        # A fresh id: the viewer would merge two recordings of one id.
        self._stream = rr.RecordingStream(_plain(layout_id), recording_id=str(uuid.uuid4()), send_properties=False)
        file = rr.FileSink(part_of(path))
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part_of(path).touch()
        except OSError as error:
            raise DataError(path, f"cannot be written ({error.strerror})", hint="Choose another folder with -o") from None
        self._stream.set_sinks(file, default_blueprint=blueprint)
        self._stream.set_log_time_enabled(False)
        self._stream.send_recording_name(name)

    def at(self, frame: int, stamp_ns: int | None) -> None:
        """What is logged from here on is of this frame."""
        self._stream.reset_time()
        self._stream.set_time(paths.FRAME, sequence=frame)
        if stamp_ns is not None:
            self._stream.set_time(paths.SENSOR_TIME, timestamp=np.datetime64(stamp_ns, "ns"))

    def log(self, path: str, *what: Any, static: bool = False) -> None:
        """Log archetypes to an entity."""
        self._stream.log(path, *what, static=static)

    def columns(self, path: str, frames: Any, columns: Any) -> None:
        """Log a value for each of many frames at once."""
        self._stream.send_columns(path, indexes=[rr.TimeColumn(paths.FRAME, sequence=frames)], columns=columns)

    def properties(self, **values: Any) -> None:
        """Set the recording's properties, those that are not empty; later ones replace earlier ones."""
        self._stream.send_property(paths.PROPERTIES, rr.AnyValues(**{k: v for k, v in values.items() if v != ""}))

    def flush(self) -> None:
        """Hand all that was logged to the operating system."""
        self._stream.flush(timeout_sec=FLUSH_SECONDS)

    def finish(self) -> None:
        """Close the file and give it its name."""
        self._stream.disconnect()
        os.replace(part_of(self.path), self.path)

    def abort(self) -> None:
        """Close the file and leave it where it is, for repair."""
        self._stream.disconnect()


def _plain(name: str) -> str:
    """An application id may hold few characters, and at most 180 of them."""
    return re.sub(r"[^A-Za-z0-9_ -]", "_", name)[:180]
