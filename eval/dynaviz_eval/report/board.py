"""The page of a board: methods by sequences by protocols, published figures apart, failure cases, and digests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dynaviz.contracts.protocol import ProtocolInfo, ProtocolScores
from dynaviz.reports.reporting import Study
from dynaviz_eval.protocols.moving import SemanticKittiMos
from dynaviz_eval.protocols.points import PointsProtocol, PublicBenchmark
from dynaviz_eval.published import Match, published
from dynaviz_eval.report import birdseye
from dynaviz_eval.report.boards import ScoreBoard, ScoreRow, best_of_each_method, boards
from dynaviz_eval.report.gallery import gallery
from dynaviz_eval.report.html import rendered
from dynaviz_eval.report.spots import case_table, note, shared_cases
from dynaviz_eval.report.table import ABSENT, NONE, Column, Table, Value, count, many, named, percent
from dynaviz_eval.report.tables import failed_table, match

DIGITS = 12  # of a digest; board.json has all of them


@dataclass(frozen=True)
class Boards:
    """A board's sequences, and the scores of each row.

    Attributes:
        study: the input.
        boards: one per sequence and scoring.
        infos: of the protocols, in the order of the columns.
    """

    study: Study
    boards: Sequence[ScoreBoard]
    infos: Sequence[ProtocolInfo]

    def scores(self, row: ScoreRow) -> Mapping[str, ProtocolScores]:
        """The scores of a row by protocol; those of its result under ``points`` if it was not scored."""
        assert row.run is not None
        known = self.study.scores.get(row.run.file, {})
        return known or {PointsProtocol.info.name: ProtocolScores(row.result.metrics)}

    def score(self, row: ScoreRow, info: ProtocolInfo, name: str) -> float | None:
        """A score in percent; None if undefined or unknown."""
        found = self.scores(row).get(info.name)
        return found.scores.get(name) if found else None

    def best(self, board: ScoreBoard, info: ProtocolInfo, name: str) -> float | None:
        """The highest score of a sequence, rounded as printed; None for a single row."""
        known = [round(s, 2) for row in board.rows if (s := self.score(row, info, name)) is not None]
        return max(known) if len(board.rows) > 1 and known else None

    def value(self, board: ScoreBoard, row: ScoreRow, info: ProtocolInfo, name: str) -> Value:
        """A field of a table."""
        score = self.score(row, info, name)
        return percent(score, score is not None and round(score, 2) == self.best(board, info, name))


def board_report(study: Study) -> str:
    """The page of a board: methods by sequences by protocols, failure cases, and the digests of all entries."""
    content = Boards(study, boards(study), _ordered(study))
    parts = []
    for number, board in enumerate(content.boards, 1):
        study.progress("draw", number - 1, len(content.boards))
        parts.append(_part(content, board, number))
    study.progress("draw", len(content.boards), len(content.boards))
    return rendered(
        "board.html.jinja",
        headline=_headline(content),
        best=_best(content),
        across=_across(content),
        protocols=protocol_table(content.infos),
        parts=parts,
        entries=_entries(content),
        failed=failed_table(study),
    )


def _ordered(study: Study) -> list[ProtocolInfo]:
    """The protocol of dynaviz and the public benchmark's first, all others by name."""
    first = (PointsProtocol.info.name, PublicBenchmark.info.name)
    infos = [protocol.info for protocol in study.protocols.values()]
    return sorted(infos, key=lambda info: (first.index(info.name) if info.name in first else 9, info.name))


def _headline(content: Boards) -> str:
    runs = [row for board in content.boards for row in board.rows]
    methods = {row.result.method for row in runs}
    sequences = {board.sequence.digest for board in content.boards}
    return (
        f"{many(len(runs), 'run')} of {many(len(methods), 'method')} on {many(len(sequences), 'sequence')}, "
        f"counted under {many(len(content.infos), 'protocol')} from the stored labels."
    )


