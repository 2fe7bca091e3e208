"""The tables of a report, the same for every format.

The paper's two, an overview, errors, cases, objects and runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from dynaviz.reports.reporting import Study
from dynaviz.scores.movers import FEWEST
from dynaviz.scores.result import Result
from dynaviz.scores.scores import SCORES
from dynaviz_eval.report.boards import (
    ERRORS,
    KINDS,
    UNKNOWN,
    Losses,
    ScoreBoard,
    ScoreRow,
    boards,
    by_method,
    combined_boards,
    fastest,
    losses,
    n_parameters,
    setting,
)
from dynaviz_eval.report.by_protocol import ByProtocol, protocol_table
from dynaviz_eval.report.ceilings import ceiling_table
from dynaviz_eval.report.errors import cause_table, interval_table, removal_table
from dynaviz_eval.report.objects import object_table
from dynaviz_eval.report.published_tables import benchmark_table, protocols_table
from dynaviz_eval.report.spots import SharedCase, case_table, shared_cases
from dynaviz_eval.report.table import (
    ABSENT,
    NONE,
    Column,
    Table,
    Value,
    count,
    many,
    named,
    percent,
)

MARK = "†"  # runtimes measured while states were recorded


@dataclass(frozen=True)
class BoardTables:
    """The tables of one sequence and scoring; those that do not apply have no rows.

    Attributes:
        main, scores: the main score under each protocol, and all scores.
        published: published numbers of the public benchmark next to the board's own;
            published_protocols: those under other protocols.
        removals: removed points of runs without ground truth.
        ceiling: what the drive showed of its moving objects, and what each method made of it.
        cases: the places at which methods fail; ``case_list``: the same as a table.
        objects: what became of each object.
        range, height: accuracy by range from the sensor, and by height above the ground.
    """

    main: Table
    scores: Table
    published: Table | None
    published_protocols: Table | None
    removals: Table
    ceiling: Table
    cases: Sequence[SharedCase]
    case_list: Table
    objects: Table
    range: Table
    height: Table

    @property
    def every(self) -> list[Table]:
        """All tables with rows, in the order of a report."""
        first = (self.main, self.scores, self.published, self.published_protocols, self.removals)
        by_place = (self.range, self.height)
        return [
            table
            for table in (*first, self.ceiling, self.case_list, self.objects, *by_place)
            if table and table.rows
        ]


@dataclass(frozen=True)
class Tables:
    """All texts and numbers of a report. Tables that do not apply have no rows.

    Attributes:
        headline: what was compared, and the best of each board, as sentences.
        boards: one per sequence and scoring; ``combined``: all sequences combined.
        glance: the overview.
        across: sequences by methods, a table for each protocol; ``protocols``: what each protocol
            counts.
        accuracy, runtime: the paper's two.
        failures: the accuracy lost to each cause.
        by_board: the tables of each board.
        failed, runs: the failed runs, and all others.
    """

    headline: Sequence[str]
    boards: Sequence[ScoreBoard]
    combined: Sequence[ScoreBoard]
    glance: Table
    across: Sequence[Table]
    protocols: Table
    accuracy: Table
    runtime: Table
    failures: Table
    by_board: Sequence[BoardTables]
    failed: Table
    runs: Table

    @property
    def every(self) -> list[Table]:
        """All tables with rows, in the order of a report."""
        of_boards = [table for board in self.by_board for table in board.every]
        first = (self.glance, *self.across, self.failures, self.accuracy, self.runtime)
        return [
            table
            for table in (*first, *of_boards, self.protocols, self.failed, self.runs)
            if table.rows
        ]


def tables(study: Study) -> Tables:
    """Make all tables of a study."""
    single = boards(study)
    combined, notes = combined_boards(study, _with_truth(single))
    scores = ByProtocol.of(study, single)
    return Tables(
        [
            _headline(study, single),
            *(scores.best_of_each() if scores.infos else _best_of_each([*combined, *single])),
        ],
        single,
        combined,
        _glance(_with_truth(single), combined),
        scores.across(),
        protocol_table(scores.infos),
        _accuracy([*combined, *_with_truth(single)], notes),
        _runtime(single, combined),
        cause_table(single, _order(single, combined)),
        [_of_board(scores, board, number) for number, board in enumerate(single, 1)],
        failed_table(study),
        _runs(study, single),
    )


def _with_truth(boards: Sequence[ScoreBoard]) -> list[ScoreBoard]:
    return [board for board in boards if board.has_truth]


def _of_board(scores: ByProtocol, board: ScoreBoard, number: int) -> BoardTables:
    cases = shared_cases(board)
    return BoardTables(
        scores.main_scores(board, number),
        scores.all_scores(board, number),
        benchmark_table(scores, board, number),
        protocols_table(scores, board, number),
        removal_table(board, number),
        ceiling_table(board, number),
        cases,
        case_table(board, cases, number),
        object_table(board, number),
        interval_table(board, "range", number),
        interval_table(board, "height", number),
    )


def runtime(result: Result, bold: bool = False) -> Value:
    """Seconds per frame, mean and standard deviation, marked if recording slowed the
    method down.
    """
    mean = result.runtime.mean_s
    std = result.runtime.std_s
    if mean is None:
        return Value(NONE)
    mark = MARK if result.instrumented else ""
    return Value(f"{mean:.3f}" + ("" if std is None else f" ± {std:.3f}") + mark, mean, bold)


def _order(single: Sequence[ScoreBoard], combined: Sequence[ScoreBoard]) -> list[str]:
    """Labels in the order of the combined board if there is one, else of the boards, best first."""
    return list(dict.fromkeys(row.label for board in [*combined, *single] for row in board.rows))


def _headline(study: Study, single: Sequence[ScoreBoard]) -> str:
    methods = {run.method for run in study.runs}
    known = {board.sequence.name for board in single}
    sequences = {board.sequence.digest for board in single} | {
        run.sequence for run in study.runs if run.sequence not in known
    }
    failed = sum(run.result is None for run in study.runs)
    scorings = " and ".join(dict.fromkeys(board.scoring for board in single))
    return (
        f"{many(len(study.runs), 'run')} of {many(len(methods), 'method')} on "
        f"{many(len(sequences), 'sequence')}."
        + (f" Scoring: {scorings}." if scorings else "")
        + (f" {many(failed, 'run')} failed." if failed else "")
    )


def _best_of_each(boards: Sequence[ScoreBoard]) -> list[str]:
    """The best AA of each board, as sentences."""
    lines = []
    for board in boards:
        best = sorted(board.best("AA"))
        aa = [row.score("AA") for row in board.rows]
        if best:
            lines.append(
                f"Best on {board.title}: {' and '.join(best)}, AA {percent(aa[0]).text} %."
            )
    return lines


def _glance(single: Sequence[ScoreBoard], combined: Sequence[ScoreBoard]) -> Table:
    """The AA of each method on each sequence, and its costliest cause of errors."""
    groups = by_method(single)
    order = _order(single, combined)
    several = len({board.scoring for board in single}) > 1
    columns = [Column("method", number=False)]
    columns += [
        Column(f"{board.title}", "AA [%] ↑", main=board.n_sequences > 1)
        for board in [*combined, *single]
    ]
    columns += [Column("worst failure", number=False), Column("SA lost [%]"), Column("DA lost [%]")]
    rows = []
    for label, scoring in sorted(groups, key=lambda key: order.index(key[0])):
        aas = [
            scored(row, "AA", label in board.best("AA"))
            if board.scoring == scoring and (row := board.row(label))
            else Value(ABSENT)
            for board in [*combined, *single]
        ]
        found = {kind: losses(groups[label, scoring], kind) for kind in KINDS}
        name = f"{label}, {scoring}" if several else label
        costs = [percent(found[kind].cost) for kind in KINDS]
        rows.append([named(name), *aas, Value(worst(found), worst(found)), *costs])
    notes = [
        "AA = √(SA · DA). SA: share of static points that were kept. DA: share of dynamic points "
        "that were removed. "
        "The best of each column is bold.",
        "Worst failure: the cause that costs the most percentage points of SA or DA, over all "
        "sequences that the "
        "method ran on, with points added up.",
        *_drawn([*combined, *single]),
    ]
    if several:
        notes.append(
            "Scores of different scorings (mask, nn) cannot be compared; they have separate "
            "columns."
        )
    return Table("glance", "At a glance", columns, rows, notes)


def scored(row: ScoreRow, name: str, best: bool) -> Value:
    """A score of a run; AA with its interval over drawn movers."""
    value = percent(row.score(name), best)
    if name != "AA" or row.aa_interval is None:
        return value
    low, high = row.aa_interval
    return replace(value, interval=f"{low:.0f} to {high:.0f}")


def _drawn(every: Iterable[ScoreBoard]) -> list[str]:
    """What intervals are, if any run has one."""
    if all(row.aa_interval is None for board in every for row in board.rows):
        return []
    return [
        "Below or behind AA: its 95 % interval if the movers of the sequence are drawn again with "
        "replacement. Differences within the intervals depend on which objects moved. "
        f"None for fewer than {FEWEST} movers, or movers without numbers."
    ]


def worst(found: dict[str, Losses]) -> str:
    """The costliest cause, in words."""
    costs = [
        (cost, kind, cause) for kind, loss in found.items() for cause, cost in loss.causes.items()
    ]
    if not costs:
        return "none" if any(loss.cost == 0 for loss in found.values()) else NONE
    cost, kind, cause = max(costs)
    prefix = "cause " if cause == UNKNOWN else ""
    return f"{ERRORS[kind]}: {prefix}{cause} (−{cost:.1f} {KINDS[kind][0]})"


def _accuracy(every: Sequence[ScoreBoard], notes: Sequence[str]) -> Table:
    """The paper's first table, with HA added."""
    columns = [Column("method", number=False)]
    for board in every:
        columns += [Column(f"{name} ↑", board.title, main=name == "AA") for name in SCORES]
    rows = []
    for label in _order(
        [b for b in every if b.n_sequences == 1], [b for b in every if b.n_sequences > 1]
    ):
        row = [named(label)]
        for board in every:
            here = board.row(label)
            row += [
                scored(here, name, label in board.best(name)) if here else Value(ABSENT)
                for name in SCORES
            ]
        rows.append(row)
    scorings = sorted({board.scoring for board in every})
    notes = [
        "Percent. SA: static points kept; DA: dynamic points removed; AA = √(SA · DA); HA = 2 · SA "
        "· DA / (SA + DA). "
        f"Scoring: {', '.join(scorings)}. The best of each column is bold.",
        *_drawn(every),
        *(
            f"{board.title}: {' and '.join(board.other_names)} in some results; the points are "
            "the same."
            for board in every
            if board.other_names
        ),
        *(
            f"{board.title}: counts of {board.n_sequences} sequences added up."
            for board in every
            if board.n_sequences > 1
        ),
        *(
            f"{row.label} on {board.title}: {row.result.unanswered}."
            for board, row in _pairs(every)
            if row.result.unanswered
        ),
        *notes,
    ]
    return Table("accuracy", "Accuracy", columns, rows, notes)


