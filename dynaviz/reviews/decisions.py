"""Decisions of a person, in a file to which entries are only added.

A decision states what a part of the world is: static or dynamic. It belongs to no run: each run of
each method that sees the same world follows it. Undoing one is an entry, too.
"""

from __future__ import annotations

import datetime
import os
import secrets
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from msgspec import Struct

from dynaviz.contracts.scan import TRUTH, Label
from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.io.lock import locked
from dynaviz.io.plain_json import read_json
from dynaviz.reviews.regions import (
    Clock,
    Corner,
    ObjectRegion,
    Piece,
    Region,
    Span,
    check_region,
)
from dynaviz.scores.labels import RunLabels

FILE = "review.json"
EARLIER = "corrections.json"
SCHEMA = 1
LOCK = ".dynaviz.review.lock"
DATED = 10**18  # nanoseconds since 1970: September 2001; smaller stamps count from any start
PATIENCE = 10.0  # seconds that another process may take to add its decision
Verdict = Literal["static", "dynamic", "undecided"]
VERDICTS: tuple[Verdict, ...] = ("static", "dynamic", "undecided")
LABELS = {word: Label(label) for label, word in TRUTH.items()}
_HINT = "Give a review.json, as the explorer and dynaviz.review write it; the file stays as it is"
CORRECTED = (
    0.02  # metres around the boxes of corrections, whose corners are those of rounded points
)


class Seen(Struct, frozen=True):
    """Where the sensor was at a time, by which another world frame is noticed.

    Attributes:
        clock, time: as in ``Span``.
        position: metres, world of the source.
        sequence: name of the sequence.
    """

    clock: Clock
    time: int
    position: Corner
    sequence: str = ""

    @property
    def dated(self) -> bool:
        """Whether the time is one of no other drive: a stamp of a clock with a date."""
        return self.clock == "stamp" and self.time > DATED


class ReviewDecision(Struct, frozen=True, tag="decision"):
    """What a part of the world is.

    Attributes:
        verdict: ``static``, ``dynamic`` or ``undecided``: a person looked, and cannot tell.
        region: the part; of several decisions on a point, the last one holds.
        span: when; None for the frames of an object, and for all times of other regions.
        id: of the decision, unique.
        made: when it was made, ISO 8601 with time zone.
        what: what it is about, in a few words.
        answered: what the answer was that it judges: ``kept``, ``removed``, or empty.
        by: the method and the sequence whose answer it was.
        key: of the question that it answers, as the explorer knows it.
        reviewer, reason: who decided, and why; may be empty.
        seen: where the sensor was.
        local: whether coordinates lack the offset of the world, as those of earlier versions do.
    """

    verdict: Verdict
    region: Region
    span: Span | None = None
    id: str = ""
    made: str = ""
    what: str = ""
    answered: str = ""
    by: str = ""
    key: str = ""
    reviewer: str = ""
    reason: str = ""
    seen: Seen | None = None
    local: bool = False

    @property
    def kind(self) -> str:
        """Of its region: ``object``, ``box`` or ``polygon``."""
        return str(self.region.__struct_config__.tag)

    @property
    def sentence(self) -> str:
        """The decision in one line."""
        what = self.what or self.kind
        was = f", which was {self.answered}" if self.answered else ""
        who = f" ({self.reviewer})" if self.reviewer else ""
        why = f": {self.reason}" if self.reason else ""
        return f"{self.verdict}: {what}{was}{who}{why}"


class Undo(Struct, frozen=True, tag="undo"):
    """Takes a decision back.

    Attributes:
        of: its id.
        made, reviewer: as for a decision.
    """

    of: str
    made: str = ""
    reviewer: str = ""


class ReviewFile(Struct, frozen=True):
    """The content of ``review.json``.

    Attributes:
        schema: of the file.
        entries: in the order in which they were made.
    """

    schema: int
    entries: tuple[ReviewDecision | Undo, ...]


class Decisions:
    """The decisions in a file, and all that was decided before.

    Args:
        path: the file, which need not exist; or a folder for ``review.json``, where the
            ``corrections.json`` of an earlier version is read, too.

    Raises:
        DataError: for a file that cannot be read, or is none of decisions.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        path = Path(path)
        self.path = path / FILE if path.is_dir() else path
        self.entries: tuple[ReviewDecision | Undo, ...] = _read(self.path)

    @classmethod
    def existing(cls, path: str | os.PathLike[str]) -> Decisions:
        """The decisions in a file that must exist.

        Raises:
            DataError: as for the class, or without a file.
        """
        found = cls(path)
        if not found.path.is_file() and not found.entries:
            raise DataError(found.path, "does not exist", hint=_HINT)
        return found

    @property
    def standing(self) -> tuple[ReviewDecision, ...]:
        """The decisions that were not undone, in order."""
        return standing(self.entries)

    def add(self, decision: ReviewDecision) -> ReviewDecision:
        """Add a decision to the file, which may have been written by others meanwhile.

        Returns:
            The decision with its id and time.

        Raises:
            UsageError: for a region that is empty, or values of other types.
            DataError: if the file is damaged or cannot be written.
        """
        found = msgspec.structs.replace(
            decision, id=decision.id or secrets.token_hex(6), made=decision.made or now()
        )
        try:
            found = msgspec.convert(
                msgspec.to_builtins(found, enc_hook=_plain_number), ReviewDecision
            )
            check_region(found.region)
        except (msgspec.ValidationError, ValueError, TypeError) as error:
            raise UsageError(f"decision: {error}") from None
        self._append(found)
        return found

    def undo(self, id_: str | None = None, reviewer: str = "") -> ReviewDecision:
        """Take a decision back: the last one that holds, or one by its id.

        Returns:
            The decision.

        Raises:
            UsageError: if there is none.
            DataError: as ``add``.
        """
        held = self.standing
        found = [each for each in held if id_ is None or each.id == id_]
        if not found:
            what = "no decision" if id_ is None else f"no decision {id_}"
            raise UsageError(f"{self.path}: contains {what} to undo")
        self._append(Undo(found[-1].id, now(), reviewer))
        return found[-1]

    def _append(self, entry: ReviewDecision | Undo) -> None:
        end = time.monotonic() + PATIENCE
        while True:
            try:
                with locked(self.path.parent, "dynaviz review", LOCK):
                    entries = (*_read(self.path), entry)
                    _write(self.path, entries)
                break
            except DataError as error:
                if "is writing into this folder" not in error.problem or time.monotonic() > end:
                    raise
                time.sleep(0.02)
        self.entries = entries


def _plain_number(value: object) -> object:
    """A number or an array of NumPy as one of Python."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{value!r} is no number")