def _best(content: Boards) -> list[str]:
    """The best of each sequence under each protocol."""
    lines = []
    for board in content.boards:
        for info in content.infos:
            top = content.best(board, info, info.scores[0])
            rows = [row for row in board.rows if (s := content.score(row, info, info.scores[0])) and round(s, 2) == top]
            if top is not None and rows:
                where = f" on {board.title}" if len(content.boards) > 1 else ""
                names = " and ".join(row.label for row in rows)
                lines.append(f"{info.title}{where}: {names}, {info.scores[0]} {top:.2f}\N{NO-BREAK SPACE}%")
    return lines


def protocol_table(infos: Sequence[ProtocolInfo]) -> Table:
    """What each protocol counts."""
    columns = [Column(name, number=False) for name in ("protocol", "counts", "leaves out", "combines", "source")]
    rows = [
        [Value(info.title, info.title), *(Value(t, t) for t in (info.counts, info.ignores, info.combines, info.source))]
        for info in infos
    ]
    notes = [
        "IoU, precision and recall: of the moving points. PR: static voxels kept. RR: dynamic voxels removed. F1: "
        "harmonic mean of both. SA: static points kept. DA: dynamic points removed. AA = √(SA · DA). All in percent.",
        "Scores of different protocols cannot be compared with each other.",
    ]
    return Table("protocols", "What each protocol counts", columns, rows, notes)


def _part(content: Boards, board: ScoreBoard, number: int) -> dict[str, object]:
    """The section of a sequence."""
    found, notes = birdseye.overviews(content.study, board)
    cases = shared_cases(board)
    labels = [row.label for row in best_of_each_method(board)]
    return {
        "board": board,
        "split": _split(board),
        "main": _main_scores(content, board, number),
        "scores": _all_scores(content, board, number),
        "published": _published(content, board, number),
        "case_list": case_table(board, cases, number),
        "gallery": gallery(cases, labels, found),
        "gallery_note": note(board.has_truth),
        "legend": birdseye.legend(board.has_truth),
        "notes": notes,
    }


def _split(board: ScoreBoard) -> str:
    """The split of SemanticKITTI-MOS that the sequence is in, as a sentence; empty if it is in none."""
    name = board.sequence.name.removeprefix("semantickitti_")
    for split, numbers in SemanticKittiMos.info.splits.items():
        if name in numbers and name != board.sequence.name:
            return f"In the split {split} of SemanticKITTI-MOS."
    return ""


def _main_scores(content: Boards, board: ScoreBoard, number: int) -> Table:
    """One row per run, one column per protocol: its main score."""
    columns = [Column("method", number=False), *(Column(info.scores[0], info.title) for info in content.infos)]
    rows = []
    for row in board.rows:
        assert row.run is not None
        remark = content.study.remarks.get(row.run.file, "")
        values = [content.value(board, row, info, info.scores[0]) for info in content.infos]
        rows.append([Value(row.label, row.label, detail=remark), *values])
    notes = ["The main score of each protocol in percent, measured here. The best of each column is bold."]
    if any(row.result.sections.source for row in board.rows):
        notes.append("Voxels of a map of another program: those of the points that it keeps.")
    return Table(f"main-{number}", f"Main scores: {board.title}", columns, rows, notes)


def _all_scores(content: Boards, board: ScoreBoard, number: int) -> Table:
    """One row per run, one group of columns per protocol."""
    pairs = [(info, name) for info in content.infos for name in info.scores]
    columns = [Column(name, info.title, main=name == info.scores[0]) for info, name in pairs]
    rows = [[named(row.label), *(content.value(board, row, *pair) for pair in pairs)] for row in board.rows]
    title = f"All scores: {board.title}"
    return Table(f"scores-{number}", title, [Column("method", number=False), *columns], rows)


def _across(content: Boards) -> list[Table]:
    """A table for each scoring and protocol: methods by sequences, with the sequences combined as the protocol does."""
    scorings = dict.fromkeys(board.scoring for board in content.boards)
    groups = [[board for board in content.boards if board.scoring == scoring] for scoring in scorings]
    return [_by_sequence(content, group, info) for group in groups if len(group) > 1 for info in content.infos]


