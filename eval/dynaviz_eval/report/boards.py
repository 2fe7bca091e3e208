"""Results that compare, put beside each other: the same points, scored in the same way."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dynaviz.reporting import Study
from dynaviz.results.collect import StudyRun, combined
from dynaviz.results.result import Result
from dynaviz.results.sections import Reasons, SequenceInfo

UNKNOWN = "unknown"  # the cause of what no method explains
SCORES = ("SA", "DA", "AA", "HA")
KINDS = {
    "false_positive": ("SA", "static_kept", "static_removed"),
    "false_negative": ("DA", "dynamic_removed", "dynamic_kept"),
}
"""Kinds of error: the score that they lower, and the counts of what is right and wrong of it."""


@dataclass(frozen=True)
class ScoreRow:
    """A run on a board; ``cell`` is None for several sequences together."""

    label: str
    result: Result
    cell: StudyRun | None = None

    def score(self, name: str) -> float | None:
        """A metric in percent; None where undefined."""
        return self.result.metrics.get(name)

    @property
    def rank(self) -> tuple[float, str]:
        """The best AA first, undefined ones last, equals by name."""
        aa = self.score("AA")
        return (math.inf if aa is None else -aa), self.label


@dataclass(frozen=True)
class ScoreBoard:
    """All runs that compare.

    Attributes:
        title: the sequence, and what sets it apart where another has its name.
        scoring: ``mask`` or ``nn``.
        rows: the best first; labels are unique.
        sequences: how many there are in it.
    """

    title: str
    scoring: str
    rows: tuple[ScoreRow, ...]
    sequences: int = 1

    @property
    def facts(self) -> SequenceInfo:
        """Name, digest, frames and points of the sequence."""
        return self.rows[0].result.sequence

    def row(self, label: str) -> ScoreRow | None:
        """The row of a label."""
        return next((row for row in self.rows if row.label == label), None)

    def best(self, name: str) -> set[str]:
        """Labels of the rows with the highest score, as printed to two decimals; none where there is no rival."""
        scores = {row.label: round(score, 2) for row in self.rows if (score := row.score(name)) is not None}
        return _highest(scores) if len(self.rows) > 1 else set()


def _highest(values: Mapping[str, float]) -> set[str]:
    return {label for label, value in values.items() if value == max(values.values())}


def boards(study: Study) -> list[ScoreBoard]:
    """One board for each sequence and scoring, in the order in which they come."""
    groups: dict[tuple[str, str], list[StudyRun]] = {}
    for cell in study.cells:
        if cell.result is not None:
            digest = cell.result.sequence.digest
            groups.setdefault((digest, cell.result.scoring), []).append(cell)
    labels = _labels(study, groups.values())
    titles = _titles(groups)
    return [
        ScoreBoard(titles[key], key[1], tuple(sorted((_row(labels[cell.file], cell) for cell in cells), key=_rank)))
        for key, cells in groups.items()
    ]


def _row(label: str, cell: StudyRun) -> ScoreRow:
    assert cell.result is not None
    return ScoreRow(label, cell.result, cell)


def _rank(row: ScoreRow) -> tuple[float, str]:
    return row.rank


def _titles(groups: Mapping[tuple[str, str], Sequence[StudyRun]]) -> dict[tuple[str, str], str]:
    """A name for each board: the sequence's; with its digest and scoring where that is not enough."""
    names = {key: " = ".join(dict.fromkeys(cell.sequence for cell in cells)) for key, cells in groups.items()}
    digests = {name: {key[0] for key in names if names[key] == name} for name in names.values()}
    scorings = {scoring for _, scoring in groups}
    titles = {}
    for (digest, scoring), name in names.items():
        more = [digest[:8]] * (len(digests[name]) > 1) + [scoring] * (len(scorings) > 1)
        titles[digest, scoring] = f"{name} ({', '.join(more)})" if more else name
    return titles


def _labels(study: Study, groups: Iterable[Sequence[StudyRun]]) -> dict[Path, str]:
    """A label for each cell's file: what tells the runs on every board apart, and no more than that."""
    ways: list[Callable[[StudyRun], str]] = [
        lambda cell: cell.label,
        lambda cell: f"{cell.label} [{cell.given.name or cell.given}]",
        lambda cell: f"{cell.label} [{study.link(cell.folder if cell.file.name == 'result.json' else cell.file)}]",
    ]
    groups = list(groups)
    way = dict.fromkeys((cell.label for cells in groups for cell in cells), 0)
    for label in way:
        alike = [[cell for cell in cells if cell.label == label] for cells in groups]
        while way[label] < 2 and any(len({ways[way[label]](cell) for cell in cells}) < len(cells) for cells in alike):
            way[label] += 1
    return {cell.file: ways[way[cell.label]](cell) for cells in groups for cell in cells}