def case_key(digest: str, number: int) -> str:
    """The key of the question whether the ground truth of a case is right.

    Args:
        digest: of the run's sequence.
        number: of the case in the run's list.
    """
    return f"case {number} on {digest[:12]}"


def standing(entries: Iterable[ReviewDecision | Undo]) -> tuple[ReviewDecision, ...]:
    """The decisions that were not undone, in order."""
    entries = tuple(entries)
    undone = {each.of for each in entries if isinstance(each, Undo)}
    return tuple(
        each for each in entries if isinstance(each, ReviewDecision) and each.id not in undone
    )


def now() -> str:
    """The time, ISO 8601 in UTC."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")


def _write(path: Path, entries: tuple[ReviewDecision | Undo, ...]) -> None:
    plain = msgspec.json.encode(ReviewFile(SCHEMA, entries))
    write_atomic(path, msgspec.json.format(plain, indent=1) + b"\n")


def _read(path: Path) -> tuple[ReviewDecision | Undo, ...]:
    """The entries of a file; those of corrections next to it if it does not exist."""
    earlier = path.with_name(EARLIER)
    if path.name == FILE and not path.is_file():
        return _corrections(earlier) if earlier.is_file() else ()
    if not path.is_file():
        return ()
    plain = read_json(path, _HINT)
    if isinstance(plain, dict) and "corrections" in plain:
        return _corrections(path)
    if not isinstance(plain, dict) or "entries" not in plain:
        raise DataError(path, "is not a file of decisions", hint=_HINT)
    schema = plain.get("schema")
    if isinstance(schema, int) and schema > SCHEMA:
        raise DataError(path, "was written by a newer dynaviz", hint="Upgrade dynaviz")
    try:
        found = msgspec.convert(plain, ReviewFile).entries
        for entry in found:
            if isinstance(entry, ReviewDecision):
                check_region(entry.region)
    except (msgspec.ValidationError, ValueError) as error:
        raise DataError(path, f"is not a file of decisions: {error}", hint=_HINT) from None
    return found


class _Box(Struct, frozen=True):
    frame: int
    low: Corner
    high: Corner


class _Correction(Struct, frozen=True):
    case: int
    what: str
    truth: Literal["static", "dynamic"]
    boxes: tuple[_Box, ...]


class _Corrections(Struct, frozen=True):
    sequence: str
    corrections: tuple[_Correction, ...] = ()
    schema: int = 1


def _corrections(path: Path) -> tuple[ReviewDecision, ...]:
    """The corrections of ground truth of an earlier version, as decisions.

    Their frames are positions in the run in whose folder they are.
    """
    try:
        found = msgspec.convert(read_json(path, _HINT), _Corrections)
    except msgspec.ValidationError as error:
        raise DataError(path, f"is not a file of corrections: {error}", hint=_HINT) from None
    if found.schema > 1:
        raise DataError(path, "was written by a newer dynaviz", hint="Upgrade dynaviz")
    labels = path.with_name("labels.npz")
    if not labels.is_file():
        hint = "Move it back into the folder of its run"
        raise DataError(path, "lies in no folder of a run, whose frames it counts", hint=hint)
    run = RunLabels.load(labels)
    if run.sequence_digest != found.sequence:
        raise DataError(path, "is for a different sequence than the run", hint=_HINT)
    frames = run.frames
    decisions = []
    for each in found.corrections:
        boxes = [box for box in each.boxes if 0 <= box.frame < len(frames)]
        order = np.argsort([frames[box.frame] for box in boxes], kind="stable")
        pieces = tuple(
            Piece(int(frames[boxes[k].frame]), boxes[k].low, boxes[k].high) for k in order
        )
        if pieces:
            region = ObjectRegion("frame", pieces, margin=CORRECTED)
            decisions.append(
                ReviewDecision(
                    each.truth, region, id=f"case-{each.case}", what=each.what, local=True,
                    key=case_key(found.sequence, each.case),
                    reason="correction of the ground truth",
                )
            )  # fmt: skip
    return tuple(decisions)
