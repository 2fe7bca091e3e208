"""The entries of a board, and ``board.json``."""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from dynaviz.contracts.protocol import ProtocolScores
from dynaviz.errors import DataError
from dynaviz.io.atomic import write_atomic
from dynaviz.io.plain_json import read_json
from dynaviz.scores.collect import StudyRun
from dynaviz.scores.result import Result
from dynaviz.scores.sections import SequenceInfo

FILE = "board.json"
SCHEMA = 1
_HINT = "Write the board again"


class Entry(Struct, frozen=True):
    """One run on a board.

    Attributes:
        path: folder of the run, relative to the folder of all runs, with forward slashes.
        method, variant, online, scoring: as in ``Result``.
        sequence: name, digest, frames and points.
        parameters: of the method.
        labels_sha256, recording_sha256: digests, as in ``Result``.
        command: what the user typed.
        protocols: scores by name of the protocol; empty if they could not be computed.
        remark: why there are no scores; empty if there are.
    """

    path: str
    method: str
    sequence: SequenceInfo
    variant: str = ""
    online: bool = False
    scoring: str = "mask"
    parameters: Mapping[str, Any] = {}
    labels_sha256: str | None = None
    recording_sha256: str | None = None
    command: str = ""
    protocols: Mapping[str, ProtocolScores] = {}
    remark: str = ""

    @classmethod
    def of(cls, run: StudyRun, result: Result, folder: Path) -> Entry:
        """An entry without scores."""
        return cls(
            path=Path(os.path.relpath(run.folder, folder)).as_posix(),
            **{
                field: getattr(result, field)
                for field in cls.__struct_fields__
                if hasattr(result, field)
            },
        )

    @property
    def key(self) -> tuple[str | None, str, str]:
        """What the scores depend on: labels, points and ground truth, and scoring."""
        return self.labels_sha256, self.sequence.digest, self.scoring


class BoardFile(Struct, frozen=True):
    """The content of ``board.json``."""

    schema: int = SCHEMA
    dynaviz: str = ""
    entries: tuple[Entry, ...] = ()

    def entry(self, key: tuple[str | None, str, str]) -> Entry | None:
        """The first entry with these digests and scoring that has scores; None if there is none."""
        return next((entry for entry in self.entries if entry.key == key and entry.protocols), None)


def version() -> str:
    """The version of dynaviz, which defines the protocols."""
    return metadata.version("dynaviz")


def read_board(path: Path) -> BoardFile:
    """Read ``board.json``.

    Raises:
        DataError: if the file is not that of a board, or was written by a newer dynaviz.
    """
    plain = read_json(path, _HINT)
    if not isinstance(plain, dict) or "entries" not in plain:
        raise DataError(path, "is not the file of a board", hint=_HINT)
    try:
        board = msgspec.convert(plain, BoardFile)
    except msgspec.ValidationError as error:
        raise DataError(path, f"is not a valid board: {error}", hint=_HINT) from None
    if board.schema > SCHEMA:
        raise DataError(path, "was written by a newer dynaviz", hint="Upgrade dynaviz")
    return board


def save_board(path: Path, board: BoardFile) -> None:
    """Write ``board.json``, whole or not at all."""
    write_atomic(path, msgspec.json.format(msgspec.json.encode(board), indent=1) + b"\n")
