"""The chunks of a recording file, checked one by one without rerun.

Rerun stops at the first damaged chunk, and some damaged chunks end its whole process, because their
table refers to bytes outside of it. So each chunk is decoded here first with pyarrow, which checks
all sizes, at some 200 MB a second.

A recording is a header of 12 bytes and a series of messages: their kind and size as two uint64, and
the content in protobuf. A chunk is a message of kind 2, whose field 5 is an Arrow IPC stream,
mostly compressed with LZ4.
"""

from __future__ import annotations

import functools
import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa

# bytes before the first message; kind and size of a message
_START = 12
_HEAD = struct.Struct("<QQ")
_END, _STORE, _CHUNK, _LAYOUT = range(4)  # kinds of messages
# fields of a chunk
_COMPRESSION = 2
_SIZE = 3
_TABLE = 5
# end of a layout's message: make it active and default
_ACTIVE = b"\x10\x01\x18\x01"
_PASSIVE = b"\x10\x00\x18\x01"
_INDEX = b"rerun:index_name"  # of a column that is a timeline
_LZ4 = 2  # a compression; 1 is none
_MOST = 255  # bytes that LZ4 decompresses from one byte, at most


@dataclass(frozen=True, slots=True)
class Damage:
    """A part of the file that cannot be read.

    Attributes:
        at, end: its first byte, and the first byte after it.
        problem: what is wrong.
        truncated: whether a message extends beyond the end of the file, and no other follows.
    """

    at: int
    end: int
    problem: str
    truncated: bool = False


def first_damage(path: Path) -> Damage | None:
    """The first damage of a recording, or None; a file is checked once per process.

    Raises:
        OSError: if the file cannot be read.
    """
    facts = path.stat()
    return _first_damage(path, facts.st_size, facts.st_mtime_ns)


@functools.lru_cache(maxsize=64)
def _first_damage(path: Path, size: int, changed: int) -> Damage | None:
    return next(damages(path), None)


def damages(path: Path) -> Iterator[Damage]:
    """All damages of a recording in file order.

    Raises:
        OSError: if the file cannot be read.
    """
    with path.open("rb") as file:
        if file.seek(0, 2) <= _START:
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            at = _START
            while at + _HEAD.size <= len(content):
                kind, size = _HEAD.unpack_from(content, at)
                after = at + _HEAD.size + size
                if kind > _LAYOUT or after > len(content):
                    after = _next_chunk(content, at + 1)
                    yield Damage(at, after, f"a message of {size:,} bytes", after == len(content))
                elif kind == _CHUNK and (problem := _problem(content[at + _HEAD.size : after])):
                    yield Damage(at, after, problem)
                elif kind == _END:
                    return
                at = after


def copy_undamaged(path: Path, out: Path) -> int:
    """Copy a recording without its damaged parts; return their number, without a truncated end.

    Raises:
        OSError: if the file cannot be read, or the copy not written.
    """
    count = at = 0
    with path.open("rb") as file, out.open("wb") as copy:
        for damage in damages(path):
            count += not damage.truncated
            file.seek(at)
            copy.write(file.read(damage.at - at))
            at = damage.end
        file.seek(at)
        copy.write(file.read())
    return count


def without_layout(path: Path) -> Iterator[bytes]:
    """The bytes of a recording whose own layouts are passive, so that a viewer keeps the one that
    it shows.

    Raises:
        OSError: if the file cannot be read.
    """
    with path.open("rb") as file:
        yield file.read(_START)
        for kind, message in _messages(file):
            if kind == _LAYOUT and message.endswith(_ACTIVE):
                message = message.removesuffix(_ACTIVE) + _PASSIVE
            yield message


def chunks_in(path: Path) -> Iterator[tuple[int, int, str, set[str]]]:
    """First byte, end, entity and timelines of each chunk of a recording, in file order.

    Raises:
        OSError: if the file cannot be read.
    """
    with path.open("rb") as file:
        at = len(file.read(_START))
        for kind, message in _messages(file):
            if kind == _CHUNK:
                schema = _table(message[_HEAD.size :]).schema
                known = (field.metadata or {} for field in schema)
                indexes = {of[_INDEX].decode() for of in known if _INDEX in of}
                entity = (schema.metadata or {})[b"rerun:entity_path"].decode()
                yield at, at + len(message), entity, indexes
            at += len(message)


def _table(content: bytes) -> Any:
    """The table of a chunk, as a reader of its batches.

    Raises:
        ValueError: for a size that cannot be right.
    """
    fields = dict(_fields(content))
    table = fields[_TABLE]
    if fields.get(_COMPRESSION) == _LZ4:
        size = fields[_SIZE]
        if size > _MOST * len(table):
            raise ValueError(f"{len(table):,} bytes cannot contain {size:,}")
        table = pa.decompress(table, size, "lz4_raw")
    return pa.ipc.open_stream(table)


def _messages(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Kinds and bytes of the messages of a recording, without its end, which refers to positions in
    it.
    """
    while len(head := file.read(_HEAD.size)) == _HEAD.size:
        kind, size = _HEAD.unpack(head)
        if kind == _END:
            return
        yield kind, head + file.read(size)


def _next_chunk(content: mmap.mmap, at: int) -> int:
    """The position of the first valid chunk from a position on; the end if there is none."""
    kind = struct.pack("<Q", _CHUNK)
    while (at := content.find(kind, at)) >= 0 and at + _HEAD.size <= len(content):
        after = at + _HEAD.size + _HEAD.unpack_from(content, at)[1]
        if after <= len(content) and _problem(content[at + _HEAD.size : after]) is None:
            return at
        at += 1
    return len(content)


def _problem(content: bytes) -> str | None:
    """What is wrong with a chunk, or None."""
    try:
        with _table(content) as batches:
            rows = 0
            for batch in batches:
                batch.validate(full=True)
                rows += batch.num_rows
        if not rows:
            raise ValueError("contains no rows")
    # Arrow raises many types of errors for damaged tables.
    except Exception as error:
        return " ".join(str(error).split())[:80].rstrip(".") or type(error).__name__
    return None


def _fields(content: bytes) -> Iterator[tuple[int, Any]]:
    """Numbers and values of the fields of a protobuf message: integers and bytes."""
    view = memoryview(content)
    at = 0
    while at < len(view):
        tag, at = _varint(view, at)
        value, at = _varint(view, at)
        if tag & 7 == 2:
            if value > len(view) - at:
                raise ValueError("a field exceeds its message")
            yield tag >> 3, view[at : at + value]
            at += value
        elif tag & 7 == 0:
            yield tag >> 3, value
        else:
            raise ValueError(f"a field of type {tag & 7}")


def _varint(view: memoryview, at: int) -> tuple[int, int]:
    """An integer of seven bits a byte, and the position after it."""
    value = 0
    for shift in range(0, 64, 7):
        if at >= len(view):
            break
        value |= (view[at] & 0x7F) << shift
        at += 1
        if view[at - 1] < 0x80:
            return value, at
    raise ValueError("an incomplete number")
