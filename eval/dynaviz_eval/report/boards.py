"""Results that can be compared, side by side: the same points, scored in the same way."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from dynaviz.reports.reporting import Study
from dynaviz.scores import movers
from dynaviz.scores.collect import StudyRun, combined
from dynaviz.scores.result import Result
from dynaviz.scores.scores import percentage_points_lost
from dynaviz.scores.sections import SequenceInfo

UNKNOWN = "unknown"  # the cause of errors for which the method gives no known cause
KINDS = {
    "false_positive": ("SA", "static_kept", "static_removed"),
    "false_negative": ("DA", "dynamic_removed", "dynamic_kept"),
}
"""Kinds of error: the score that they lower, and the counts of correct and wrong points."""
ERRORS = {"false_positive": "static removed", "false_negative": "dynamic kept"}


@dataclass(frozen=True)
class ScoreRow:
    """A run on a board.

    Attributes:
        label: its name.
        result: of the run, or of several sequences combined.
        run: None for several sequences combined.
        parts: the results that are combined.
    """

    label: str
    result: Result
    run: StudyRun | None = None
    parts: tuple[Result, ...] = ()

    def score(self, name: str) -> float | None:
        """A metric in percent; None if undefined."""
        return self.result.metrics.get(name)

    @cached_property
    def aa_interval(self) -> tuple[float, float] | None:
        """The interval of AA over drawn movers, percent; None if movers are few or unknown."""
        return movers.aa_interval(self.parts or (self.result,))

    @property
    def rank(self) -> tuple[float, str]:
        """Sort key: best AA first, undefined ones last, equal ones by name."""
        aa = self.score("AA")
        return (math.inf if aa is None else -aa), self.label


@dataclass(frozen=True)
class ScoreBoard:
    """All runs that can be compared with each other.

    Attributes:
        title: name of the sequence, with its digest or scoring if the name is not unique.
        scoring: ``mask`` or ``nn``.
        rows: best first; labels are unique.
        n_sequences: number of sequences.
        other_names: names of the same points in other results.
    """

    title: str
    scoring: str
    rows: tuple[ScoreRow, ...]
    n_sequences: int = 1
    other_names: tuple[str, ...] = ()

    @property
    def sequence(self) -> SequenceInfo:
        """Name, digest, frames and points of the sequence."""
        return self.rows[0].result.sequence

    @property
    def has_truth(self) -> bool:
        """Whether the sequence has ground truth."""
        return any(row.result.has_truth for row in self.rows)

    def row(self, label: str) -> ScoreRow | None:
        """The row with this label, or None."""
        return next((row for row in self.rows if row.label == label), None)

    def best(self, name: str) -> set[str]:
        """Labels of the rows with the highest score, rounded to two decimals as printed.

        Empty for a single row.
        """
        scores = {
            row.label: round(score, 2)
            for row in self.rows
            if (score := row.score(name)) is not None
        }
        return _highest(scores) if len(self.rows) > 1 else set()


def best_of_each_method(board: ScoreBoard) -> list[ScoreRow]:
    """The row with the best AA of each method, best method first."""
    best: dict[str, ScoreRow] = {}
    for row in board.rows:
        best.setdefault(row.result.method, row)
    return list(best.values())


def _highest(values: Mapping[str, float]) -> set[str]:
    return {label for label, value in values.items() if value == max(values.values())}


def boards(study: Study) -> list[ScoreBoard]:
    """One board per sequence and scoring, in the order of the study."""
    groups: dict[tuple[str, str], list[StudyRun]] = {}
    for run in study.runs:
        if run.result is not None:
            groups.setdefault((run.result.sequence.digest, run.result.scoring), []).append(run)
    labels = _labels(study, groups.values())
    titles = _titles(groups)
    return [
        ScoreBoard(
            titles[key],
            key[1],
            tuple(sorted((_row(labels[run.file], run) for run in runs), key=_rank)),
            other_names=tuple(_names(runs)[1:]),
        )
        for key, runs in groups.items()
    ]


def _row(label: str, run: StudyRun) -> ScoreRow:
    assert run.result is not None
    return ScoreRow(label, run.result, run)


def _rank(row: ScoreRow) -> tuple[float, str]:
    return row.rank


def _titles(groups: Mapping[tuple[str, str], Sequence[StudyRun]]) -> dict[tuple[str, str], str]:
    """A title for each board.

    The name of the sequence, with digest and scoring if the name is not unique.
    """
    names = {key: _names(runs)[0] for key, runs in groups.items()}
    digests = {name: {key[0] for key in names if names[key] == name} for name in names.values()}
    scorings = {scoring for _, scoring in groups}
    titles = {}
    for (digest, scoring), name in names.items():
        suffix = [digest[:8]] * (len(digests[name]) > 1) + [scoring] * (len(scorings) > 1)
        titles[digest, scoring] = f"{name} ({', '.join(suffix)})" if suffix else name
    return titles


def _names(runs: Sequence[StudyRun]) -> list[str]:
    """The names of a sequence in its results, the most frequent one first."""
    return [name for name, _ in Counter(run.sequence for run in runs).most_common()]


_LabelForm = Callable[[Study, StudyRun], str]


_LABEL_FORMS: tuple[_LabelForm, ...] = (
    lambda study, run: run.label,
    lambda study, run: f"{run.label} [{run.given.name or run.given}]",  # the path given by the user
    lambda study, run: f"{run.label} [{run.folder.name}]",
    lambda study, run: (
        f"{run.label} [{study.link(run.folder if run.file.name == 'result.json' else run.file)}]"
    ),
)


def _labels(study: Study, groups: Iterable[Sequence[StudyRun]]) -> dict[Path, str]:
    """A label for each run, by its file: as short as is unique on every board."""
    groups = list(groups)
    forms: dict[str, _LabelForm] = {}
    for label in dict.fromkeys(run.label for runs in groups for run in runs):
        forms[label] = _shortest_form(
            study, [[run for run in runs if run.label == label] for runs in groups]
        )
    return {run.file: forms[run.label](study, run) for runs in groups for run in runs}


def _shortest_form(study: Study, groups: Sequence[Sequence[StudyRun]]) -> _LabelForm:
    """The first form that gives the runs of each group different labels, otherwise the last."""
    for form in _LABEL_FORMS:
        if all(len({form(study, run) for run in runs}) == len(runs) for runs in groups):
            return form
    return _LABEL_FORMS[-1]


def combined_boards(
    study: Study, single: Sequence[ScoreBoard]
) -> tuple[list[ScoreBoard], list[str]]:
    """A board of all sequences for each scoring, with counts added up.

    It has the methods that ran on every sequence.

    Returns:
        The boards, and notes: which methods are left out, and whose parameters differ.
    """
    boards_of_all = []
    notes = []
    for scoring in dict.fromkeys(board.scoring for board in single):
        alike = [board for board in single if board.scoring == scoring]
        labels = list(dict.fromkeys(row.label for board in alike for row in board.rows))
        absent = [
            f"{label} on {board.title}"
            for label in labels
            for board in alike
            if board.row(label) is None
        ]
        of = f" ({scoring})" if len({board.scoring for board in single}) > 1 else ""
        if len(alike) < 2:
            continue
        if absent:
            rest = f" and {len(absent) - 3} more" if len(absent) > 3 else ""
            notes.append(
                f"All sequences combined{of}: only methods that ran on each. Missing: "
                f"{', '.join(absent[:3])}{rest}."
            )
        rows = [
            ScoreRow(label, combined(parts), parts=tuple(parts))
            for label in labels
            if all(found := [board.row(label) for board in alike])
            and (parts := [row.result for row in found if row])
        ]
        if not rows:
            continue
        boards_of_all.append(
            ScoreBoard(f"all {len(alike)}{of}", scoring, tuple(sorted(rows, key=_rank)), len(alike))
        )
        differ = [
            row.label
            for row in rows
            if any(
                (r := board.row(row.label)) and r.result.parameters != row.result.parameters
                for board in alike
            )
        ]
        if differ:
            notes.append(
                f"All sequences combined{of}: {', '.join(differ)} had different parameters on some "
                "sequences."
            )
    return boards_of_all, notes


@dataclass(frozen=True)
class Losses:
    """The cost of a method's errors of one kind, over all sequences it ran on, with points added
    up.

    Attributes:
        cost: percentage points of SA or DA; None if undefined.
        causes: percentage points by cause, largest first; empty for results of earlier versions,
            which have none.
    """

    cost: float | None
    causes: Mapping[str, float]


def losses(rows: Sequence[ScoreRow], kind: str) -> Losses:
    """The cost of the errors of a kind, over some rows of one method.

    Args:
        rows: of one method and scoring.
        kind: ``false_positive`` or ``false_negative``.
    """
    _, right, wrong = KINDS[kind]
    results = [row.result for row in rows]
    whole = sum(result.counts.get(right, 0) + result.counts.get(wrong, 0) for result in results)
    if not whole:
        return Losses(None, {})
    points: Counter[str] = Counter()
    for result in results:
        points.update({cause: count.points for cause, count in result.causes.get(kind, {}).items()})
    total = sum(result.counts.get(wrong, 0) for result in results)
    return Losses(
        float(percentage_points_lost(total, whole)),
        {
            cause or UNKNOWN: float(percentage_points_lost(count, whole))
            for cause, count in sorted(points.items(), key=lambda pair: (-pair[1], pair[0]))
            if count
        },
    )


def by_method(every: Iterable[ScoreBoard]) -> dict[tuple[str, str], list[ScoreRow]]:
    """Rows of all boards by label and scoring."""
    groups: defaultdict[tuple[str, str], list[ScoreRow]] = defaultdict(list)
    for board in every:
        for row in board.rows:
            groups[row.label, board.scoring].append(row)
    return dict(groups)


def setting(result: Result) -> str:
    """The machine and the number of threads of a runtime."""
    machine = result.environment.machine
    threads = result.runtime.threads
    parts = [
        " ".join(filter(None, (machine.system, machine.arch))),
        f"{machine.cores} cores" if machine.cores else "",
        f"{threads} thread{'s' * (threads != 1)}" if threads else "",
    ]
    return ", ".join(part for part in parts if part) or "unknown machine"


def fastest(board: ScoreBoard) -> set[str]:
    """Labels of the rows with the lowest runtime, as printed, of each setting with several
    runtimes.

    Runtimes measured while states were recorded do not count.
    """
    groups: defaultdict[str, dict[str, float]] = defaultdict(dict)
    for row in board.rows:
        mean = row.result.runtime.mean_s
        if mean is not None and not row.result.instrumented:
            groups[setting(row.result)][row.label] = -round(mean, 3)
    return {label for values in groups.values() if len(values) > 1 for label in _highest(values)}


def n_parameters(result: Result) -> int | None:
    """Number of parameters of a method.

    None for a map of another program, because its parameters are unknown.
    """
    return None if result.sections.source else len(result.parameters)