def _runtime(single: Sequence[ScoreBoard], combined: Sequence[ScoreBoard]) -> Table:
    """The paper's second table, with a row for each machine and number of threads."""
    timed = [
        row.result
        for board in single
        for row in board.rows
        if row.result.runtime.mean_s is not None
    ]
    settings = sorted({setting(result) for result in timed})
    several = len(settings) > 1
    columns = [
        Column("method", number=False),
        *([Column("machine", number=False)] if several else []),
    ]
    columns += [Column(board.title, "runtime per frame [s] ↓") for board in single] + [
        Column("parameters")
    ]
    best = [fastest(board) for board in single]
    rows = []
    for label in _order(single, combined):
        here = [board.row(label) for board in single]
        for where in sorted({_where(row.result) for row in here if row}):
            chosen = [row if row and _where(row.result) == where else None for row in here]
            values = [
                runtime(row.result, label in fast) if row else Value(ABSENT)
                for row, fast in zip(chosen, best, strict=True)
            ]
            numbers = sorted(
                {
                    NONE if (n := n_parameters(row.result)) is None else str(n)
                    for row in chosen
                    if row
                }
            )
            amount = Value(", ".join(numbers), float(numbers[0]) if numbers[0].isdigit() else None)
            rows.append(
                [named(label), *([Value(where or NONE, where)] if several else []), *values, amount]
            )
    notes = [
        "Mean and standard deviation over frames, of the method alone, without reading and "
        "recording. "
        "Parameters: number of parameters that can be tuned.",
    ]
    if several:
        notes.append(
            "Runtimes of different machines or thread counts cannot be compared; the fastest of "
            "each is bold."
        )
    elif settings:
        notes.append(f"Measured on {settings[0]}.")
    if any(row.result.instrumented for board in single for row in board.rows):
        notes.append(
            f"{MARK} Measured while states were recorded: slower than the method alone, so never "
            "bold."
        )
    return Table("runtime", "Runtime and parameters", columns, rows, notes)