def together(study: Study, every: Sequence[ScoreBoard]) -> tuple[list[ScoreBoard], list[str]]:
    """A board of all sequences for each scoring, by adding counts, where every method ran on every sequence.

    Returns:
        The boards, and where there can be none, a sentence that says why.
    """
    boards_of_all, notes = [], []
    for scoring in dict.fromkeys(board.scoring for board in every):
        alike = [board for board in every if board.scoring == scoring]
        labels = list(dict.fromkeys(row.label for board in alike for row in board.rows))
        absent = [f"{label} on {board.title}" for label in labels for board in alike if board.row(label) is None]
        of = f" ({scoring})" if len({board.scoring for board in every}) > 1 else ""
        if len(alike) < 2:
            continue
        if absent:
            rest = f" and {len(absent) - 3} more" if len(absent) > 3 else ""
            notes.append(f"No row for all sequences together{of}: there is no {', no '.join(absent[:3])}{rest}.")
            continue
        rows = [
            ScoreRow(label, combined([row.result for board in alike if (row := board.row(label))])) for label in labels
        ]
        boards_of_all.append(ScoreBoard(f"all {len(alike)}{of}", scoring, tuple(sorted(rows, key=_rank)), len(alike)))
        differ = [row.label for row in rows if _parameters_differ([board.row(row.label) for board in alike])]
        if differ:
            notes.append(f"All sequences together{of}: {', '.join(differ)} had other parameters on some sequences.")
    return boards_of_all, notes


def _parameters_differ(rows: Sequence[ScoreRow | None]) -> bool:
    return any(
        row is not None and rows[0] is not None and row.result.parameters != rows[0].result.parameters for row in rows
    )


@dataclass(frozen=True)
class Losses:
    """What a method's errors of one kind cost, over all sequences it ran on, by adding points.

    Attributes:
        cost: percentage points of SA or DA; None where undefined.
        causes: the percentage points of each cause, the largest first.
        by_reason: the results tell no causes, so these are the method's own reasons.
    """

    cost: float | None
    causes: Mapping[str, float]
    by_reason: bool = False


def losses(rows: Sequence[ScoreRow], kind: str) -> Losses:
    """What the errors of a kind cost in some rows of one method.

    Args:
        rows: of one method and scoring.
        kind: ``false_positive`` or ``false_negative``.
    """
    _, right, wrong = KINDS[kind]
    results = [row.result for row in rows]
    whole = sum(result.counts.get(right, 0) + result.counts.get(wrong, 0) for result in results)
    if not whole:
        return Losses(None, {})
    known = all(result.causes for result in results)
    points: Counter[str] = Counter()
    for result in results:
        if known:
            points.update({cause: count.points for cause, count in result.causes.get(kind, {}).items()})
        else:
            points.update(getattr(result.sections.reasons or Reasons(), kind))
    total = sum(result.counts.get(wrong, 0) for result in results)
    return Losses(
        100 * total / whole,
        {cause or UNKNOWN: 100 * count / whole for cause, count in sorted(points.items(), key=_largest) if count},
        not known,
    )


def _largest(pair: tuple[str, int]) -> tuple[int, str]:
    return -pair[1], pair[0]


def by_method(every: Iterable[ScoreBoard]) -> dict[tuple[str, str], list[ScoreRow]]:
    """Rows of all boards by label and scoring."""
    groups: defaultdict[tuple[str, str], list[ScoreRow]] = defaultdict(list)
    for board in every:
        for row in board.rows:
            groups[row.label, board.scoring].append(row)
    return dict(groups)


def setting(result: Result) -> str:
    """The machine and the threads that a runtime belongs to."""
    machine, threads = result.environment.machine, result.runtime.threads
    parts = [
        " ".join(filter(None, (machine.system, machine.arch))),
        f"{machine.cores} cores" if machine.cores else "",
        f"{threads} thread{'s' * (threads != 1)}" if threads else "",
    ]
    return ", ".join(part for part in parts if part) or "unknown machine"


def fastest(board: ScoreBoard) -> set[str]:
    """Labels of the rows with the least runtime, as printed, among those of the same setting; none without a rival.

    Runtimes while states were recorded do not count.
    """
    groups: defaultdict[str, dict[str, float]] = defaultdict(dict)
    for row in board.rows:
        mean = row.result.runtime.mean_s
        if mean is not None and not row.result.instrumented:
            groups[setting(row.result)][row.label] = -round(mean, 3)
    return {label for values in groups.values() if len(values) > 1 for label in _highest(values)}


def n_parameters(result: Result) -> int | None:
    """How many parameters a method has; None for a map of another program, whose parameters nobody knows."""
    return None if result.sections.source else len(result.parameters)
