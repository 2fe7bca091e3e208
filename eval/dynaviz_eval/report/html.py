"""A report as a self-contained HTML page.

Sortable tables, figures, maps, and a gallery of failure cases.
"""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Sequence
from importlib import resources
from typing import Any

from dynaviz.colours import span_colours, web
from dynaviz.reports.reporting import Study
from dynaviz.scores.spans import shared_objects
from dynaviz_eval.report import birdseye, figures
from dynaviz_eval.report.boards import ScoreBoard, ScoreRow, best_of_each_method, by_method
from dynaviz_eval.report.ceilings import ceiling_figure
from dynaviz_eval.report.gallery import gallery
from dynaviz_eval.report.spots import note
from dynaviz_eval.report.table import Column
from dynaviz_eval.report.tables import BoardTables, tables

OBJECTS = 12  # drawn over time


def html_report(study: Study) -> str:
    """A self-contained HTML page.

    Sortable tables, figures, maps, and a gallery of failure cases.
    """
    content = tables(study)
    steps = len(content.boards) + 1
    study.progress("drawing", 1, steps)
    parts = []
    for number, (board, of_board) in enumerate(zip(content.boards, content.by_board, strict=True)):
        parts.append(_part(study, board, of_board, number))
        study.progress("drawing", number + 2, steps)
    scores = figures.scores(content.boards)
    speed = figures.speed(content.boards)
    runs = {label: commands(study, rows) for (label, _), rows in by_method(content.boards).items()}
    return _rendered(content=content, scores=scores, speed=speed, parts=parts, runs=runs)


def commands(study: Study, rows: Sequence[ScoreRow]) -> list[dict[str, str]]:
    """How to explore the recorded runs of a method.

    Of each its sequence, the command, and a link to the recording.
    """
    return [
        {
            "sequence": row.result.sequence.name,
            "command": f"dynaviz explore {shlex.quote(study.link(row.run.folder))}",
            "recording": study.link(row.run.recording),
        }
        for row in rows
        if row.run is not None and row.run.recording is not None
    ]


def _rendered(**values: Any) -> str:
    """The page from its template."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"groupwise": groupwise, "starts": starts}
    template = resources.files(__package__).joinpath("page.html.jinja").read_text("utf-8")
    return environment.from_string(template).render(**values) + "\n"


def _part(study: Study, board: ScoreBoard, of_board: BoardTables, number: int) -> dict[str, object]:
    """The section of a sequence."""
    found, notes = birdseye.overviews(study, board)
    labels = [row.label for row in best_of_each_method(board)]
    return {
        "board": board,
        "tables": of_board,
        "figures": {
            "ceiling": ceiling_figure(board, f"evidence-{number}"),
            "distances": figures.distances(board, f"distances-{number}"),
            "ranges": figures.accuracy_by(board, f"ranges-{number}", "range"),
            "heights": figures.accuracy_by(board, f"heights-{number}", "height"),
            "pareto": figures.pareto(board, f"pareto-{number}"),
        },
        "maps": birdseye.maps(board, found),
        "gallery": gallery(of_board.cases, labels, found),
        "gallery_note": note(board.has_truth),
        "legend": birdseye.legend(board.has_truth),
        "objects": shared_objects(
            {row.label: row.result.failures for row in best_of_each_method(board)}
        )[:OBJECTS],
        "states": {state: web(colour) for state, colour in span_colours(ghost=True).items()},
        "notes": notes,
    }


def groupwise(columns: Sequence[Column]) -> list[dict[str, object]]:
    """Names of adjacent groups of columns, with their numbers of columns."""
    groups = itertools.groupby(columns, lambda column: column.group)
    return [{"name": name, "span": len(list(members))} for name, members in groups]


def starts(columns: Sequence[Column]) -> list[int]:
    """Indices of the columns in which a group starts."""
    return [
        k
        for k, (a, b) in enumerate(itertools.pairwise(columns), 1)
        if b.group and a.group != b.group
    ]