def _where(result: Result) -> str:
    """The setting of a runtime; empty without a runtime."""
    return "" if result.runtime.mean_s is None else setting(result)


def failed_table(study: Study) -> Table:
    """The failed runs with their errors."""
    rows = [
        [named(run.label), Value(run.sequence, run.sequence), Value(run.error or "", run.error)]
        for run in study.runs
        if run.result is None
    ]
    columns = [Column(name, number=False) for name in ("method", "sequence", "error")]
    return Table("failed", "Failed runs", columns, rows)


def _runs(study: Study, single: Sequence[ScoreBoard]) -> Table:
    """Every run with its counts and the path of its recording."""
    names = ("static_kept", "static_removed", "dynamic_removed", "dynamic_kept")
    columns = [
        Column("method", number=False),
        Column("sequence", number=False),
        Column("scoring", number=False),
    ]
    columns += [Column("frames"), *(Column(name.replace("_", " "), "points") for name in names)]
    columns += [Column(name, number=False) for name in ("labels", "code", "recording")]
    rows = []
    for board, row in _pairs(single):
        assert row.run is not None
        recording = row.run.recording
        path = "" if recording is None else study.link(recording)
        title = board.title.removesuffix(f" ({board.scoring})")
        rows.append(
            [
                named(row.label),
                Value(title, title),
                Value(board.scoring, board.scoring),
                count(row.result.sequence.frames),
                *(
                    count(row.result.counts.get(name) if row.result.has_truth else None)
                    for name in names
                ),
                Value((row.result.labels_sha256 or NONE)[:8], row.result.labels_sha256),
                Value(_code(row) or NONE, _code(row)),
                Value(path or "none", path, link=path),
            ]
        )
    notes = [
        "Labels: the first digits of the digest of all labels; runs with equal digests have equal "
        "labels. Code: the same of the code of the method."
    ]
    codes: dict[str, set[str]] = {}
    for _, row in _pairs(single):
        codes.setdefault(row.result.method, set()).add(_code(row))
    if changed := [method for method, found in codes.items() if len(found - {""}) > 1]:
        notes.append(f"The code differs between the runs of {', '.join(changed)}.")
    if study.protocols:
        notes.append(
            "board.json next to this page has all digests in full, all counts, and the parameters."
        )
    if any(row[-1].link for row in rows):
        notes.append(
            "To view a recording: dynaviz view PATH. To compare two: dynaviz compare PATH PATH."
        )
    return Table("runs", "All runs", columns, rows, notes)


def _code(row: ScoreRow) -> str:
    """The first digits of the digest of the method's code; empty if unknown."""
    plugin = row.result.plugin
    return "" if plugin is None else plugin.sha256[:8]


def _pairs(single: Iterable[ScoreBoard]) -> Iterable[tuple[ScoreBoard, ScoreRow]]:
    return ((board, row) for board in single for row in board.rows)