def _by_sequence(content: Boards, group: Sequence[ScoreBoard], info: ProtocolInfo) -> Table:
    """Methods by sequences of one scoring, with the main score of a protocol."""
    main, scoring = info.scores[0], group[0].scoring
    columns = [Column("method", number=False), *(Column(board.title, f"{main} [%] ↑") for board in group)]
    columns.append(Column("all", f"{main} [%] ↑", main=True))
    rows = []
    for label in dict.fromkeys(row.label for board in group for row in board.rows):
        here = [(board, board.row(label)) for board in group]
        row = [content.value(board, found, info, main) if found else Value(ABSENT) for board, found in here]
        rows.append([named(label), *row, _combined(content, [found for _, found in here], info)])
    notes = [f"All: {info.combines}; only for methods with scores on every sequence. Scoring: {scoring}."]
    return Table(f"across-{info.name}-{scoring}", info.title, columns, rows, notes)


def _combined(content: Boards, rows: Sequence[ScoreRow | None], info: ProtocolInfo) -> Value:
    """The main score of a method over all sequences."""
    parts = [content.study.scores.get(row.run.file, {}).get(info.name) for row in rows if row and row.run]
    known = [part for part in parts if part is not None]
    if len(known) < len(rows):
        return Value(ABSENT)
    return percent(content.study.protocols[info.name].combine(known).scores.get(info.scores[0]))


def _published(content: Boards, board: ScoreBoard, number: int) -> Table | None:
    """Published figures of the sequence, next to those measured here under the same protocol."""
    known = match(board)
    if known is None or PublicBenchmark.info.name not in {info.name for info in content.infos}:
        return None
    names = ("SA", "DA", "AA", "HA")
    columns = [Column("method", number=False)]
    columns += [Column(name, "published, not measured here [%]", main=name == "AA") for name in names]
    columns += [Column(name, "measured here, same protocol [%]", main=name == "AA") for name in names]
    columns += [Column("source", number=False)]
    rows = []
    for each in published(known.name):
        mine = next((r for r in board.rows if (r.result.method, r.result.online) == (each.method, each.online)), None)
        values = [percent(content.score(mine, PublicBenchmark.info, n)) if mine else Value(ABSENT) for n in names]
        theirs = [percent(getattr(each, name)) for name in names]
        rows.append([Value(each.title, each.title), *theirs, *values, Value(each.source, each.source)])
    title = f"Published figures of {known.name}"
    return Table(f"published-{number}", title, columns, rows, _published_notes(known))


def _published_notes(known: Match) -> list[str]:
    return [
        known.doubt + ("" if known.same else " The published figures are for different points."),
        "Published figures were copied from their sources. They are in this table only, and enter no other table, rank "
        "or mark. Poses and parameters may differ.",
    ]


def _entries(content: Boards) -> Table:
    """Every run with its digests and the paths of its files."""
    columns = [Column(name, number=False) for name in ("entry", "sequence", "scoring")] + [Column("frames")]
    columns += [Column(name, "first digits of the digest", number=False) for name in ("points", "labels", "recording")]
    columns += [Column(name, number=False) for name in ("result", "recording")]
    rows = []
    for board in content.boards:
        for row in board.rows:
            assert row.run is not None
            result, recording = row.result, row.run.recording
            digests = (result.sequence.digest, result.labels_sha256, result.recording_sha256)
            path = content.study.link(recording) if recording else ""
            file = content.study.link(row.run.file)
            rows.append(
                [
                    Value(row.label, row.label, detail=result.command),
                    Value(result.sequence.name, result.sequence.name),
                    Value(result.scoring, result.scoring),
                    count(result.sequence.frames),
                    *(Value((digest or NONE)[:DIGITS], digest) for digest in digests),
                    Value("result.json", file, link=file),
                    Value("run.rrd" if path else "none", path, link=path),
                ]
            )
    notes = [
        "Points: digest of points, poses and ground truth of all frames. board.json next to this page has all digests "
        "in full, all counts, and the parameters.",
        "To compute the scores again from the stored labels: dynaviz report FOLDER --format board -o NEW. "
        "To view a recording: dynaviz view PATH.",
    ]
    return Table("entries", "Entries and digests", columns, rows, notes)
