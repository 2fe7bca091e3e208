"""The tables of a report, the same for every format: the paper's two, and what else a reader asks first."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from dynaviz.reporting import Study
from dynaviz.results.result import Result
from dynaviz_eval.published import Match, matching, published, published_runtimes
from dynaviz_eval.report.boards import (
    KINDS,
    SCORES,
    UNKNOWN,
    Losses,
    ScoreBoard,
    ScoreRow,
    boards,
    by_method,
    fastest,
    losses,
    n_parameters,
    setting,
    together,
)

NONE = "n/a"
MARK = "†"  # a runtime while states were recorded
DID = {"false_positive": "static removed", "false_negative": "movers kept"}


@dataclass(frozen=True)
class Value:
    """A field of a table.

    Attributes:
        text: as it is printed.
        sort: to order the rows by; None goes last.
        bold: the best of its kind.
        link: where it leads, relative to the report.
    """

    text: str
    sort: float | str | None = None
    bold: bool = False
    link: str = ""


@dataclass(frozen=True)
class Column:
    """A column of a table: its name, the group that it stands in, and whether it holds numbers, and the headline."""

    name: str
    group: str = ""
    number: bool = True
    main: bool = False


@dataclass(frozen=True)
class Table:
    """A table with a short name for links, a title, and notes below it; the first column names the row."""

    name: str
    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Value]]
    notes: Sequence[str] = field(default_factory=tuple)


@dataclass(frozen=True)
class Tables:
    """Everything in words and numbers.

    Attributes:
        headline: what was compared, and the best of each board, as sentences.
        boards: one a sequence and scoring; ``combined``: all sequences together.
        first: the table that tells most; ``tables``: the others. ``public``: published numbers by board title.
    """

    headline: Sequence[str]
    boards: Sequence[ScoreBoard]
    combined: Sequence[ScoreBoard]
    first: Table
    tables: Sequence[Table]
    public: dict[str, Table]

    @property
    def every(self) -> list[Table]:
        """All tables, in the order of a report."""
        return [t for t in (self.first, *self.tables[:2], *self.public.values(), *self.tables[2:]) if t.rows]


def tables(study: Study) -> Tables:
    """Make all tables of a study; those without rows are left out."""
    single = boards(study)
    combined, notes = together(study, single)
    every = [*combined, *single]
    ours = [_accuracy(every, notes), _runtime(single, combined)]
    rest = [_failures(single, combined), _failed(study), _runs(study, single)]
    public = {board.title: table for k, board in enumerate(single, 1) if (table := _public(board, k))}
    return Tables(
        _headline(study, single, combined),
        single,
        combined,
        _glance(single, combined),
        [*ours, *(table for table in rest if table.rows)],
        public,
    )


def percent(value: float | None, bold: bool = False) -> Value:
    """A percentage with two decimals, as in the papers."""
    return Value(NONE) if value is None else Value(f"{value:.2f}", value, bold)


def count(value: int | None) -> Value:
    """A number of points."""
    return Value(NONE) if value is None else Value(f"{value:,}", value)


def runtime(result: Result, bold: bool = False) -> Value:
    """Seconds per frame, mean and standard deviation, marked where recording slowed the method down."""
    mean, std = result.runtime.mean_s, result.runtime.std_s
    if mean is None:
        return Value(NONE)
    mark = MARK if result.instrumented else ""
    return Value(f"{mean:.3f}" + ("" if std is None else f" ± {std:.3f}") + mark, mean, bold)


def named(label: str) -> Value:
    """A row's name."""
    return Value(label, label)


def _order(single: Sequence[ScoreBoard], combined: Sequence[ScoreBoard]) -> list[str]:
    """Labels: as on the board of all sequences where there is one, else as they come, the first board's best first."""
    return list(dict.fromkeys(row.label for board in [*combined, *single] for row in board.rows))


