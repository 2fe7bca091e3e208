"""A report as one page that needs nothing else: tables that sort, figures, and maps from above."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from importlib import resources

from dynaviz.reporting import Study
from dynaviz_eval.report import birdseye, figures
from dynaviz_eval.report.drawing import Palette
from dynaviz_eval.report.tables import Column, tables


def html_report(study: Study) -> str:
    """One page that needs nothing else: tables that sort, figures, and maps from above."""
    from jinja2 import Environment, StrictUndefined

    made = tables(study)
    looks = Palette([cell.method for cell in study.cells])
    labels = list(dict.fromkeys(row.label for board in [*made.combined, *made.boards] for row in board.rows))
    steps, parts = 2 * len(made.boards) + 1, []
    overall = [
        figures.scores(made.boards, looks),
        figures.speed(made.boards, looks),
        figures.causes(made.boards, labels),
    ]
    study.progress("drawing", 1, steps)
    for number, board in enumerate(made.boards):
        drawn = [
            figures.distances(board, f"distances-{number}", looks),
            figures.ranges(board, f"ranges-{number}", looks),
            figures.pareto(board, f"pareto-{number}", looks),
        ]
        study.progress("drawing", 2 * number + 2, steps)
        maps, notes = birdseye.maps(study, board)
        study.progress("drawing", 2 * number + 3, steps)
        parts.append(
            {"board": board, "figures": drawn, "maps": maps, "notes": notes, "published": made.public.get(board.title)}
        )
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"groupwise": groupwise, "starts": starts}
    template = environment.from_string(resources.files(__package__).joinpath("page.html.jinja").read_text("utf-8"))
    return (
        template.render(
            made=made,
            named={table.name: table for table in made.tables},
            scores=overall[0],
            speed=overall[1],
            causes=overall[2],
            parts=parts,
            legend=birdseye.legend(),
        )
        + "\n"
    )


def groupwise(columns: Sequence[Column]) -> list[dict[str, object]]:
    """Names of groups of columns that stand beside each other, and how many columns each has."""
    groups = itertools.groupby(columns, lambda column: column.group)
    return [{"name": name, "span": len(list(members))} for name, members in groups]


def starts(columns: Sequence[Column]) -> list[int]:
    """Columns in which a group begins."""
    return [k for k, (a, b) in enumerate(itertools.pairwise(columns), 1) if b.group and a.group != b.group]
