"""Ledgers as they are stored in a recording."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import msgspec
import numpy as np
import rerun as rr

from dynaviz.arrays import U8
from dynaviz.explain.point_ledger import PointLedger

ARCHETYPE = "dynaviz.Ledgers"
SAMPLE = "dynaviz.Sample"  # of dynaviz.explain.dial
COMPONENT = "packed"
MOST_BYTES = 5_000_000  # of all ledgers in a recording; those of the last cases are left out


class _Row(msgspec.Struct):
    """Of a ledger only the row of its point, which decodes ten times as fast."""

    point: int


_decoder = msgspec.msgpack.Decoder(tuple[PointLedger, ...])
_rows = msgspec.msgpack.Decoder(tuple[_Row, ...])


def pack(ledgers: Sequence[PointLedger]) -> bytes:
    """The ledgers as compressed MessagePack."""
    return zlib.compress(msgspec.msgpack.encode(ledgers), 6)


def unpack(packed: U8) -> tuple[PointLedger, ...]:
    """The inverse of ``pack``.

    Raises ``zlib.error`` or ``msgspec.DecodeError`` for damaged content.
    """
    return _decoder.decode(zlib.decompress(packed.tobytes()))


def rows(packed: U8) -> list[int]:
    """The rows of the points of ledgers in their scans; raises as ``unpack``."""
    return [each.point for each in _rows.decode(zlib.decompress(packed.tobytes()))]


def component(packed: bytes, archetype: str = ARCHETYPE) -> rr.DynamicArchetype:
    """Packed ledgers, or a packed sample, to log."""
    return rr.DynamicArchetype(archetype, components={COMPONENT: np.frombuffer(packed, np.uint8)})