def _headline(study: Study, single: Sequence[ScoreBoard], combined: Sequence[ScoreBoard]) -> list[str]:
    methods = {cell.method for cell in study.cells}
    known = {board.facts.name for board in single}
    sequences = {board.facts.digest for board in single} | {
        cell.sequence for cell in study.cells if cell.sequence not in known
    }
    failed = sum(cell.result is None for cell in study.cells)
    scorings = " and ".join(dict.fromkeys(board.scoring for board in single))
    lines = [
        f"{_many(len(study.cells), 'run')} of {_many(len(methods), 'method')} on "
        f"{_many(len(sequences), 'sequence')}"
        + (f", scored by {scorings}." if scorings else ".")
        + (f" {_many(failed, 'run')} failed." if failed else "")
    ]
    for board in [*combined, *single]:
        best, aa = sorted(board.best("AA")), [row.score("AA") for row in board.rows]
        if best:
            lines.append(f"Best on {board.title}: {' and '.join(best)}, AA {percent(aa[0]).text} %.")
    return lines


def _many(number: int, thing: str) -> str:
    return f"{number} {thing}{'s' * (number != 1)}"


def _glance(single: Sequence[ScoreBoard], combined: Sequence[ScoreBoard]) -> Table:
    """Which method is best where, and what each fails on most."""
    groups, order = by_method(single), _order(single, combined)
    several = len({board.scoring for board in single}) > 1
    columns = [Column("method", number=False)]
    columns += [Column(f"{board.title}", "AA [%] ↑", main=bool(board.sequences > 1)) for board in [*combined, *single]]
    columns += [Column("worst failure", number=False), Column("SA lost [%]"), Column("DA lost [%]")]
    rows = []
    for label, scoring in sorted(groups, key=lambda key: order.index(key[0])):
        aas = [
            percent(row.score("AA"), label in board.best("AA"))
            if board.scoring == scoring and (row := board.row(label))
            else Value("–")
            for board in [*combined, *single]
        ]
        found = {kind: losses(groups[label, scoring], kind) for kind in KINDS}
        name = f"{label}, {scoring}" if several else label
        costs = [percent(found[kind].cost) for kind in KINDS]
        rows.append([named(name), *aas, Value(worst(found), worst(found)), *costs])
    notes = [
        "AA = √(SA · DA): SA is the share of static points that were kept, DA the share of dynamic points that were "
        "removed. Best of each column in bold.",
        "Worst failure: the cause that costs most percentage points of SA or DA, over all sequences that the method "
        "ran on, points added up.",
    ]
    if several:
        notes.append("Scores of different scorings (mask, nn) do not compare; they stand in columns of their own.")
    return Table("glance", "At a glance", columns, rows, notes)


def worst(found: dict[str, Losses]) -> str:
    """The costliest cause of all, in words."""
    costs = [(cost, kind, cause) for kind, loss in found.items() for cause, cost in loss.causes.items()]
    if not costs:
        return "none" if any(loss.cost == 0 for loss in found.values()) else NONE
    cost, kind, cause = max(costs)
    reason = "reason " if found[kind].by_reason else "cause " if cause == UNKNOWN else ""
    return f"{DID[kind]}: {reason}{cause} (−{cost:.1f} {KINDS[kind][0]})"


def _accuracy(every: Sequence[ScoreBoard], notes: Sequence[str]) -> Table:
    """The paper's first table, with HA beside."""
    columns = [Column("method", number=False)]
    for board in every:
        columns += [Column(f"{name} ↑", board.title, main=name == "AA") for name in SCORES]
    rows = []
    for label in _order([b for b in every if b.sequences == 1], [b for b in every if b.sequences > 1]):
        row = [named(label)]
        for board in every:
            here = board.row(label)
            row += [percent(here.score(name), label in board.best(name)) if here else Value("–") for name in SCORES]
        rows.append(row)
    scored = sorted({board.scoring for board in every})
    notes = [
        f"Percent. SA, DA: static points kept, dynamic points removed; AA = √(SA · DA), HA = 2 · SA · DA / (SA + DA). "
        f"Scoring: {', '.join(scored)}. Best of each column in bold.",
        *(f"{board.title}: counts of {board.sequences} sequences added up." for board in every if board.sequences > 1),
        *notes,
    ]
    return Table("accuracy", "Accuracy", columns, rows, notes)


