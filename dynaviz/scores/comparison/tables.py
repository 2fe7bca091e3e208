"""A comparison as tables: in the terminal, and as Markdown in its recording."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynaviz.scores.comparison.counts import WRONG
from dynaviz.scores.comparison.objects import ObjectChange, ObjectFate
from dynaviz.scores.comparison.pair import (
    Agreement,
    ComparedRun,
    FrameChange,
    PairComparison,
    PlaceChange,
    RangeAgreement,
    RemovalComparison,
)
from dynaviz.scores.comparison.settings import text
from dynaviz.scores.comparison.surfaces import SurfaceChange
from dynaviz.scores.looks import Estimate
from dynaviz.scores.scores import SCORES

if TYPE_CHECKING:
    from rich.console import RenderableType

LISTED = 8  # reasons in a table, at most


@dataclass(frozen=True)
class TableSection:
    """A table with a title and a note."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def sections(
    runs: Sequence[ComparedRun], pairs: Sequence[PairComparison]
) -> Iterator[TableSection]:
    """All tables; details only for two runs.

    Args:
        runs: all runs.
        pairs: the first run against each other run.
    """
    unscored = [
        (run, pair.removed) for run, pair in zip(runs[1:], pairs, strict=True) if pair.removed
    ]
    if unscored:
        for run, removed in unscored:
            yield _removed_by_range(runs[0], run, removed)
            yield _removal_reasons(runs[0], run, removed)
    elif len(pairs) == 1:
        first, second, pair = *runs, pairs[0]
        yield _scores_of_two(first, second, pair)
        yield from _ceilings(runs)
        yield _agreement(first, second, pair)
        yield _reasons(pair)
        if pair.objects:
            yield _objects(pair.objects)
        yield _frames(pair)
        if pair.surfaces:
            yield _surfaces(pair.surfaces)
        else:
            yield _places(pair)
    else:
        yield _scores_of_many(runs, pairs)
        yield from _ceilings(runs)
    for run, pair in zip(runs[1:], pairs, strict=True):
        yield _settings(runs[0], run, pair)


def markdown(section: TableSection) -> str:
    """A table as Markdown."""
    lines = [section.head, ("---",) + ("---:",) * (len(section.head) - 1), *section.rows]
    table = "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in lines
    )
    parts = [f"### {section.title}", table if section.rows else "", section.note]
    return "\n\n".join(part for part in parts if part)


