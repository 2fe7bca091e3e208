"""Stream the records of a JSON file that is one list, because tables may be larger than memory."""

from __future__ import annotations

import codecs
import json
import os
from collections.abc import Iterator
from typing import IO, Any

from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file

_HINT = "Copy the file again"
_CHUNK = 1 << 20  # bytes
_MAX_RECORD = 8 * _CHUNK  # characters; a longer record is treated as corrupt
_BLANK = " \t\r\n"


def read_records(path: str | os.PathLike[str]) -> Iterator[dict[str, Any]]:
    """Read the records of a table in file order.

    Raises:
        DataError: if the file cannot be read, is truncated or is not a list of records; names the
            record.
    """
    with open_file(path, _HINT) as file:
        buffer = _Buffer(file)
        number = 0
        try:
            buffer.expect("[")
            while buffer.peek() != "]":
                if number:
                    buffer.expect(",")
                record = buffer.value()
                if not isinstance(record, dict):
                    raise ValueError("not a JSON object")
                yield record
                number += 1
        except (ValueError, RecursionError) as error:
            problem = f"not a valid list of records ({str(error)[:80]})"
            raise DataError(path, problem, at=f"record {number}", hint=_HINT) from None


class _Buffer:
    """A buffer of the characters that were read but not yet consumed."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._text = ""
        self._position = 0
        self._decode = codecs.getincrementaldecoder("utf-8")()
        self._json = json.JSONDecoder()

    def peek(self) -> str:
        """The next non-blank character, without consuming it."""
        while True:
            while self._position < len(self._text) and self._text[self._position] in _BLANK:
                self._position += 1
            if self._position < len(self._text):
                return self._text[self._position]
            if not self._read_chunk():
                raise ValueError("unexpected end of file")

    def expect(self, character: str) -> None:
        """Consume a character; ValueError if a different one follows."""
        if self.peek() != character:
            raise ValueError(f"found {self.peek()!r}, expected {character!r}")
        self._position += 1

    def value(self) -> Any:
        """Consume and return a JSON value."""
        self.peek()
        while True:
            try:
                value, self._position = self._json.raw_decode(self._text, self._position)
                return value
            except json.JSONDecodeError:
                if len(self._text) - self._position > _MAX_RECORD or not self._read_chunk():
                    raise

    def _read_chunk(self) -> bool:
        """Read the next chunk; False at the end of the file."""
        content = self._file.read(_CHUNK)
        self._text = self._text[self._position :] + self._decode.decode(content, final=not content)
        self._position = 0
        return bool(content)
