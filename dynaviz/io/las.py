"""LAS and LAZ files (1.0 to 1.4), read with laspy; their headers are believed only as far as the file is long."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import IO

import numpy as np

from dynaviz.arrays import F32
from dynaviz.errors import DataError, MissingDependency
from dynaviz.io.atomic import opened

_HINT = "Write or copy the file again"
_AT_ONCE = 100_000  # points; laspy makes room for as many as it is asked for
_RECORD = 54  # bytes of the header of a variable length record, at least
_PACKED = 0x80  # bit of the point format where points are compressed


def read_las(path: str | os.PathLike[str]) -> F32:
    """Read the points.

    Returns:
        (N, 3) float32, metres, in the file's frame: scaled and shifted as the header says.

    Raises:
        DataError: for a file that cannot be read, is damaged or too short.
        MissingDependency: without laspy.
    """
    path = Path(path)
    try:
        import laspy
    except ModuleNotFoundError:
        raise MissingDependency(
            f"{path}: LAS and LAZ files need laspy. Install it with: pip install 'dynaviz[las]'"
        ) from None
    with opened(path, _HINT) as file:
        try:
            size = _believable(file)
            # One thread: the other decompressor reserves what the file says that a chunk holds, and ends the process.
            one_thread = laspy.LazBackend.Lazrs
            with laspy.open(file, closefd=False, read_evlrs=False, laz_backend=one_thread) as las:
                header = las.header
                held = (size - header.offset_to_point_data) // header.point_format.size
                if held < header.point_count and not header.are_points_compressed:
                    raise ValueError(f"too short: {header.point_count} points in its header, room for {held}")
                parts = [np.column_stack([p.x, p.y, p.z]) for p in las.chunk_iterator(_AT_ONCE)]
        # Damaged files make laspy and its decompressor fail in many ways.
        except Exception as error:
            raise DataError(path, f"is no whole LAS file ({str(error)[:80]})", hint=_HINT) from None
    with np.errstate(over="ignore"):  # beyond float32 is infinite
        return np.concatenate([np.empty((0, 3)), *parts]).astype(np.float32)


def _believable(file: IO[bytes]) -> int:
    """The size of a file in bytes, if the records and points that its header announces have their place in it."""
    size = os.fstat(file.fileno()).st_size
    head = file.read(105)
    file.seek(0)
    if head[:4] != b"LASF" or len(head) < 105:
        raise ValueError("it does not begin as one")
    header_size, points_at, records = struct.unpack_from("<HII", head, 94)
    if not header_size + _RECORD * records <= points_at <= size:
        raise ValueError(f"{records} records and points from byte {points_at} on, in {size} bytes")
    if head[104] & _PACKED and (chunks := _chunks(file, points_at, size)) > size:
        raise ValueError(f"{chunks} chunks of points in {size} bytes")
    return size


def _chunks(file: IO[bytes], points_at: int, size: int) -> int:
    """How many chunks the table of a LAZ file announces, for which room is made before any is read; 0 without table."""

    def number(at: int, form: str) -> int:
        file.seek(at)
        content = file.read(struct.calcsize(form))
        return int(struct.unpack(form, content)[0]) if len(content) == struct.calcsize(form) else 0

    table = number(points_at, "<q")
    if table == -1:  # the writer could not go back: it stands at the end
        table = number(max(size - 8, 0), "<q")
    chunks = number(table + 4, "<I") if 0 <= table < size else 0
    file.seek(0)
    return chunks
