"""The file of a recording: written beside, flushed every frame, renamed when whole; a live viewer may look on."""

from __future__ import annotations

import contextlib
import os
import re
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from dynaviz.errors import DataError
from dynaviz.viz import paths, viewer
from dynaviz.viz.pipe import PipeWriter

FLUSH_SECONDS = 60.0


def part_of(path: Path) -> Path:
    """Where a recording is written until it is whole; what a killed run leaves behind."""
    return path.with_name(f".{path.name}.part")


def of_part(path: Path) -> Path | None:
    """The recording's place, from where it was being written; None for another path."""
    name = path.name.removeprefix(".").removesuffix(".part")
    return path.with_name(name) if path == part_of(path.with_name(name)) else None


class RecordingFile:
    """An open recording.

    Args:
        path: the recording; its folder is made. The file appears with ``finish``.
        layout_id: recordings of one id share the viewer's layout.
        name: of the recording, for its reader.
        blueprint: the viewer's layout.
        live: port on this machine of a viewer that looks on, or None; it may be absent, or go at any time.

    Raises:
        DataError: where the folder cannot be written.
    """

    def __init__(self, path: Path, layout_id: str, name: str, blueprint: Any, live: int | None = None) -> None:
        self.path, self._port = path, live
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._tap = PipeWriter(part_of(path))
        except OSError as error:
            raise self._unwritable(error) from None
        self._file = _stream(layout_id)
        self._file.save(self._tap.inlet, default_blueprint=blueprint)
        self._streams = [self._file]  # a stream of its own for the viewer: whatever happens to it, the file is whole
        if live is not None and viewer.listens(live):
            self._streams.append(_stream(layout_id))
            self._streams[-1].connect_grpc(viewer.url(live), default_blueprint=blueprint)
        for stream in self._streams:
            stream.set_log_time_enabled(False)
            stream.send_recording_name(name)

    def at(self, frame: int, stamp_ns: int | None) -> None:
        """What is logged from here on is of this frame."""
        for stream in self._streams:
            stream.reset_time()
            stream.set_time(paths.FRAME, sequence=frame)
            if stamp_ns is not None:
                stream.set_time(paths.SENSOR_TIME, timestamp=np.datetime64(stamp_ns, "ns"))

    def log(self, path: str, *what: Any, static: bool = False) -> None:
        """Log archetypes to an entity."""
        for stream in self._streams:
            stream.log(path, *what, static=static)

    def columns(self, path: str, frames: Sequence[int], stamps: Sequence[int | None], columns: Any) -> None:
        """Log a value for each of many frames at once."""
        times = [rr.TimeColumn(paths.FRAME, sequence=frames)]
        if None not in stamps:
            times.append(rr.TimeColumn(paths.SENSOR_TIME, timestamp=np.array(stamps, "datetime64[ns]")))
        for stream in self._streams:
            stream.send_columns(path, indexes=times, columns=columns)

    def properties(self, **values: Any) -> None:
        """Set the recording's properties, those that are not empty; later ones replace earlier ones."""
        kept = {name: value for name, value in values.items() if value != ""}
        for stream in self._streams:
            stream.send_property(paths.PROPERTIES, rr.AnyValues(**kept))

    def flush(self) -> None:
        """Hand all that was logged to the operating system; let go of a viewer that was closed.

        Raises:
            DataError: where it cannot be written, as on a full disk.
        """
        self._file.flush(timeout_sec=FLUSH_SECONDS)
        try:
            self._tap.settle()
        except OSError as error:
            raise self._unwritable(error) from None
        if len(self._streams) > 1 and self._port is not None and not viewer.listens(self._port):
            self._streams.pop().disconnect()

    def finish(self) -> None:
        """Close the file and give it its name.

        Raises:
            DataError: where its end cannot be written; what was written stays where it is, for repair.
        """
        try:
            self._close()
            os.replace(part_of(self.path), self.path)
        except OSError as error:
            raise self._unwritable(error) from None

    def close(self) -> None:
        """Close the file and leave it where it is, for repair. What cannot be written was told already, or is lost."""
        with contextlib.suppress(OSError):
            self._close()

    def _close(self) -> None:
        for stream in self._streams:
            stream.disconnect()
        self._tap.close()

    def _unwritable(self, error: OSError) -> DataError:
        hint = "Free space or choose another folder with -o, and run again"
        return DataError(self.path, f"cannot be written ({error.strerror})", hint=hint)


def _stream(layout_id: str) -> rr.RecordingStream:
    """A fresh recording id each: the viewer would merge two recordings of one id."""
    return rr.RecordingStream(_plain(layout_id), recording_id=str(uuid.uuid4()), send_properties=False)


def _plain(name: str) -> str:
    """An application id may hold few characters, and at most 180 of them."""
    return re.sub(r"[^A-Za-z0-9_ -]", "_", name)[:180]
