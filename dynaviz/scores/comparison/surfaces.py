"""Static surfaces from which two runs removed different numbers of points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dynaviz.scores.comparison.objects import LEAST
from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.result import Result

OVERLAP = 0.5  # share of the smaller box, above which two cases are of one surface
PAD = 0.25  # metres around a box, so that flat ones have a volume


@dataclass(frozen=True, slots=True)
class SurfaceChange:
    """A static surface of which the runs removed different numbers of points.

    Attributes:
        what: it is, in words.
        low, high: corners, (3,) metres, world frame: of the costliest case on it.
        first_frame, last_frame: of this case.
        gain_SA: percentage points of SA in listed cases, positive where the second run lost fewer.
        first, second: what each run did.
    """

    what: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    first_frame: int
    last_frame: int
    gain_SA: float
    first: SurfaceFate
    second: SurfaceFate


@dataclass(frozen=True, slots=True)
class SurfaceFate:
    """What a run did to a surface.

    Attributes:
        lost: percentage points of SA in its listed cases there.
        case: number of the costliest of these, 1 for the first; None if none is listed.
        cause: why it is wrong.
    """

    lost: float
    case: int | None = None
    cause: str | None = None


def surface_changes(first: Result, second: Result) -> tuple[SurfaceChange, ...]:
    """The surfaces on which listed cases of removed points differ between two runs.

    Those that change SA most come first. A case belongs to the costliest one whose class it has,
    and with whose box it shares more than half of the smaller box.
    """
    cases = sorted(_removed(first, second), key=_order)  # of one pair, in both directions
    surfaces: list[list[tuple[int, int, FailureCase]]] = []
    for each in cases:
        home = next((of for of in surfaces if _is_one(of[0][2], each[2])), None)
        if home is None:
            surfaces.append([each])
        else:
            home.append(each)
    found = []
    for of in surfaces:
        worst = of[0][2]
        fates = [_fate([each for each in of if each[0] == run]) for run in (0, 1)]
        gain = fates[0].lost - fates[1].lost
        if abs(gain) >= LEAST:
            found.append(
                SurfaceChange(
                    worst.what, worst.low, worst.high, worst.first_frame, worst.last_frame, gain,
                    *fates,
                )
            )  # fmt: skip
    found.sort(key=lambda each: (-abs(each.gain_SA), each.first_frame, each.low))
    return tuple(found)


def _removed(*results: Result) -> Iterator[tuple[int, int, FailureCase]]:
    """Run, number and case of the cases of removed points."""
    for run, result in enumerate(results):
        for number, case in enumerate(result.failures, 1):
            if case.kind == "false_positive":
                yield run, number, case


def _order(each: tuple[int, int, FailureCase]) -> tuple[float, tuple[float, ...], int]:
    _, number, case = each
    return -case.cost, case.low, number


def _is_one(case: FailureCase, other: FailureCase) -> bool:
    """Whether two cases are of one surface."""
    if (case.class_, case.instance) != (other.class_, other.instance):
        return False
    lows = np.array([case.low, other.low]) - PAD
    highs = np.array([case.high, other.high]) + PAD
    shared = np.maximum(highs.min(0) - lows.max(0), 0.0)
    return float(shared.prod()) > OVERLAP * float((highs - lows).prod(1).min())


def _fate(cases: list[tuple[int, int, FailureCase]]) -> SurfaceFate:
    if not cases:
        return SurfaceFate(0.0)
    _, number, worst = cases[0]
    return SurfaceFate(sum(case.cost for *_, case in cases), number, worst.cause)