def _runtime(single: Sequence[ScoreBoard], combined: Sequence[ScoreBoard]) -> Table:
    """The paper's second table; a machine and number of threads of its own for each block of rows."""
    timed = [row.result for board in single for row in board.rows if row.result.runtime.mean_s is not None]
    settings = sorted({setting(result) for result in timed})
    several = len(settings) > 1
    columns = [Column("method", number=False), *([Column("machine", number=False)] if several else [])]
    columns += [Column(board.title, "runtime per frame [s] ↓") for board in single] + [Column("parameters")]
    best = [fastest(board) for board in single]
    rows = []
    for label in _order(single, combined):
        here = [board.row(label) for board in single]
        for where in sorted({_where(row.result) for row in here if row}):
            chosen = [row if row and _where(row.result) == where else None for row in here]
            values = [
                runtime(row.result, label in fast) if row else Value("–")
                for row, fast in zip(chosen, best, strict=True)
            ]
            numbers = sorted({NONE if (n := n_parameters(row.result)) is None else str(n) for row in chosen if row})
            amount = Value(", ".join(numbers), float(numbers[0]) if numbers[0].isdigit() else None)
            rows.append([named(label), *([Value(where or NONE, where)] if several else []), *values, amount])
    notes = [
        "Mean and standard deviation over frames, of the method alone: no reading, no recording. "
        "Parameters: how many a user may tune.",
    ]
    if several:
        notes.append("Runtimes of different machines or threads do not compare; the fastest of each is bold.")
    elif settings:
        notes.append(f"Measured on {settings[0]}.")
    if any(row.result.instrumented for board in single for row in board.rows):
        notes.append(f"{MARK} while its states were recorded: slower than the method alone, so never bold.")
    return Table("runtime", "Runtime and parameters", columns, rows, notes)


def _where(result: Result) -> str:
    """The setting of a runtime; empty where there is no runtime."""
    return "" if result.runtime.mean_s is None else setting(result)


def match(board: ScoreBoard) -> Match | None:
    """The public sequence that a board may be of."""
    breakdown = board.rows[0].result.sections.breakdown
    return matching(board.facts, [row.index for row in breakdown.frame] if breakdown else [])


def _public(board: ScoreBoard, number: int) -> Table | None:
    """Published numbers beside ours."""
    known = match(board)
    if known is None:
        return None
    columns = [Column("method", number=False)]
    columns += [Column(name, "published [%]", main=name == "AA") for name in SCORES]
    columns += [Column(name, f"here, {board.scoring} [%]", main=name == "AA") for name in SCORES]
    columns += [Column("seconds per frame", "published"), Column("source")]
    rows = []
    sources = list(dict.fromkeys(row.source for row in published(known.name)))
    speeds = {speed.method: speed for speed in published_runtimes() if speed.sequence == known.name}
    for row in published(known.name):
        ours = next((r for r in board.rows if r.result.method == row.method and r.result.online == row.online), None)
        values = [percent(ours.score(name)) if ours else Value("–") for name in SCORES]
        theirs = [percent(getattr(row, name)) for name in SCORES]
        speed = speeds.get(row.method)
        took = (
            Value(f"{speed.mean_s:.3f} ± {speed.std_s:.3f}", speed.mean_s) if speed and not row.online else Value("–")
        )
        rows.append([named(row.title), *theirs, *values, took, count(sources.index(row.source) + 1)])
    notes = [
        known.doubt + ("" if known.same else " So these numbers are of other points than ours."),
        "Published scores were computed by nearest neighbour (nn, 0.05 m) from maps that other programs wrote; beside "
        "mask scores they are for orientation. Poses and parameters may differ. Published seconds: Intel i9-12900KF.",
    ]
    notes.append("Sources: " + "; ".join(f"{number} {source}" for number, source in enumerate(sources, 1)) + ".")
    if any(sum(r.result.method == row.result.method for r in board.rows) > 1 for row in board.rows):
        notes.append("Of several variants of a method, the one with the best AA stands here.")
    return Table(f"published-{number}", f"Published for {known.name}, beside {board.title}", columns, rows, notes)


