"""The costliest failure cases over all methods of a sequence.

Cases of several methods at one place are one spot.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.sections import RemovedCluster
from dynaviz_eval.report.boards import ScoreBoard, ScoreRow, best_of_each_method
from dynaviz_eval.report.errors import TINY
from dynaviz_eval.report.table import ABSENT, Column, Table, Value

MOST = 8  # spots of a sequence
ALIKE = 2  # spots of one kind and class that did the same, or one long road would fill the list
OVERLAP = 0.5  # share of the smaller box, above which two boxes are at one place
PAD = 0.25  # metres around a box, so that flat ones have a volume
HEADINGS = {"false_negative": "Ghost", "false_positive": "Hole", "removed": "Removed"}


@dataclass(frozen=True)
class Spot:
    """What one method did at one place.

    Attributes:
        label: of the method.
        kind: ``false_negative``, ``false_positive``, or ``removed`` without ground truth.
        what, cause, sentence: in words; sentence: a description for the reader.
        weight: how much it matters: percentage points, or suspicion times points.
        size: percentage points or removed points, as text; unit: the unit of ``size``.
        low, high: corners, (3,) metres, world frame.
        thing: class and instance of the ground truth, or None.
        behaviour: what the object or place did, the same for all methods; empty if unknown.
        number: of the case in the method's own list, 1 for the first.
    """

    label: str
    kind: str
    what: str
    cause: str
    sentence: str
    weight: float
    size: str
    unit: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    thing: tuple[int | None, int | None]
    behaviour: str = ""
    number: int = 0

    @classmethod
    def of_case(cls, label: str, case: FailureCase, number: int) -> Spot:
        """From a failure case."""
        size = f"{case.cost:.2f}" if case.cost >= TINY else "<0.01"
        unit = f"{case.metric} lost"
        thing = case.class_, case.instance
        cause = case.cause or next(iter(case.reasons), "")
        return cls(
            label, case.kind, case.what, cause, case.sentence, case.cost, size, unit, case.low,
            case.high, thing,
            case.behaviour or "", number,
        )  # fmt: skip

    @classmethod
    def of_cluster(cls, label: str, cluster: RemovedCluster, number: int) -> Spot:
        """From removed points of a run without ground truth."""
        cause = ", ".join(cluster.why[:1]) or next(iter(cluster.reasons), "")
        weight = cluster.suspicion * cluster.points
        return cls(
            label, "removed", cluster.what, cause, cluster.sentence, weight, f"{cluster.points:,}",
            "points removed",
            cluster.low, cluster.high, (None, None), number=number,
        )  # fmt: skip

    @property
    def verdict(self) -> str:
        """Size and unit."""
        return f"{self.size} {self.unit}"

    def same_place(self, other: Spot) -> bool:
        """Whether two spots are of one object, or of overlapping boxes of one kind and class."""
        if self.kind != other.kind or self.thing != other.thing:
            return False
        if self.thing[1] is not None:
            return True
        boxes = [
            np.array([spot.low, spot.high]) + np.array([[-PAD], [PAD]]) for spot in (self, other)
        ]
        shared = np.minimum(boxes[0][1], boxes[1][1]) - np.maximum(boxes[0][0], boxes[1][0])
        smaller = min(float(np.prod(box[1] - box[0])) for box in boxes)
        return float(np.prod(np.maximum(shared, 0))) > OVERLAP * smaller


@dataclass(frozen=True)
class SharedCase:
    """A place at which methods fail.

    The costliest spot, and each method's own spots there, by label.
    """

    number: int
    worst: Spot
    by: Mapping[str, Sequence[Spot]]

    @property
    def heading(self) -> str:
        """Kind, what it is, and how many methods fail."""
        what = (
            f"{self.worst.what} {self.worst.thing[1]}" if self.worst.thing[1] else self.worst.what
        )
        return f"{HEADINGS[self.worst.kind]}: {what}" if what else HEADINGS[self.worst.kind]

    @property
    def title(self) -> str:
        """The heading, and what the object did.

        The part of a diagnosis that no method can change.
        """
        return ", ".join(part for part in (self.heading, self.worst.behaviour) if part)

    def spot(self, label: str) -> Spot | None:
        """The largest of a method's spots there; None if it has none."""
        return max(self.by.get(label, ()), key=lambda spot: spot.weight, default=None)


