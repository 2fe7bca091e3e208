"""LAS and LAZ files (1.0 to 1.4), read with laspy after the sizes in the header are checked against
the file size.
"""

from __future__ import annotations

import os
import struct
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64, I64
from dynaviz.errors import DataError, MissingDependency
from dynaviz.io.atomic import open_file

_HINT = "Write or copy the file again"
_CHUNK = 100_000  # points; laspy allocates memory for as many points as requested
_RECORD_HEADER = 54  # bytes, minimum size of a variable-length record
_COMPRESSED = 0x80  # bit of the point format that marks compressed points


def read_las_fields(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """Read all dimensions.

    Returns:
        (N,) by name, in the types of the file: x, y and z in float64, metres, with scale and offset
        applied; and the other dimensions, of the standard and extra. One with several values per
        point is split: ``normal_0`` ...

    Raises:
        DataError: if the file cannot be read, is corrupt or too short.
        MissingDependency: if laspy is not installed.
    """
    parts = _read_chunks(Path(path))
    empty = {axis: np.empty(0) for axis in "xyz"}
    return (
        {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        if parts
        else empty
    )


def read_las_header(path: Path) -> Any:
    """The header of a file with its variable-length records, as laspy's ``LasHeader``.

    Raises:
        DataError, MissingDependency: as ``read_las_fields``.
    """
    laspy = import_laspy(path)
    with open_file(path, _HINT) as file:
        try:
            size = _checked_size(file)
            header = laspy.LasHeader.read_from(file)
            if header.number_of_evlrs and header.start_of_first_evlr < size:
                header.read_evlrs(file)
        except Exception as error:  # laspy raises many types of errors for corrupt files
            raise DataError(path, f"not a valid LAS file ({str(error)[:80]})", hint=_HINT) from None
    return header


def import_laspy(path: Path) -> Any:
    """The module laspy.

    Raises:
        MissingDependency: if it is not installed.
    """
    try:
        import laspy
    except ModuleNotFoundError:
        raise MissingDependency(
            f"{path}: LAS and LAZ files need laspy. Install it with: pip install 'laspy[lazrs]'"
        ) from None
    return laspy


def _fields(points: Any) -> dict[str, NDArray[Any]]:
    """The dimensions of some points, as ``read_las_fields`` gives them."""
    found = {axis: np.asarray(points[axis], np.float64) for axis in "xyz"}
    for name in points.point_format.dimension_names:
        values = np.array(points[name])
        if values.ndim > 1:
            found |= {f"{name}_{k}": values[:, k] for k in range(values.shape[1])}
        elif name not in ("X", "Y", "Z"):
            found[name] = values
    return found


def _read_chunks(path: Path) -> list[dict[str, NDArray[Any]]]:
    """The dimensions of each chunk of a file."""
    laspy = import_laspy(path)
    with open_file(path, _HINT) as file:
        try:
            size = _checked_size(file)
            # The parallel decompressor allocates the chunk size that the file states, which can
            # abort the process.
            single_threaded = laspy.LazBackend.Lazrs
            with laspy.open(
                file, closefd=False, read_evlrs=False, laz_backend=single_threaded
            ) as las:
                header = las.header
                available = (size - header.offset_to_point_data) // header.point_format.size
                if available < header.point_count and not header.are_points_compressed:
                    raise ValueError(
                        f"too short: the header states {header.point_count} points, the file has "
                        f"{available}"
                    )
                with np.errstate(over="ignore", invalid="ignore"):  # a damaged scale or offset
                    return [_fields(chunk) for chunk in las.chunk_iterator(_CHUNK)]
        # laspy and its decompressor raise many types of errors for corrupt files; PanicException is
        # not an Exception.
        except BaseException as error:
            if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
                raise
            raise DataError(path, f"not a valid LAS file ({str(error)[:80]})", hint=_HINT) from None


def _checked_size(file: IO[bytes]) -> int:
    """File size in bytes; ValueError if the records and points stated in the header do not fit into
    it.
    """
    size = os.fstat(file.fileno()).st_size
    head = file.read(105)
    file.seek(0)
    if head[:4] != b"LASF" or len(head) < 105:
        raise ValueError("wrong signature")
    header_size, points_at, records = struct.unpack_from("<HII", head, 94)
    if not header_size + _RECORD_HEADER * records <= points_at <= size:
        raise ValueError(
            f"{records} records and points from byte {points_at} do not fit into {size} bytes"
        )
    if head[104] & _COMPRESSED and (chunks := _chunk_count(file, points_at, size)) > size:
        raise ValueError(f"{chunks} chunks of points do not fit into {size} bytes")
    return size


def _chunk_count(file: IO[bytes], points_at: int, size: int) -> int:
    """Number of chunks that the chunk table of a LAZ file states; 0 without a table.

    The decompressor allocates memory for all of them before it reads the first one.
    """

    def number(at: int, form: str) -> int:
        file.seek(at)
        content = file.read(struct.calcsize(form))
        return int(struct.unpack(form, content)[0]) if len(content) == struct.calcsize(form) else 0

    table = number(points_at, "<q")
    if table == -1:  # written by a streaming writer: the offset is at the end of the file
        table = number(max(size - 8, 0), "<q")
    chunks = number(table + 4, "<I") if 0 <= table < size else 0
    file.seek(0)
    return chunks


GPS_EPOCH = 315_964_800
"""Unix time of 1980-01-06, seconds."""

ADJUSTED = 1_000_000_000
"""Seconds that LAS subtracts from GPS time, so that float64 has tenths of microseconds (adjusted
standard GPS time)."""

# Days at whose begin a leap second was inserted since the GPS epoch (IERS Bulletin C 70: none after
# 2017).
_INSERTED = (
    (1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7),
    (1993, 7), (1994, 7),
    (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1),
)  # fmt: skip
_LEAPS = np.array([datetime(year, month, 1, tzinfo=UTC).timestamp() for year, month in _INSERTED])


def leap_offset(unix: float) -> float:
    """Seconds to add to GPS time to get Unix time, at a Unix time in seconds."""
    return float(GPS_EPOCH - np.searchsorted(_LEAPS, unix, side="right"))


def adjusted_gps_time(unix_ns: I64) -> F64:
    """(N,) float64, seconds.

    Adjusted standard GPS time of Unix times, (N,) int64 nanoseconds, of one sweep.
    """
    offset = ADJUSTED + (leap_offset(float(unix_ns[0]) / 1e9) if len(unix_ns) else 0.0)
    whole, rest = np.divmod(unix_ns, 1_000_000_000)
    seconds: F64 = (whole - int(offset)) + rest * 1e-9
    return seconds
