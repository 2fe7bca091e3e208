"""Moving objects of which two runs removed different shares."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.result import Result
from dynaviz.scores.scores import percentage_points_lost
from dynaviz.scores.sections import ObjectRow

LEAST = 0.005  # percentage points of DA: smaller changes would print as 0.00

_Key = tuple[int | None, int]  # class and number


@dataclass(frozen=True, slots=True)
class ObjectChange:
    """A moving object of which the runs removed different shares.

    Attributes:
        what: its class and its number.
        class_, instance: of the ground truth.
        first_frame, last_frame: in which it was seen.
        points: its dynamic points.
        gain_DA: percentage points of DA, positive where the second run removed more.
        first, second: what each run did.
    """

    what: str
    class_: int | None
    instance: int
    first_frame: int
    last_frame: int
    points: int
    gain_DA: float
    first: ObjectFate
    second: ObjectFate


@dataclass(frozen=True, slots=True)
class ObjectFate:
    """What a run did to an object.

    Attributes:
        removed: percent of its dynamic points.
        case: number of the failure case of those that it kept, 1 for the first; None if it is not
            listed.
        cause: why it kept them, and behaviour: what the object did in their frames; as in the case.
    """

    removed: float
    case: int | None = None
    cause: str | None = None
    behaviour: str | None = None


def object_changes(first: Result, second: Result) -> tuple[ObjectChange, ...]:
    """The objects with a number of which two runs on the same data removed different shares.

    Those that change DA most come first. Objects of which one run did not answer all points of the
    other are left out.
    """
    names = {**_names(second), **_names(first)}
    others = _rows(second)
    dynamic = first.counts.get("dynamic_removed", 0) + first.counts.get("dynamic_kept", 0)
    found = []
    for key, row in _rows(first).items():
        other = others.get(key)
        points = row.dynamic_removed + row.dynamic_kept
        if other is None or points != other.dynamic_removed + other.dynamic_kept or not points:
            continue
        more = other.dynamic_removed - row.dynamic_removed
        gain = float(percentage_points_lost(more, dynamic))
        if abs(gain) < LEAST:
            continue
        class_, number = key
        what = names.get(key, "moving object")
        found.append(
            ObjectChange(
                what if str(number) in what.split() else f"{what} {number}",
                class_, number, row.first_frame, row.last_frame, points, gain,
                _fate(first, row, key), _fate(second, other, key),
            )
        )  # fmt: skip
    found.sort(key=lambda each: (-abs(each.gain_DA), each.first_frame, each.instance))
    return tuple(found)


def _rows(result: Result) -> dict[_Key, ObjectRow]:
    breakdown = result.sections.breakdown
    rows = breakdown.object if breakdown else ()
    return {_key(row.class_, row.instance): row for row in rows if row.instance}


def _key(class_: int | None, instance: int) -> _Key:
    """Class and number; sequences without classes have class 0 in breakdowns, none in cases."""
    return class_ or None, instance


def _names(result: Result) -> dict[_Key, str]:
    """What objects are, from the ceiling and the failure cases."""
    ceiling = result.sections.ceiling
    objects = ceiling.objects if ceiling else ()
    known = {_key(each.class_, each.instance): each.what for each in objects if each.instance}
    cases = (case for _, case in _kept(result) if case.instance)
    return known | {_key(case.class_, case.instance or 0): case.what for case in cases}


def _kept(result: Result) -> Iterator[tuple[int, FailureCase]]:
    """The failure cases of kept points, and their numbers."""
    for number, case in enumerate(result.failures, 1):
        if case.kind == "false_negative":
            yield number, case


def _fate(result: Result, row: ObjectRow, key: _Key) -> ObjectFate:
    removed = 100.0 * row.dynamic_removed / (row.dynamic_removed + row.dynamic_kept)
    for number, case in _kept(result):
        if _key(case.class_, case.instance or 0) == key:
            return ObjectFate(removed, number, case.cause, case.behaviour)
    return ObjectFate(removed)
