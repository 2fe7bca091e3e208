"""The cards of the explorer.

Each case of a run with its numbers, its wrong points by frame, and a thumbnail.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from dynaviz.arrays import F64, I64, Bool, Intp
from dynaviz.contracts.scan import ERRORS, Outcome
from dynaviz.explain.point_ledger import PointLedger
from dynaviz.explain.rays import evenly
from dynaviz.explorer.run import ExploredRun
from dynaviz.reviews.regions import Corner
from dynaviz.scores.case_points import inside
from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.sections import RemovedCluster
from dynaviz.views.cases import middle_of, title_of
from dynaviz.views.read.still import Still, with_map

BARS = 40  # of a sparkline, at most
MARGIN = 0.02  # metres around the box of a case, whose corners are rounded
MAP_MARGIN = 1.0  # metres around this box that the map of a case shows
MAP_POINTS = 600  # of each outcome in this map
BOTH = 0.5  # share of a case's points that the other run gets wrong, too, from which both are wrong
KINDS = {
    Outcome.FALSE_NEGATIVE: "ghost",
    Outcome.FALSE_POSITIVE: "hole",
    Outcome.UNLABELLED_REMOVED: "removed",
}


@dataclass(frozen=True, slots=True, eq=False)
class Card:
    """A case of a run.

    Attributes:
        number: 1 for the first.
        case: of the result.
        outcome: of its points.
        rows: (K,) its points in the run's ``wrong``.
        low, high: (3,) float64, metres, world frame: its box in its worst frame.
        point: row in the scan of its worst frame: a wrong point in the middle of it, of those with
            stored evidence if there are any; None if none was drawn.
    """

    number: int
    case: FailureCase | RemovedCluster
    outcome: Outcome
    rows: I64
    low: F64
    high: F64
    point: int | None

    @property
    def failure(self) -> FailureCase | None:
        """The case, with ground truth."""
        return self.case if isinstance(self.case, FailureCase) else None

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        title = title_of(self.case)
        return title[:1].upper() + title[1:]


def cards(run: ExploredRun) -> list[Card]:
    """The cases of a run: failures, costliest first, or without ground truth clusters, most
    suspicious first.
    """
    failures = run.result.failures
    rows = _rows(run, failures) if failures else _rows_in(run, run.result.clusters)
    cases: Sequence[FailureCase | RemovedCluster] = failures or run.result.clusters
    return [_card(run, number, case, rows[number]) for number, case in enumerate(cases, 1)]


def _rows(run: ExploredRun, failures: Sequence[FailureCase]) -> dict[int, Intp]:
    """By number of the cases, their rows in the run's ``wrong``."""
    wrong = run.wrong
    found: dict[int, Intp] = {}
    for kind in dict.fromkeys(case.kind for case in failures):
        of_kind = np.flatnonzero(wrong.outcome == ERRORS[kind])
        points = run.recording.case_points
        owners = points.owners(kind, wrong.frame[of_kind], wrong.xyz[of_kind])
        for number, case in enumerate(failures, 1):
            if case.kind == kind:
                found[number] = of_kind[owners == number]
    return found


def _rows_in(run: ExploredRun, clusters: Sequence[RemovedCluster]) -> dict[int, Intp]:
    """As ``_rows``, for clusters, which may share points."""
    wrong = run.wrong
    removed = np.flatnonzero(wrong.outcome == Outcome.UNLABELLED_REMOVED)
    rows = inside(dict(enumerate(clusters, 1)), wrong.frame[removed], wrong.xyz[removed])
    return {number: removed[of] for number, of in rows.items()}


def _card(run: ExploredRun, number: int, case: FailureCase | RemovedCluster, rows: Intp) -> Card:
    """A card, given its rows in the run's ``wrong``."""
    outcome = ERRORS[case.kind] if isinstance(case, FailureCase) else Outcome.UNLABELLED_REMOVED
    wrong = run.wrong
    low = np.array(case.low)
    high = np.array(case.high)
    worst = rows[wrong.frame[rows] == case.worst_frame]
    if not len(worst):
        return Card(number, case, outcome, rows, low, high, None)
    xyz = wrong.xyz[worst].astype(np.float64)
    points = wrong.point[worst]
    explained = np.isin(points, run.recording.explained(number))
    asked = np.flatnonzero(explained) if explained.any() else np.arange(len(points))
    return Card(
        number,
        case,
        outcome,
        rows,
        xyz.min(0),
        xyz.max(0),
        int(points[asked[middle_of(xyz[asked])]]),
    )


def pairs(run: ExploredRun, mine: Sequence[Card], others: Sequence[Card]) -> dict[int, int]:
    """Cards of another run on the same objects, or on the same places with the same errors, by
    number of the card.
    """
    found: dict[int, int] = {}
    for card in mine:
        left = [other for other in others if other.number not in found.values()]
        if (number := _same(run, card, left)) is not None:
            found[card.number] = number
    return found


def _same(run: ExploredRun, card: Card, others: Sequence[Card]) -> int | None:
    case = card.case
    wrong = run.wrong.xyz[card.rows[run.wrong.frame[card.rows] == case.worst_frame]]
    best = None
    most = BOTH * len(wrong)
    for number, other in (
        (other.number, other.case) for other in others if other.outcome == card.outcome
    ):
        if (
            isinstance(case, FailureCase)
            and isinstance(other, FailureCase)
            and case.instance
            and other.instance
        ):
            if (case.class_, case.instance) == (other.class_, other.instance):
                return number
        elif other.first_frame <= case.worst_frame <= other.last_frame:
            inside = (wrong >= np.array(other.low) - MARGIN) & (
                wrong <= np.array(other.high) + MARGIN
            )
            if (count := int(inside.all(1).sum())) > most:
                best = number
                most = count
    return best


