"""The file of a recording: written as ``.part``, flushed often, renamed when complete.

May feed a viewer.
"""

from __future__ import annotations

import contextlib
import os
import re
import time
import uuid
import warnings
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from rerun.chunk import Chunk, RrdReader

from dynaviz.errors import DataError
from dynaviz.views import paths, reading_order, viewer
from dynaviz.views.pipe import open_writer

FLUSH_SECONDS = 60.0


def part_of(path: Path) -> Path:
    """The file a recording is written to until it is complete; a killed run leaves it behind."""
    return path.with_name(f".{path.name}.part")


def of_part(path: Path) -> Path | None:
    """The inverse of ``part_of``; None if the path is not of that form."""
    name = path.name.removeprefix(".").removesuffix(".part")
    return path.with_name(name) if path == part_of(path.with_name(name)) else None


class RecordingFile:
    """An open recording.

    Args:
        path: the recording; its folder is created. The file appears with ``finish``.
        layout_id: recordings with the same id share the viewer's layout.
        name: of the recording, for display.
        blueprint: the viewer's layout.
        live: port of a viewer on this machine that follows the run, or None; it may be closed at
            any time.

    Raises:
        DataError: if the file cannot be written.
    """

    def __init__(
        self, path: Path, layout_id: str, name: str, blueprint: Any, live: int | None = None
    ) -> None:
        self.path = path
        self._port = live
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = open_writer(part_of(path))
        except OSError as error:
            raise self._unwritable(error) from None
        self._file = _stream(layout_id)
        self._file.save(self._writer.inlet, default_blueprint=blueprint)
        self._layout = blueprint
        self._flushed = 0.0
        # the viewer has its own stream, so that it cannot damage the file
        self._streams = [self._file]
        if live is not None and viewer.listens(live):
            self._streams.append(_stream(layout_id))
            self._streams[-1].connect_grpc(viewer.url(live), default_blueprint=blueprint)
        for stream in self._streams:
            stream.set_log_time_enabled(False)
            stream.send_recording_name(name)

    @property
    def size(self) -> int:
        """Bytes in the file so far, as of the last flush."""
        try:
            return part_of(self.path).stat().st_size
        except OSError:
            return 0

    def at(self, frame: int, stamp_ns: int | None) -> None:
        """Set the frame of everything logged from here on."""
        for stream in self._streams:
            stream.reset_time()
            stream.set_time(paths.FRAME, sequence=frame)
            if stamp_ns is not None:
                stream.set_time(paths.SENSOR_TIME, timestamp=np.datetime64(stamp_ns, "ns"))

    def at_case(self, number: int) -> None:
        """Set the index on the timeline of cases of everything logged from here on."""
        for stream in self._streams:
            stream.reset_time()
            stream.set_time(paths.CASE, sequence=number)

    def log(self, path: str, *what: Any, static: bool = False) -> None:
        """Log archetypes to an entity."""
        for stream in self._streams:
            stream.log(path, *what, static=static)

    def columns(
        self, path: str, frames: Sequence[int], stamps: Sequence[int | None], columns: Any
    ) -> None:
        """Log one value for each of several frames."""
        times = [rr.TimeColumn(paths.FRAME, sequence=frames)]
        if None not in stamps:
            times.append(
                rr.TimeColumn(paths.SENSOR_TIME, timestamp=np.array(stamps, "datetime64[ns]"))
            )
        for stream in self._streams:
            stream.send_columns(path, indexes=times, columns=columns)

    def case_columns(
        self, path: str, numbers: Sequence[int], columns: Any, timeline: str = paths.CASE
    ) -> None:
        """Log one value for each of several cases, or indices of another timeline."""
        for stream in self._streams:
            stream.send_columns(
                path, indexes=[rr.TimeColumn(timeline, sequence=numbers)], columns=columns
            )

    def properties(self, kind: str = paths.PROPERTIES, **values: Any) -> None:
        """Set properties of a recording of some kind, skipping empty strings.

        Later values replace earlier ones.
        """
        kept = {name: value for name, value in values.items() if value != ""}
        for stream in self._streams:
            stream.send_property(kind, rr.AnyValues(**kept))

    def chunks(self, chunks: Iterable[Chunk]) -> None:
        """Write chunks, which contain their own times."""
        ready = list(chunks)
        for stream in self._streams:
            rr.send_chunks(ready, recording=stream)

    def layout(self, blueprint: Any) -> None:
        """Replace the viewer's layout."""
        self._layout = blueprint
        for stream in self._streams:
            stream.send_blueprint(blueprint, make_active=True, make_default=True)

    def written(self, contents: Sequence[str]) -> Iterator[Chunk]:
        """What was logged so far on the timeline of frames, below some entities, in any order.

        Raises:
            DataError: if the file cannot be written.
        """
        self.flush()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about the missing end of the file
            reader = RrdReader(part_of(self.path))
            yield from reader.stream().filter(
                content=[f"/{path}" for path in contents], has_timeline=paths.FRAME
            )

    def flush(self, pending: float = 0.0) -> None:
        """Write everything logged so far to the file; disconnect from a viewer that was closed.

        Args:
            pending: do nothing if the last flush is less than this ago, seconds.

        Raises:
            DataError: if it cannot be written, for example on a full disk.
        """
        now = time.monotonic()
        if now - self._flushed < pending:
            return
        self._flushed = now
        self._file.flush(timeout_sec=FLUSH_SECONDS)
        try:
            self._writer.settle()
        except OSError as error:
            raise self._unwritable(error) from None
        if len(self._streams) > 1 and self._port is not None and not viewer.listens(self._port):
            self._streams.pop().disconnect()

    def finish(self, by_frame: Sequence[str] = (), left_out: Sequence[str] = ()) -> None:
        """Close the file, put it into the order of reading, and give it its final name.

        Args:
            by_frame: entities whose content makes up the frames; none, and the file stays as it was
                written.
            left_out: of these, entities that remain only on the timeline of cases.

        Raises:
            DataError: if the end cannot be written; the part remains, for repair.
        """
        try:
            self._close()
            if by_frame:
                reading_order.rewrite(part_of(self.path), self._layout, by_frame, left_out)
            os.replace(part_of(self.path), self.path)
        except OSError as error:
            raise self._unwritable(error) from None

    def close(self) -> None:
        """Close the file and leave it as ``.part``, for repair.

        Errors were reported before or are dropped.
        """
        with contextlib.suppress(OSError):
            self._close()

    def _close(self) -> None:
        for stream in self._streams:
            stream.disconnect()
        self._writer.close()

    def _unwritable(self, error: OSError) -> DataError:
        hint = "Free space or choose another folder with -o, and run again"
        return DataError(self.path, f"cannot be written ({error.strerror})", hint=hint)


def _stream(layout_id: str) -> rr.RecordingStream:
    """A stream with a new recording id: the viewer would merge two recordings with the same id."""
    return rr.RecordingStream(
        _plain(layout_id), recording_id=str(uuid.uuid4()), send_properties=False
    )


def _plain(name: str) -> str:
    """A valid application id: letters, digits, ``_``, space and ``-``; at most 180."""
    return re.sub(r"[^A-Za-z0-9_ -]", "_", name)[:180]
