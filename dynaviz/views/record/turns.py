"""What other parameters would change in a run: its sample of points, a table, and curves.

On the timeline ``what_if``, each index is one value of one parameter; the others are as in the run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import rerun as rr

from dynaviz import colours
from dynaviz.explain.dial import SCORES, EstimatedScore, PointSample, pack
from dynaviz.explain.words import number
from dynaviz.views import paths, stored_ledgers
from dynaviz.views.record.sink import RecordingFile

VALUES = 9  # of each parameter
HEAD = "| parameter | value | SA [%] | DA [%] |\n|---|---|---|---|\n"
TEXT = (
    "One parameter changes, the others are as in this run. Each score is estimated from a sample "
    "of the points, and lies within ± in 95 % of cases. What else a parameter changes is not part "
    "of it.\n\n"
)

Turn = tuple[str, float, Mapping[str, EstimatedScore]]


def write(sink: RecordingFile, sample: PointSample) -> None:
    """Write a sample, and what it tells about other values of each parameter."""
    packed = stored_ledgers.component(pack(sample), stored_ledgers.SAMPLE)
    sink.log(paths.SAMPLE, packed, static=True)
    turns = [
        (each.name, value, sample.scores({each.name: value}))
        for each in sample.parameters
        for value in each.values(VALUES)
    ]
    sink.log(paths.WHAT_IF, _markdown(TEXT + table(turns, sample.given)), static=True)
    for name in SCORES:
        _curves(sink, name, [found for *_, scores in turns if (found := scores.get(name))])
    texts = [_line(turn) for turn in turns]
    columns = rr.TextDocument.columns(text=texts)
    sink.case_columns(paths.WHAT_IF_VALUE, range(len(texts)), columns, paths.WHAT_IF)


def table(turns: Sequence[Turn], given: Mapping[str, float]) -> str:
    """The turns as a Markdown table; bold: as in the run."""
    rows = []
    for name, value, scores in turns:
        mark = "**" if value == given[name] else ""
        cells = [name, number(value), *(_score(scores, each) for each in SCORES)]
        rows.append(f"| {' | '.join(f'{mark}{cell}{mark}' for cell in cells)} |\n")
    return HEAD + "".join(rows)


def _score(scores: Mapping[str, EstimatedScore], name: str) -> str:
    found = scores.get(name)
    return "-" if found is None else str(found) if found.whisker else f"{found.value:.1f}"


def _line(turn: Turn) -> str:
    name, value, scores = turn
    return (
        f"{name} {number(value)}: {', '.join(f'{each} {found}' for each, found in scores.items())}"
    )


def _curves(sink: RecordingFile, name: str, found: Sequence[EstimatedScore]) -> None:
    """A score over all turns, and its whiskers."""
    whiskers = {
        name: [each.value for each in found],
        f"{name} at least": [each.value - each.whisker for each in found],
        f"{name} at most": [each.value + each.whisker for each in found],
    }
    for label, values in whiskers.items():
        path = f"{paths.WHAT_IF_SCORE}/{label.replace(' ', '_')}"
        width = 2.0 if label == name else 0.7
        style = rr.SeriesLines(colors=colours.SCORES[name], widths=width, names=label)
        sink.log(path, style, static=True)
        columns = rr.Scalars.columns(scalars=values)
        sink.case_columns(path, range(len(values)), columns, paths.WHAT_IF)


def _markdown(text: str) -> rr.TextDocument:
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
