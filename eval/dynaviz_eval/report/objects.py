"""The fate of each moving object: how much of it each method removed, and why it kept the rest."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from dynaviz.scores.sections import ObjectRow
from dynaviz_eval.report.boards import ScoreBoard, ScoreRow, best_of_each_method
from dynaviz_eval.report.table import ABSENT, NONE, Column, Table, Value, count, many, named

MOST = 20  # objects in a table
HALF = 50.0  # percent: an object of which less was removed is kept

Key = tuple[int | None, int | None]  # class and instance


@dataclass(frozen=True)
class Fate:
    """What one method did to one object.

    The object's counts, and the main reason of the points it kept.
    """

    row: ObjectRow
    reason: str

    @property
    def kept(self) -> bool:
        """Whether the method kept more than half of it."""
        return self.row.DA is not None and self.row.DA < HALF


def object_table(board: ScoreBoard, number: int) -> Table:
    """One row per object, the objects with the most points at stake first."""
    runs = [row for row in best_of_each_method(board) if _objects(row)]
    fates = {run.label: _fates(run) for run in runs}
    keys = sorted(
        {key for by in fates.values() for key in by}, key=lambda key: _at_stake(key, fates.values())
    )
    wrong = [key for key in keys if _at_stake(key, fates.values())[0] < 0]
    names = class_names(runs)
    columns = [
        Column("object", number=False),
        Column("frames"),
        Column("points"),
        Column("kept by", number=False),
    ]
    columns += [Column(run.label, "removed by each method [%]") for run in runs]
    rows = [_row(key, [fates[run.label].get(key) for run in runs], names) for key in wrong[:MOST]]
    notes = [
        f"Kept: less than {HALF:.0f} % of the object's dynamic points were removed. Reasons: "
        "different main reasons of "
        "the methods that kept it. Points: dynamic points of all frames.",
        "Objects on which many points are wrong, or on which the methods disagree, come first"
        + (
            f"; {many(len(wrong) - MOST, 'object')} with errors not listed."
            if len(wrong) > MOST
            else "."
        ),
    ]
    details = "Next to each share: the main reason of the points that were kept."
    return Table(f"objects-{number}", f"Objects: {board.title}", columns, rows, notes, details)


def class_names(runs: Iterable[ScoreRow]) -> dict[int, str]:
    """Names of the classes of moving objects, from the failure cases of all methods."""
    return {
        case.class_: case.what
        for run in runs
        for case in run.result.failures
        if case.kind == "false_negative" and case.class_ is not None and case.what
    }


def _objects(run: ScoreRow) -> tuple[ObjectRow, ...]:
    breakdown = run.result.sections.breakdown
    return breakdown.object if breakdown else ()


def _fates(run: ScoreRow) -> dict[Key, Fate]:
    """What a run did to each object."""
    fates = {}
    for row in _objects(run):
        reasons = row.reasons or {}
        fates[_key(row)] = Fate(row, max(reasons, key=lambda name: reasons[name], default=""))
    return fates


def _key(of: ObjectRow) -> Key:
    return of.class_, of.instance or None


def _at_stake(key: Key, fates: Iterable[Mapping[Key, Fate]]) -> tuple[float, int, int]:
    """Sort key: the most points that a method kept, and the disagreement of the methods, largest
    first.
    """
    kept = [by[key].row.dynamic_kept for by in fates if key in by]
    return -(2 * max(kept) - min(kept)), key[0] or 0, key[1] or 0


def _row(key: Key, fates: Sequence[Fate | None], names: Mapping[int, str]) -> list[Value]:
    of_class, instance = key
    name = names.get(of_class, f"class {of_class}") if of_class else "object"
    known = [fate for fate in fates if fate]
    by = [fate for fate in known if fate.kept]
    reasons = {fate.reason for fate in by if fate.reason}
    verdict = f"{len(by)} of {many(len(known), 'method')}"
    if reasons:
        verdict += f", for {many(len(reasons), 'reason')}"
    first, last = (edge(getattr(fate.row, name) for fate in known) for edge, name in _FRAMES)
    points = known[0].row.dynamic_removed + known[0].row.dynamic_kept
    label = f"{name} {instance}" if instance else name
    return [
        named(label),
        Value(f"{first}–{last}", first),
        count(points),
        Value(verdict, len(by)),
        *(_cell(fate) for fate in fates),
    ]


_FRAMES = ((min, "first_frame"), (max, "last_frame"))


def _cell(fate: Fate | None) -> Value:
    if fate is None:
        return Value(ABSENT)
    share = fate.row.DA
    if share is None:
        return Value(NONE)
    reason = fate.reason.replace("_", " ") if fate.row.dynamic_kept else ""
    return Value(f"{share:.0f}", share, heat=round(1 - share / 100, 2), detail=reason)