def _failures(single: Sequence[ScoreBoard], combined: Sequence[ScoreBoard]) -> Table:
    """What each method's errors cost, by cause."""
    groups = by_method(single)
    several = len({scoring for _, scoring in groups}) > 1
    columns = [Column("method", number=False)]
    columns += [
        Column(name, f"{DID[kind]}, {KINDS[kind][0]} lost [%]", number=name == "all")
        for kind in KINDS
        for name in ("all", "by cause")
    ]
    rows, by_reason = [], False
    order = _order(single, combined)
    for (label, scoring), mine in sorted(groups.items(), key=lambda item: order.index(item[0][0])):
        found = [losses(mine, kind) for kind in KINDS]
        by_reason |= any(loss.by_reason for loss in found)
        cells = [named(f"{label}, {scoring}" if several else label)]
        for loss in found:
            cells += [percent(loss.cost), Value(_causes(loss), loss.cost)]
        rows.append(cells)
    most = max((len(mine) for mine in groups.values()), default=0)
    fewer = [f"{label} on {len(mine)}" for (label, _), mine in groups.items() if len(mine) < most]
    notes = [
        "Percentage points, over the sequences that a method ran on, points added up. eval/README.md explains causes."
    ]
    if fewer:
        notes.append(f"Not on all {most} sequences, so not to be compared: {', '.join(fewer)}.")
    if by_reason:
        notes.append("Results without failure cases: the method's own reasons stand in place of causes.")
    return Table("failures", "Why points are wrong", columns, rows, notes)


def _causes(loss: Losses, most: int = 3) -> str:
    listed = [f"{cause} {cost:.2f}" for cause, cost in list(loss.causes.items())[:most] if cost >= 0.005]
    return ", ".join(listed) or ("none" if loss.cost == 0 else NONE if loss.cost is None else "less than 0.01 each")


def _failed(study: Study) -> Table:
    rows = [
        [named(cell.label), Value(cell.sequence, cell.sequence), Value(cell.error or "", cell.error)]
        for cell in study.cells
        if cell.result is None
    ]
    columns = [Column(name, number=False) for name in ("method", "sequence", "error")]
    return Table("failed", "Failed runs", columns, rows)


def _runs(study: Study, single: Sequence[ScoreBoard]) -> Table:
    """Every run with its counts, and where its recording is."""
    names = ("static_kept", "static_removed", "dynamic_removed", "dynamic_kept")
    columns = [Column("method", number=False), Column("sequence", number=False), Column("scoring", number=False)]
    columns += [Column("frames"), *(Column(name.replace("_", " "), "points") for name in names)]
    columns += [Column("labels", number=False), Column("recording", number=False)]
    rows = []
    for board, row in _pairs(single):
        assert row.cell is not None
        recording = row.cell.recording
        path = "" if recording is None else study.link(recording)
        title = board.title.removesuffix(f" ({board.scoring})")
        rows.append(
            [
                named(row.label),
                Value(title, title),
                Value(board.scoring, board.scoring),
                count(row.result.sequence.frames),
                *(count(row.result.counts.get(name)) for name in names),
                Value((row.result.labels_sha256 or NONE)[:8], row.result.labels_sha256),
                Value(path or "none", path, link=path),
            ]
        )
    notes = ["Labels: the first digits of the digest of all labels; equal ones mean equal answers."]
    if any(row[-1].link for row in rows):
        notes.append("Look at a recording: dynaviz view PATH. What differs between two: dynaviz compare PATH PATH.")
    return Table("runs", "All runs", columns, rows, notes)


def _pairs(single: Iterable[ScoreBoard]) -> Iterable[tuple[ScoreBoard, ScoreRow]]:
    return ((board, row) for board in single for row in board.rows)