def shared_cases(board: ScoreBoard, most: int = MOST) -> list[SharedCase]:
    """The places that cost most, as many ghosts as holes if there are enough of both.

    Costliest first.
    """
    groups: list[list[Spot]] = []
    for spot in sorted(_spots(best_of_each_method(board)), key=lambda spot: -spot.weight):
        home = next((group for group in groups if group[0].same_place(spot)), None)
        if home is None:
            groups.append([spot])
        else:
            home.append(spot)
    chosen = sorted(_chosen(groups, most), key=lambda group: (group[0].kind, -group[0].weight))
    cases = []
    for number, group in enumerate(chosen, 1):
        by: dict[str, list[Spot]] = {}
        for spot in group:
            by.setdefault(spot.label, []).append(spot)
        cases.append(SharedCase(number, group[0], by))
    return cases


def _spots(rows: Iterable[ScoreRow]) -> list[Spot]:
    spots = []
    for row in rows:
        spots += [
            Spot.of_case(row.label, case, number)
            for number, case in enumerate(row.result.failures, 1)
        ]
        if not row.result.has_truth:
            clusters = enumerate(row.result.clusters, 1)
            spots += [
                Spot.of_cluster(row.label, cluster, number)
                for number, cluster in clusters
                if cluster.why
            ]
    return [spot for spot in spots if len(spot.low) == len(spot.high) == 3]


def _chosen(groups: Sequence[list[Spot]], most: int) -> list[list[Spot]]:
    """Half ghosts and half holes, at most ``ALIKE`` of a kind and class that did the same.

    Then whatever costs most.
    """
    alike: Counter[tuple[str, str, str]] = Counter()
    varied: list[list[Spot]] = []
    for group in groups:
        key = group[0].kind, group[0].what, group[0].behaviour or group[0].cause
        alike[key] += 1
        if alike[key] <= ALIKE:
            varied.append(group)
    kinds = {group[0].kind for group in varied}
    first = [
        g
        for kind in kinds
        for g in [v for v in varied if v[0].kind == kind][: most // max(len(kinds), 1)]
    ]
    rest = [group for group in (*varied, *groups) if group not in first]
    for group in rest:
        if len(first) < most and group not in first:
            first.append(group)
    return first


def case_table(board: ScoreBoard, cases: Sequence[SharedCase], number: int) -> Table:
    """One row per place: what it is, the sentence of the method that fails most, and each method's
    cost.
    """
    labels = [row.label for row in best_of_each_method(board)]
    known = board.has_truth
    group = "DA (ghosts) or SA (holes) lost [%]" if known else "removed points"
    columns = [Column("case", number=False), *(Column(label, group) for label in labels)]
    rows = []
    for case in cases:
        row = [
            Value(f"{case.number}. {case.heading}", float(case.number), detail=case.worst.sentence)
        ]
        for label in labels:
            spot = case.spot(label)
            row.append(Value(spot.size, spot.weight, detail=spot.cause) if spot else Value(ABSENT))
        rows.append(row)
    title = f"{'Costliest cases' if known else 'Suspicious clusters'}: {board.title}"
    details = (
        "The description is about the method with the largest number; next to each number is the "
        "cause."
    )
    return Table(f"cases-{number}", title, columns, rows, [note(known)], details)


def note(known: bool) -> str:
    """Explain a list of cases."""
    if known:
        return (
            "The costliest failure cases over all methods, ghosts and holes apart; cases of "
            "several methods at one "
            "place are one row. Numbers: percentage points of DA or SA lost to a method's largest "
            "case there; "
            f"{ABSENT}: the method lists no case there."
        )
    return (
        "Removed points that look like static surfaces, the most suspicious first. There is no "
        "ground truth, so they "
        f"may be right. {ABSENT}: the method lists no cluster there."
    )
