"""A JSON file that is one long list of records, read one record at a time: tables may be larger than memory."""

from __future__ import annotations

import codecs
import json
import os
from collections.abc import Iterator
from typing import IO, Any

from dynaviz.errors import DataError
from dynaviz.io.atomic import opened

_HINT = "Copy the file again"
_CHUNK = 1 << 20  # bytes
_LONGEST = 8 * _CHUNK  # characters of a record; what is longer is damaged
_BLANK = " \t\r\n"


def read_records(path: str | os.PathLike[str]) -> Iterator[dict[str, Any]]:
    """Read the records of a table in their order.

    Raises:
        DataError: for a file that cannot be read, is cut, or is no list of records; it names the record.
    """
    with opened(path, _HINT) as file:
        text = _Text(file)
        number = 0
        try:
            text.expect("[")
            while text.next() != "]":
                if number:
                    text.expect(",")
                record = text.value()
                if not isinstance(record, dict):
                    raise ValueError("it is no record")
                yield record
                number += 1
        except (ValueError, RecursionError) as error:
            problem = f"is no whole list of records ({str(error)[:80]})"
            raise DataError(path, problem, at=f"record {number}", hint=_HINT) from None


class _Text:
    """The characters of a file that are not used yet, as far as they were read."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self._ahead, self._at = file, "", 0
        self._decode, self._json = codecs.getincrementaldecoder("utf-8")(), json.JSONDecoder()

    def next(self) -> str:
        """The next character that is not blank, which stays where it is."""
        while True:
            while self._at < len(self._ahead) and self._ahead[self._at] in _BLANK:
                self._at += 1
            if self._at < len(self._ahead):
                return self._ahead[self._at]
            if not self._more():
                raise ValueError("it ends too early")

    def expect(self, character: str) -> None:
        """Step over a character."""
        if self.next() != character:
            raise ValueError(f"there is {self.next()!r} where {character!r} should be")
        self._at += 1

    def value(self) -> Any:
        """Step over a value, and give it."""
        self.next()
        while True:
            try:
                found, self._at = self._json.raw_decode(self._ahead, self._at)
                return found
            except json.JSONDecodeError:
                if len(self._ahead) - self._at > _LONGEST or not self._more():
                    raise

    def _more(self) -> bool:
        """Read on, unless the file is at its end."""
        content = self._file.read(_CHUNK)
        self._ahead, self._at = self._ahead[self._at :] + self._decode.decode(content, final=not content), 0
        return bool(content)
