"""Random damage to files.

Bytes cut, flipped or moved, numbers, words and lines changed, or new content.
"""

from __future__ import annotations

import re
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

from hypothesis import strategies as st

_TOKEN = re.compile(rb'"(?:[^"\\]|\\.)*"|[^\s"<>=,:;\[\]{}/]+')
_WORDS = [
    *(
        b"nan",
        b"-inf",
        b"1e999",
        b"-1",
        b"0",
        b"1",
        b"0.5",
        b"1e19",
        b"1e-999",
        b"99999999999999999999",
        b"9" * 5000,
    ),
    *(
        b"9223372036854775807",
        b"-9223372036854775809",
        b"4294967296",
        b"281474976710655",
        b"1000000000000",
    ),
    *(
        b'""',
        b"null",
        b"[]",
        b"{}",
        b"true",
        b"[1]",
        b'{"a": 1}',
        b'"x"',
        b"x",
        b"a b",
        b"\xff\xfe",
        b"\x00",
        b"\x1b[",
    ),
    *(
        b"[" * 100_000,
        b'{"a":' * 50_000,
        b"\n",
        b"#",
        b'"' + b"x" * 300 + b'"',
        b"../x",
        b"\xe2\x80\xae",
    ),
]
_NUMBERS = [
    *(struct.pack("<I", n) for n in (0, 1, 2**24, 2**31 - 1, 2**31, 2**32 - 1)),
    *(struct.pack("<Q", n) for n in (0, 2**32, 2**40, 2**60, 2**63 - 1, 2**63, 2**64 - 1)),
    *(struct.pack(">I", n) for n in (2**24, 2**32 - 1)),
    *(struct.pack("<f", x) for x in (float("nan"), float("inf"), -3e38, 1e-40)),
    *(struct.pack("<d", x) for x in (float("nan"), float("inf"), -1e308)),
]


@st.composite
def damaged(draw: st.DrawFn, content: bytes) -> bytes:
    """The content of a file after up to three changes; sometimes unrelated bytes."""
    if draw(st.integers(0, 15)) == 15:
        return draw(st.binary(max_size=300))
    for change in draw(st.lists(st.sampled_from(_CHANGES), min_size=1, max_size=3)):
        content = change(draw, content)
    return content


def _position(draw: st.DrawFn, content: bytes) -> int:
    """A position, more often near the beginning or the end, where headers and indices are."""
    last = max(len(content) - 1, 0)
    near = min(last, 200)
    return draw(
        st.integers(0, last)
        | st.integers(0, near)
        | st.integers(0, near).map(lambda back: last - back)
    )


def _cut(draw: st.DrawFn, content: bytes) -> bytes:
    return content[: _position(draw, content)]


def _flip(draw: st.DrawFn, content: bytes) -> bytes:
    flipped = bytearray(content or b"\0")
    for _ in range(draw(st.integers(1, 8))):
        flipped[_position(draw, bytes(flipped))] ^= draw(st.integers(1, 255))
    return bytes(flipped)


def _number(draw: st.DrawFn, content: bytes) -> bytes:
    at, new = _position(draw, content), draw(st.sampled_from(_NUMBERS))
    return content[:at] + new + content[at + len(new) :]


def _splice(draw: st.DrawFn, content: bytes) -> bytes:
    """Remove, duplicate or move a piece."""
    at, size, to = _position(draw, content), draw(st.integers(1, 64)), _position(draw, content)
    kept = draw(st.sampled_from([content, content[:at] + content[at + size :]]))
    return kept[:to] + draw(st.sampled_from([b"", content[at : at + size]])) + kept[to:]


def _word(draw: st.DrawFn, content: bytes) -> bytes:
    words = [found.span() for found in _TOKEN.finditer(content[:100_000])]
    if not words:
        return content
    first, last = draw(st.sampled_from(words))
    other = draw(st.sampled_from(words))
    return (
        content[:first] + draw(st.sampled_from([*_WORDS, content[slice(*other)]])) + content[last:]
    )


def _line(draw: st.DrawFn, content: bytes) -> bytes:
    """Remove or duplicate a line."""
    lines = content.splitlines(keepends=True) or [b""]
    k = draw(st.integers(0, len(lines) - 1))
    return b"".join(lines[:k] + draw(st.sampled_from([[], [lines[k]] * 2])) + lines[k + 1 :])


_CHANGES: list[Callable[[st.DrawFn, bytes], bytes]] = [
    _cut,
    _flip,
    _number,
    _splice,
    _word,
    _word,
    _line,
]


def remove(path: Path) -> None:
    """Remove a file or folder, if it exists."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def messages(recording: bytes) -> list[tuple[int, bytes]]:
    """Kinds and contents of the messages of a recording; the last one is its index."""
    parts, at, kind = [], 12, -1
    while kind:
        kind, size = struct.unpack_from("<QQ", recording, at)
        parts.append((kind, recording[at + 16 : at + 16 + size]))
        at += 16 + size
    return parts


def recording_of(original: bytes, parts: list[tuple[int, bytes]]) -> bytes:
    """A recording with the head and tail of another and these messages."""
    end = 12 + sum(16 + len(content) for _, content in messages(original))
    return (
        original[:12]
        + b"".join(struct.pack("<QQ", kind, len(part)) + part for kind, part in parts)
        + original[end:]
    )
