"""The costliest failure cases over all methods of a sequence. Cases of several methods at one place are one spot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.results.sections import FailureCase, RemovedCluster
from dynaviz_eval.report.boards import ScoreBoard, ScoreRow, best_of_each_method
from dynaviz_eval.report.errors import TINY
from dynaviz_eval.report.table import ABSENT, Column, Table, Value

MOST = 8  # spots of a sequence
ALIKE = 2  # spots of one kind, class and cause, or one long road would fill the list
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
        verdict: the same for the reader.
        low, high: corners, (3,) metres, world frame.
        thing: class and instance of the ground truth, or None.
    """

    label: str
    kind: str
    what: str
    cause: str
    sentence: str
    weight: float
    verdict: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    thing: tuple[int | None, int | None]

    @classmethod
    def of_case(cls, label: str, case: FailureCase) -> Spot:
        """From a failure case."""
        verdict = f"−{case.cost:.2f} {case.metric}" if case.cost >= TINY else f"under 0.01 {case.metric}"
        thing = case.class_, case.instance
        cause = case.cause or next(iter(case.reasons), "")
        return cls(
            label, case.kind, case.what, cause, case.sentence, case.cost, verdict, case.low, case.high, thing
        )  # fmt: skip

    @classmethod
    def of_cluster(cls, label: str, cluster: RemovedCluster) -> Spot:
        """From removed points of a run without ground truth."""
        verdict, cause = f"{cluster.points:,} removed", ", ".join(cluster.why[:1]) or next(iter(cluster.reasons), "")
        weight = cluster.suspicion * cluster.points
        return cls(
            label, "removed", cluster.what, cause, cluster.sentence, weight, verdict, cluster.low, cluster.high,
            (None, None),
        )  # fmt: skip

    def same_place(self, other: Spot) -> bool:
        """Whether two spots are of one object, or of overlapping boxes of one kind and class."""
        if self.kind != other.kind or self.thing != other.thing:
            return False
        if self.thing[1] is not None:
            return True
        boxes = [np.array([spot.low, spot.high]) + np.array([[-PAD], [PAD]]) for spot in (self, other)]
        shared = np.minimum(boxes[0][1], boxes[1][1]) - np.maximum(boxes[0][0], boxes[1][0])
        smaller = min(float(np.prod(box[1] - box[0])) for box in boxes)
        return float(np.prod(np.maximum(shared, 0))) > OVERLAP * smaller


@dataclass(frozen=True)
class SharedCase:
    """A place at which methods fail: the costliest spot, and each method's own spots there, by label."""

    number: int
    worst: Spot
    by: Mapping[str, Sequence[Spot]]

    @property
    def heading(self) -> str:
        """Kind, what it is, and how many methods fail."""
        what = f"{self.worst.what} {self.worst.thing[1]}" if self.worst.thing[1] else self.worst.what
        return f"{HEADINGS[self.worst.kind]}: {what}" if what else HEADINGS[self.worst.kind]

    def verdict(self, label: str) -> tuple[str, str]:
        """What a method did there: its largest cost, and the cause; empty if it has no case there."""
        spots = self.by.get(label, ())
        if not spots:
            return "", ""
        worst = max(spots, key=lambda spot: spot.weight)
        return worst.verdict, worst.cause


def shared_cases(board: ScoreBoard, most: int = MOST) -> list[SharedCase]:
    """The places that cost most, as many ghosts as holes if there are enough of both; costliest first."""
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
        spots += [Spot.of_case(row.label, case) for case in row.result.failures]
        if not row.result.has_truth:
            spots += [Spot.of_cluster(row.label, cluster) for cluster in row.result.clusters]
    return [spot for spot in spots if len(spot.low) == len(spot.high) == 3]


def _chosen(groups: Sequence[list[Spot]], most: int) -> list[list[Spot]]:
    """Half ghosts and half holes, at most ``ALIKE`` of one kind, class and cause; then whatever costs most."""
    alike: Counter[tuple[str, str, str]] = Counter()
    varied: list[list[Spot]] = []
    for group in groups:
        key = group[0].kind, group[0].what, group[0].cause
        alike[key] += 1
        if alike[key] <= ALIKE:
            varied.append(group)
    kinds = {group[0].kind for group in varied}
    first = [g for kind in kinds for g in [v for v in varied if v[0].kind == kind][: most // max(len(kinds), 1)]]
    rest = [group for group in (*varied, *groups) if group not in first]
    for group in rest:
        if len(first) < most and group not in first:
            first.append(group)
    return first


def case_table(board: ScoreBoard, cases: Sequence[SharedCase], number: int) -> Table:
    """One row per place: what it is, the sentence of the method that fails most, and each method's cost."""
    labels = [row.label for row in best_of_each_method(board)]
    known = board.has_truth
    columns = [Column("case", number=False), *(Column(label, "lost [%]" if known else "removed") for label in labels)]
    rows = []
    for case in cases:
        row = [Value(f"{case.number}. {case.heading}", float(case.number), detail=case.worst.sentence)]
        for label in labels:
            verdict, cause = case.verdict(label)
            row.append(Value(verdict, detail=cause) if verdict else Value(ABSENT))
        rows.append(row)
    title = f"{'Costliest cases' if known else 'Suspicious clusters'}: {board.title}"
    return Table(f"cases-{number}", title, columns, rows, [note(known)])


def note(known: bool) -> str:
    """Explain a list of cases."""
    if known:
        return (
            "The costliest failure cases over all methods, ghosts and holes apart; cases of several methods at one "
            "place are one row. The sentence is that of the method that loses most. Numbers: percentage points of DA "
            f"or SA lost to a method's largest case there; {ABSENT}: the method lists no case there."
        )
    return (
        "Removed points that look like static surfaces, the most suspicious first. There is no ground truth, so they "
        f"may be right. {ABSENT}: the method lists no cluster there."
    )
