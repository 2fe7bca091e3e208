"""Published numbers next to one's own: the public benchmark's, and those under other protocols."""

from __future__ import annotations

from dynaviz.scores.scores import SCORES
from dynaviz_eval.protocols.points import PublicBenchmark
from dynaviz_eval.published import (
    Match,
    PublishedScores,
    PublishedSource,
    matching,
    published,
    published_by_protocol,
    published_runtimes,
)
from dynaviz_eval.report.boards import ScoreBoard, ScoreRow
from dynaviz_eval.report.by_protocol import ByProtocol
from dynaviz_eval.report.table import ABSENT, Column, Table, Value, count, named, percent

UNLIKE = "Scores of points, of ERASOR's voxels and of FreeDOM's voxels do not compare."


def match(board: ScoreBoard) -> Match | None:
    """The public sequence that the board's sequence may be."""
    breakdown = board.rows[0].result.sections.breakdown
    return matching(board.sequence, [row.index for row in breakdown.frame] if breakdown else [])


def benchmark_table(scores: ByProtocol, board: ScoreBoard, number: int) -> Table | None:
    """Published numbers next to the board's own, which are counted as the public benchmark does if
    they can be.
    """
    known = match(board)
    if known is None:
        return None
    same = PublicBenchmark.info in scores.infos
    here = "here, same protocol [%]" if same else f"here, {board.scoring} [%]"
    columns = [Column("method", number=False)]
    columns += [Column(name, "published [%]", main=name == "AA") for name in SCORES]
    columns += [Column(name, here, main=name == "AA") for name in SCORES]
    columns += [Column("seconds per frame", "published"), Column("source")]
    rows = []
    sources = list(dict.fromkeys(row.source for row in published(known.name)))
    speeds = {speed.method: speed for speed in published_runtimes() if speed.sequence == known.name}
    for row in published(known.name):
        ours = next(
            (
                r
                for r in board.rows
                if r.result.method == row.method and r.result.online == row.online
            ),
            None,
        )
        values = [Value(ABSENT)] * len(SCORES)
        if ours:
            mine = (
                scores.score(ours, PublicBenchmark.info, name) if same else ours.score(name)
                for name in SCORES
            )
            values = [*map(percent, mine)]
        theirs = [percent(getattr(row, name)) for name in SCORES]
        speed = speeds.get(row.method)
        took = (
            Value(f"{speed.mean_s:.3f} ± {speed.std_s:.3f}", speed.mean_s)
            if speed and not row.online
            else Value(ABSENT)
        )
        rows.append(
            [named(row.title), *theirs, *values, took, count(sources.index(row.source) + 1)]
        )
    notes = [
        known.doubt + ("" if known.same else " The published numbers are for different points."),
        "Published scores were copied from their sources and enter no other table or rank. Poses "
        "and parameters may "
        "differ. Published seconds: Intel i9-12900KF.",
    ]
    if not same:
        notes.append(
            "Published scores were computed by nearest neighbour (nn, 0.05 m) from maps written by "
            "other programs; "
            "compared with mask scores, they are only a rough guide."
        )
    notes.append(_listed(sources))
    if any(sum(r.result.method == row.result.method for r in board.rows) > 1 for row in board.rows):
        notes.append("Of several variants of a method, the one with the best AA is shown.")
    return Table(
        f"published-{number}",
        f"Published scores of {known.name}, and {board.title}",
        columns,
        rows,
        notes,
    )


def protocols_table(scores: ByProtocol, board: ScoreBoard, number: int) -> Table | None:
    """Published scores under other protocols, and the board's own under the same ones."""
    rows = published_by_protocol(board.sequence.name)
    if not rows:
        return None
    names = list(dict.fromkeys(name for row in rows for name in row.scores))
    infos = {info.name: info for info in scores.infos}
    sources = list(dict.fromkeys(row.source for row in rows))
    columns = [Column(each, number=False) for each in ("method", "protocol", "sequence")]
    columns += [Column(name, "published [%]", main=name == names[0]) for name in names]
    columns += [Column(name, "here, same protocol [%]", main=name == names[0]) for name in names]
    columns += [Column("source")]
    filled = []
    for row in rows:
        info = infos.get(row.protocol)
        ours = _own(board, row)
        mine = [
            percent(scores.score(ours, info, name)) if ours and info else Value(ABSENT)
            for name in names
        ]
        theirs = [
            percent(row.scores[name]) if name in row.scores else Value(ABSENT) for name in names
        ]
        title = f"{row.title} (learned)" if row.learned else row.title
        protocol = info.title if info else row.protocol
        facts = [named(title), named(protocol), named(row.where)]
        filled.append([*facts, *theirs, *mine, count(sources.index(row.source) + 1)])
    notes = [
        "Published scores were copied from their sources and enter no other table or rank. Poses, "
        f"frames and parameters may differ. {UNLIKE}",
        *([] if infos else ["Own scores under these protocols: dynaviz report --format board."]),
        _listed(sources),
    ]
    title = f"Published scores under other protocols, and {board.title}"
    return Table(f"published-protocols-{number}", title, columns, filled, notes)


def _own(board: ScoreBoard, row: PublishedScores) -> ScoreRow | None:
    """The best row of the board with the method of a published row."""
    return next((each for each in board.rows if each.result.method == row.method), None)


def _listed(sources: list[PublishedSource]) -> str:
    """The sources with their numbers, as a sentence."""
    return "Sources: " + "; ".join(f"{k} {source}" for k, source in enumerate(sources, 1)) + "."
