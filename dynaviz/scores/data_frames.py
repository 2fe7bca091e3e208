"""Rows of results as pandas data frames; pandas is needed only here."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, get_args

import msgspec

from dynaviz.errors import UsageError

if TYPE_CHECKING:
    import pandas

    from dynaviz.scores.sections import Sections

ResultTable = Literal["cases", "objects", "frames", "ranges", "heights", "reasons"]
_CORNERS = {"low", "high"}  # of boxes, three numbers each


def data_frame(rows: Iterable[Mapping[str, Any]]) -> pandas.DataFrame:
    """A data frame with a row for each mapping.

    Raises:
        UsageError: if pandas is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise UsageError(
            "to_pandas() needs pandas, which is not installed. Run 'pip install pandas'"
        ) from None
    return pandas.DataFrame.from_records(list(rows))


def rows_of(sections: Sections, table: ResultTable) -> Iterator[dict[str, Any]]:
    """The rows of a table of a result.

    Raises:
        UsageError: for an unknown table.
    """
    if table not in _TABLES:
        raise UsageError(f"table = {table}: give one of {', '.join(get_args(ResultTable))}")
    return _TABLES[table](sections)


def flat(row: msgspec.Struct, prefix: str = "") -> dict[str, Any]:
    """The fields of a row: those of parts behind the name of the part, and corners by axis."""
    found: dict[str, Any] = {}
    for each in msgspec.structs.fields(row):
        value = getattr(row, each.name)
        name = prefix + each.encode_name
        if isinstance(value, msgspec.Struct):
            found |= flat(value, f"{name}_")
        elif each.name in _CORNERS and isinstance(value, tuple):
            found |= {f"{name}_{axis}": number for axis, number in zip("xyz", value, strict=True)}
        else:
            found[name] = value
    return found


def _cases(sections: Sections) -> Iterator[dict[str, Any]]:
    """The failure cases; of a run without ground truth the clusters of removed points."""
    listed: Sequence[msgspec.Struct] = sections.failures.cases if sections.failures else ()
    if not listed and sections.removals:
        listed = sections.removals.clusters
    for number, case in enumerate(listed, 1):
        yield {"case": number, **flat(case)}


def _breakdown(name: str) -> Callable[[Sections], Iterator[dict[str, Any]]]:
    """The rows of a part of the breakdown, or of that of a run without ground truth."""

    def rows(sections: Sections) -> Iterator[dict[str, Any]]:
        listed = sections.breakdown if sections.has_truth else sections.removals
        yield from map(flat, getattr(listed, name, ()))

    return rows


def _reasons(sections: Sections) -> Iterator[dict[str, Any]]:
    """A row for each reason: its points by outcome, its costs, and what it means."""
    reasons = sections.reasons
    if reasons is None:
        return
    outcomes = ("false_negative", "false_positive", "dynamic_removed", "static_kept")
    by_outcome = {outcome: getattr(reasons, outcome) for outcome in outcomes}
    for name in dict.fromkeys(name for points in by_outcome.values() for name in points):
        cost = reasons.cost.get(name)
        yield {
            "reason": name,
            **{outcome: points.get(name, 0) for outcome, points in by_outcome.items()},
            "cost_SA": None if cost is None else cost.SA,
            "cost_DA": None if cost is None else cost.DA,
            "meaning": reasons.legend.get(name, ""),
        }


_TABLES: Mapping[str, Callable[[Sections], Iterator[dict[str, Any]]]] = {
    "cases": _cases,
    "objects": _breakdown("object"),
    "frames": _breakdown("frame"),
    "ranges": _breakdown("range"),
    "heights": _breakdown("height"),
    "reasons": _reasons,
}
