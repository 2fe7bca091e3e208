"""What an MCAP file contains: its profile, and the encoding and schema of each channel.

MCAP holds messages of any kind; those of ROS 2 in CDR can be read. Others are named, because the
file is neither truncated nor corrupt.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

from dynaviz.errors import DataError

MAGIC = b"\x89MCAP0\r\n"
_HEADER = 0x01
_FOOTER = 0x02
_SCHEMA = 0x03
_CHANNEL = 0x04
_TAIL = 9 + 20 + len(MAGIC)  # bytes of the footer and what follows it
_MOST = 64 << 20  # bytes of a summary, at most
_CONVERT = {
    "ros1": "Convert it to a ROS 1 bag, or to ROS 2: rosbags-convert --src FILE --dst FOLDER",
    "protobuf": "Convert its clouds to sensor_msgs/PointCloud2 in CDR, or write a file per scan",
}


def check_mcap(path: Path) -> None:
    """Raise DataError if the messages of an MCAP file are not those of ROS 2.

    Files of other formats, and those without a readable summary, are left to their reader.
    """
    if path.suffix.lower() != ".mcap":
        return
    try:
        channels = read_channels(path)
    except (OSError, ValueError, struct.error):
        return
    readable = [schema for schema, encoding in channels if encoding in ("cdr", "")]
    if not channels or readable:
        return
    kinds = sorted({encoding for _, encoding in channels})
    names = sorted({schema for schema, _ in channels if schema})
    shown = f" ({', '.join(names[:4])})" if names else ""
    hint = _CONVERT.get(kinds[0], "Write sensor_msgs/PointCloud2 in CDR, as ROS 2 records it")
    problem = (
        f"is an intact MCAP file with messages in {', '.join(kinds)}{shown}, not those of ROS 2"
    )
    raise DataError(path, problem, hint=hint)


def read_channels(path: Path) -> list[tuple[str, str]]:
    """Name of the schema and encoding of the messages of each channel in the summary.

    Raises:
        ValueError: if it is not an MCAP file, or has no summary.
    """
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise ValueError("not an MCAP file")
        size = path.stat().st_size
        file.seek(max(size - _TAIL, 0))
        tail = file.read(_TAIL)
        if len(tail) < _TAIL or tail[0] != _FOOTER or not tail.endswith(MAGIC):
            raise ValueError("no footer")
        start = struct.unpack_from("<Q", tail, 9)[0]
        if not 0 < start < size or size - start > _MOST:
            raise ValueError("no summary")
        file.seek(start)
        content = file.read(size - start)
    schemas: dict[int, str] = {}
    channels = []
    for kind, record in _records(content):
        if kind == _SCHEMA:
            number = struct.unpack_from("<H", record)[0]
            schemas[number] = _text(record, 2)[0]
        elif kind == _CHANNEL:
            schema = struct.unpack_from("<H", record, 2)[0]
            _, after = _text(record, 4)
            channels.append((schema, _text(record, after)[0]))
    return [(schemas.get(schema, ""), encoding) for schema, encoding in channels]


def _records(content: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at + 9 <= len(content):
        kind = content[at]
        length = struct.unpack_from("<Q", content, at + 1)[0]
        if kind == _FOOTER:
            return
        yield kind, content[at + 9 : at + 9 + length]
        at += 9 + length


def _text(record: bytes, at: int) -> tuple[str, int]:
    """A text of a record, and where it ends."""
    length = struct.unpack_from("<I", record, at)[0]
    end = at + 4 + length
    return record[at + 4 : end].decode("utf-8", "replace"), end