def plain(
    run: ExploredRun, card: Card, shared: Mapping[str, Bool], same: Mapping[str, Mapping[int, int]]
) -> dict[str, Any]:
    """A card in plain types, as the page receives it.

    Args:
        run: of the case.
        card: the case.
        shared: by letter of the other runs, as for ``wrong_in``.
        same: by letter of the other runs, as ``pairs`` returns it.
    """
    case = card.case
    failure = card.failure
    cluster = case if isinstance(case, RemovedCluster) else None
    return {
        "number": card.number,
        "title": card.title,
        "kind": KINDS[card.outcome],
        "cost": failure.cost if failure else None,
        "metric": failure.metric if failure else None,
        "suspicion": cluster.suspicion if cluster and cluster.did == "removed" else None,
        "points": case.points,
        "first": case.first_frame,
        "last": case.last_frame,
        "worst": case.worst_frame,
        "range": case.range.mean,
        "reasons": dict(case.reasons),
        "cause": _cause(case),
        "behaviour": failure.behaviour if failure else None,
        "what": case.what,
        "object": f"{case.what} {failure.instance}" if failure and failure.instance else None,
        "sentence": case.sentence,
        "low": list(case.low),
        "high": list(case.high),
        "point": card.point,
        "spark": spark(run, card),
        "wrong": wrong_in(run, card, shared),
        "same": {letter: of[card.number] for letter, of in same.items() if card.number in of},
        "spans": dict(failure.spans) if failure else {},
    }


def _cause(case: FailureCase | RemovedCluster) -> str | None:
    """The cause of a failure, or what makes a cluster most suspicious."""
    return case.cause if isinstance(case, FailureCase) else ", ".join(case.why[:2]) or None


def spark(run: ExploredRun, card: Card) -> list[int]:
    """Wrong points over all frames of the run, in at most ``BARS`` bins."""
    bins = min(run.frames, BARS)
    where = run.wrong.frame[card.rows] * bins // max(run.frames, 1)
    counts: list[int] = (
        np.bincount(where, run.wrong.stands_for[card.rows], bins).astype(int).tolist()
    )
    return counts


def boxes(run: ExploredRun, card: Card) -> list[tuple[int, Corner, Corner]]:
    """The box around the wrong points of a case in each of its frames.

    Frame, low and high corner in metres.
    """
    found = []
    for frame in np.unique(run.wrong.frame[card.rows]).tolist():
        xyz = run.wrong.xyz[card.rows[run.wrong.frame[card.rows] == frame]].astype(float)
        found.append((frame, tuple(xyz.min(0).tolist()), tuple(xyz.max(0).tolist())))
    return found


def wrong_in(run: ExploredRun, card: Card, shared: Mapping[str, Bool]) -> list[str]:
    """Letters of the other runs that get most points of a case wrong, too.

    Args:
        run: of the case.
        card: the case.
        shared: by letter, for each of the run's ``wrong`` points, whether that run is wrong there,
            too.
    """
    weights = run.wrong.stands_for[card.rows]
    half = BOTH * weights.sum()
    return [
        letter
        for letter, wrong in shared.items()
        if len(weights) and weights[wrong[card.rows]].sum() >= half
    ]


def surroundings(run: ExploredRun, card: Card, ledgers: Sequence[PointLedger]) -> dict[str, Any]:
    """The map on which the page draws a case in its worst frame, in plain types.

    Args:
        run: of the case.
        card: the case.
        ledgers: stored on its points.

    Returns:
        Coordinates are metres, along the axes of the world frame, from the lowest corner of the
        map: its ``size``, the drawn ``points`` of the case with their ``outcome``, those ``around``
        it by outcome, and those with ``evidence``, each after its row in the scan.
    """
    low = card.low - MAP_MARGIN
    high = card.high + MAP_MARGIN
    mine = run.wrong.xyz[card.rows[run.wrong.frame[card.rows] == card.case.worst_frame]]
    xyz, outcome = with_map(run.map, run.drawn(card.case.worst_frame))
    inside = ((xyz >= low) & (xyz <= high)).all(1)
    around = {each.name.lower(): xyz[inside & (outcome == each)] for each in Outcome}
    return {
        "size": (high - low).round(2).tolist(),
        "outcome": card.outcome.name.lower(),
        "points": (mine - low).round(2).tolist(),
        "around": {
            name: (of[evenly(len(of), MAP_POINTS)] - low).round(2).tolist()
            for name, of in around.items()
        },
        "evidence": [
            [ledger.point, *(np.array(ledger.position) - low).round(2).tolist()]
            for ledger in ledgers
        ],
    }


def picture(
    run: ExploredRun,
    card: Card,
    size: tuple[int, int],
    place: tuple[int, F64, F64] | None = None,
    kind: Literal[".png", ".webp"] = ".png",
) -> bytes:
    """A picture of the case in a frame, as the first view of its layout shows it.

    The wrong points on top.

    Args:
        run: of the case.
        card: the case.
        size: width and height, pixels.
        place: a frame, and the low and high corner of the box at which the eye looks, (3,) metres,
            world frame; None for its worst frame.
        kind: PNG, or WebP without loss.
    """
    import cv2

    frame, low, high = place or (card.case.worst_frame, card.low, card.high)
    xyz, outcome = with_map(run.map, run.drawn(frame))
    still = Still(low, high, size)
    still.draw(xyz, outcome, card.outcome)
    lossless = [cv2.IMWRITE_WEBP_QUALITY, 101] if kind == ".webp" else []
    return cv2.imencode(kind, still.pixels[:, :, ::-1], lossless)[1].tobytes()
