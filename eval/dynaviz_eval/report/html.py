"""A report as a self-contained HTML page: sortable tables, figures, and bird's-eye maps."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from importlib import resources

from dynaviz.reporting import Study
from dynaviz_eval.report import birdseye, figures
from dynaviz_eval.report.drawing import Palette
from dynaviz_eval.report.tables import Column, tables


def html_report(study: Study) -> str:
    """A self-contained HTML page: sortable tables, figures, and bird's-eye maps."""
    from jinja2 import Environment, StrictUndefined

    content = tables(study)
    palette = Palette([run.method for run in study.runs])
    labels = list(dict.fromkeys(row.label for board in [*content.combined, *content.boards] for row in board.rows))
    steps, parts = 2 * len(content.boards) + 1, []
    overall = [
        figures.scores(content.boards, palette),
        figures.speed(content.boards, palette),
        figures.causes(content.boards, labels),
    ]
    study.progress("drawing", 1, steps)
    for number, board in enumerate(content.boards):
        drawn = [
            figures.distances(board, f"distances-{number}", palette),
            figures.ranges(board, f"ranges-{number}", palette),
            figures.pareto(board, f"pareto-{number}", palette),
        ]
        study.progress("drawing", 2 * number + 2, steps)
        maps, notes = birdseye.maps(study, board)
        study.progress("drawing", 2 * number + 3, steps)
        parts.append(
            {
                "board": board,
                "figures": drawn,
                "maps": maps,
                "notes": notes,
                "published": content.public.get(board.title),
            }
        )
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"groupwise": groupwise, "starts": starts}
    template = environment.from_string(resources.files(__package__).joinpath("page.html.jinja").read_text("utf-8"))
    return (
        template.render(
            content=content,
            named={table.name: table for table in content.tables},
            scores=overall[0],
            speed=overall[1],
            causes=overall[2],
            parts=parts,
            legend=birdseye.legend(),
        )
        + "\n"
    )


def groupwise(columns: Sequence[Column]) -> list[dict[str, object]]:
    """Names of adjacent groups of columns, with their numbers of columns."""
    groups = itertools.groupby(columns, lambda column: column.group)
    return [{"name": name, "span": len(list(members))} for name, members in groups]


def starts(columns: Sequence[Column]) -> list[int]:
    """Indices of the columns in which a group starts."""
    return [k for k, (a, b) in enumerate(itertools.pairwise(columns), 1) if b.group and a.group != b.group]