def renderable(section: TableSection) -> RenderableType:
    """A table for the terminal; its title and note if it is empty."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    if not section.rows:
        return f"[italic]{section.title}[/]: {escape(section.note)}"
    table = Table(
        title=section.title,
        title_justify="left",
        caption=section.note or None,
        caption_justify="left",
    )
    table.box = box.SIMPLE_HEAD
    table.padding = (0, 1, 0, 0)
    table.pad_edge = False
    table.min_width = 60
    for i, name in enumerate(section.head):
        table.add_column(escape(name), justify="right" if i else "left", no_wrap=True)
    for row in section.rows:
        table.add_row(*map(escape, row))
    return table


_SCORES_NOTE = (
    "SA, DA: static points kept, dynamic points removed, in %; FP: static points removed, "
    "FN: dynamic points kept. Intervals of 95 %: over frames, blocks of frames are drawn again; "
    "over movers, the objects that moved; the same for both runs"
)


def _scores_of_two(first: ComparedRun, second: ComparedRun, pair: PairComparison) -> TableSection:
    rows = [
        (name, _number(score.first, name), _number(score.second, name), _signed(score.delta, name),
         _interval(score.interval, name), _over_movers(pair, name))
        for name, score in pair.scores.items()
    ]  # fmt: skip
    return TableSection(
        "Scores",
        ("", first.label, second.label, "B - A", "over frames", "over movers"),
        tuple(rows),
        _SCORES_NOTE,
    )


def _scores_of_many(runs: Sequence[ComparedRun], pairs: Sequence[PairComparison]) -> TableSection:
    head = ("run", *SCORES, *WRONG, "AA - A's", "over frames", "over movers")
    AAs = [pair.scores.AA for pair in pairs]
    changes = [
        ("", "", ""),
        *(
            (_signed(AA.delta, "AA"), _interval(AA.interval, "AA"), _over_movers(pair, "AA"))
            for AA, pair in zip(AAs, pairs, strict=True)
        ),
    ]
    rows = [
        (run.label, *(_number(value, name) for name, value in run.scores.items()), *change)
        for run, change in zip(runs, changes, strict=True)
    ]
    return TableSection("Scores", head, tuple(rows), _SCORES_NOTE)


_PARTS = {
    "possible": "possible DA",
    "removed_seen": "removed, with evidence",
    "removed_unseen": "removed, without",
    "kept_seen": "kept, with evidence",
    "kept_unseen": "kept, without",
}


def _ceilings(runs: Sequence[ComparedRun]) -> Iterator[TableSection]:
    """What the drive allows, and what each run made of it; nothing if no run knows."""
    known = [run.ceiling for run in runs]
    if not any(ceiling and ceiling.possible for ceiling in known):
        return
    rows = [
        (words, *(_estimate(getattr(ceiling, part, None)) for ceiling in known))
        for part, words in _PARTS.items()
    ]
    note = (
        "In % of the dynamic points. A point has evidence if another scan saw through its place; "
        "the possible DA is the same for every method"
    )
    head = ("", *(run.label for run in runs))
    yield TableSection("What the drive showed of moving objects", head, tuple(rows), note)


def _estimate(value: Estimate | None) -> str:
    return "n/a" if value is None else str(value)


def _over_movers(pair: PairComparison, name: str) -> str:
    """The interval over drawn movers; empty for scores that do not depend on movers."""
    return _interval(pair.over_movers.get(name), name) if name in ("DA", "AA") else ""


def _agreement(first: ComparedRun, second: ComparedRun, pair: PairComparison) -> TableSection:
    head = ("points", f"only {first.label}", f"only {second.label}", "neither", "both")
    total = RangeAgreement("all", pair.right.static, pair.right.dynamic)
    bands = (total, *pair.by_range)
    rows = [_counts(f"static, {band.band}", band.static) for band in bands]
    rows += [_counts(f"dynamic, {band.band}", band.dynamic) for band in bands]
    return TableSection("Correctly labelled points, by range from the sensor", head, tuple(rows))


def _counts(name: str, points: Agreement) -> tuple[str, ...]:
    return name, *(
        f"{n:,}" for n in (points.only_first, points.only_second, points.neither, points.both)
    )


_CORRECT = {"only_first": "only A", "only_second": "only B", "neither": "neither"}


def _reasons(pair: PairComparison) -> TableSection:
    rows = [
        (
            _CORRECT[row.right],
            row.truth,
            row.first_reason or "correct",
            row.second_reason or "correct",
            f"{row.points:,}",
        )
        for row in pair.by_reason[:LISTED]
    ]
    return TableSection(
        "Errors by reason", ("correct", "point", "A's reason", "B's reason", "points"), tuple(rows)
    )


def _removed_by_range(
    first: ComparedRun, second: ComparedRun, removed: RemovalComparison
) -> TableSection:
    head = ("points", f"only {first.label}", "only "
    f"{second.label}", "neither", "both", f"{first.letter} in %",
            f"{second.letter} in %")  # fmt: skip
    rows = []
    for name, points in (
        ("all", removed.points),
        *((row.band, row.points) for row in removed.by_range),
    ):
        shares = ("n/a" if math.isnan(share) else f"{share:.2f}" for share in points.shares)
        rows.append((*_counts(name, points), *shares))
    note = "There is no ground truth, so it is unknown which points were removed rightly"
    return TableSection("Removed points, by range from the sensor", head, tuple(rows), note)


def _removal_reasons(
    first: ComparedRun, second: ComparedRun, removed: RemovalComparison
) -> TableSection:
    a = first.letter
    b = second.letter
    only = {"only_first": f"only {a}", "only_second": f"only {b}"}
    rows = [
        (only[row.removed_by], row.first_reason, row.second_reason, f"{row.points:,}")
        for row in removed.by_reason[:LISTED]
    ]
    note = "" if rows else "both runs removed the same points"
    head = ("removed by", f"{a}'s reason", f"{b}'s reason", "points")
    return TableSection("What one run removed and the other kept", head, tuple(rows), note)


_CHANGES = ("better", "SA gain", "DA gain", "FP A", "FP B", "FN A", "FN B")


def _frames(pair: PairComparison) -> TableSection:
    rows = [(f"{row.frame}", *_change(row)) for row in pair.frames]
    note = (
        "Gain: how much less B loses than A, in percentage points of SA and of DA; summed over all "
        "frames it is B - A"
    )
    return TableSection("Frames that change most", ("frame", *_CHANGES), tuple(rows), note)


def _objects(objects: Sequence[ObjectChange]) -> TableSection:
    head = (
        "object",
        "frames",
        "points",
        "A removed",
        "B removed",
        "DA gain",
        "why the rest is kept",
    )
    rows = [
        (
            each.what,
            f"{each.first_frame}-{each.last_frame}",
            f"{each.points:,}",
            f"{each.first.removed:.0f} %",
            f"{each.second.removed:.0f} %",
            f"{each.gain_DA:+.2f}",
            _why_kept(each),
        )
        for each in objects
    ]
    note = "Of the run that removed less: its case, and the cause that was measured there"
    return TableSection("Moving objects that change most", head, tuple(rows), note)


def _why_kept(change: ObjectChange) -> str:
    """Why the run that removed less kept the rest."""
    letter = "A" if change.gain_DA > 0 else "B"
    worse: ObjectFate = change.first if change.gain_DA > 0 else change.second
    if worse.case is None:
        return "not among the listed cases"
    return f"{letter} case {worse.case}: {worse.cause or 'unknown'}"


def _surfaces(surfaces: Sequence[SurfaceChange]) -> TableSection:
    head = ("#", "surface", "frames", "A lost [SA]", "B lost [SA]", "SA gain", "why it is removed")
    rows = [
        (
            f"{number}",
            each.what,
            f"{each.first_frame}-{each.last_frame}",
            f"{each.first.lost:.2f}",
            f"{each.second.lost:.2f}",
            f"{each.gain_SA:+.2f}",
            _why_removed(each),
        )
        for number, each in enumerate(surfaces, 1)
    ]
    note = (
        "By the listed cases. Of the run that removed more: its case, and the cause that was "
        "measured there"
    )
    return TableSection("Static surfaces that change most", head, tuple(rows), note)


def _why_removed(change: SurfaceChange) -> str:
    """Why the run that removed more did so."""
    letter = "A" if change.gain_SA > 0 else "B"
    worse = change.first if change.gain_SA > 0 else change.second
    return f"{letter} case {worse.case}: {worse.cause or 'unknown'}"


def _places(pair: PairComparison) -> TableSection:
    """Places; only those with static points in question if moving objects are listed by name."""
    title = "Static places that change most" if pair.objects else "Places that change most"
    if pair.places is None:
        return TableSection(title, ("place",), (), pair.places_note)
    rows = [
        (f"{number}", f"{row.low[0]:g}, {row.low[1]:g}", f"{row.frame}", *_change(row))
        for number, row in enumerate(pair.places, 1)
        if row.gain_SA or not pair.objects
    ]
    return TableSection(title, ("#", "x, y [m]", "frame", *_CHANGES), tuple(rows), pair.places_note)


def _change(row: FrameChange | PlaceChange) -> tuple[str, ...]:
    counts: Iterable[int] = (row.first.FP, row.second.FP, row.first.FN, row.second.FN)
    better = "B" if row.gain > 0 else "A"
    return better, f"{row.gain_SA:+.2f}", f"{row.gain_DA:+.2f}", *(f"{n:,}" for n in counts)


def _settings(first: ComparedRun, second: ComparedRun, pair: PairComparison) -> TableSection:
    a = first.letter
    b = second.letter
    rows = [(row.name, text(row.first), text(row.second)) for row in pair.differ]
    notes = list(pair.runtime.notes)
    if pair.runtime.ratio is not None:
        notes.insert(0, f"{b} takes {pair.runtime.ratio:.2f} times as long per frame as {a}")
    return TableSection(
        f"Settings that differ: {a}, {b}", ("setting", a, b), tuple(rows), "; ".join(notes)
    )


def _number(value: float | None, name: str, sign: str = "") -> str:
    if value is None:
        return "n/a"
    return f"{value:{sign},.0f}" if name in WRONG else f"{value:{sign}.2f}"


def _signed(value: float | None, name: str) -> str:
    return _number(value, name, "+")


def _interval(interval: tuple[float, float] | None, name: str) -> str:
    return "n/a" if interval is None else " to ".join(_signed(end, name) for end in interval)
