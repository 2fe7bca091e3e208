"""Scores under every protocol.

Methods by protocols for each sequence, and by sequences for each protocol.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dynaviz.contracts.protocol import ProtocolInfo, ProtocolScores
from dynaviz.reports.reporting import Study
from dynaviz_eval.protocols.moving import SemanticKittiMos
from dynaviz_eval.protocols.points import PointsProtocol, PublicBenchmark
from dynaviz_eval.report.boards import ScoreBoard, ScoreRow
from dynaviz_eval.report.table import ABSENT, Column, Table, Value, named, percent


@dataclass(frozen=True)
class ByProtocol:
    """The scores of a study under its protocols; no table has rows if it has none.

    Attributes:
        study: the input.
        boards: one per sequence and scoring.
        infos: of the protocols, in the order of the columns.
    """

    study: Study
    boards: Sequence[ScoreBoard]
    infos: Sequence[ProtocolInfo]

    @classmethod
    def of(cls, study: Study, boards: Sequence[ScoreBoard]) -> ByProtocol:
        """The protocol of dynaviz and the public benchmark's first, all others by name."""
        first = (PointsProtocol.info.name, PublicBenchmark.info.name)
        infos = [protocol.info for protocol in study.protocols.values()]
        order = sorted(
            infos, key=lambda info: (first.index(info.name) if info.name in first else 9, info.name)
        )
        return cls(study, boards, order)

    def scores(self, row: ScoreRow) -> Mapping[str, ProtocolScores]:
        """The scores of a row by protocol.

        Those of its result under ``points`` if it was not scored.
        """
        assert row.run is not None
        known = self.study.scores.get(row.run.file, {})
        return known or {PointsProtocol.info.name: ProtocolScores(row.result.metrics)}

    def score(self, row: ScoreRow, info: ProtocolInfo, name: str) -> float | None:
        """A score in percent; None if undefined or unknown."""
        found = self.scores(row).get(info.name)
        return found.scores.get(name) if found else None

    def best(self, board: ScoreBoard, info: ProtocolInfo, name: str) -> float | None:
        """The highest score of a sequence, rounded as printed; None for a single row."""
        known = [
            round(s, 2) for row in board.rows if (s := self.score(row, info, name)) is not None
        ]
        return max(known) if len(board.rows) > 1 and known else None

    def value(self, board: ScoreBoard, row: ScoreRow, info: ProtocolInfo, name: str) -> Value:
        """A field of a table."""
        score = self.score(row, info, name)
        return percent(score, score is not None and round(score, 2) == self.best(board, info, name))

    def best_of_each(self) -> list[str]:
        """The best of each sequence under each protocol, as sentences."""
        lines = []
        for board in self.boards:
            for info in self.infos:
                top = self.best(board, info, info.scores[0])
                rows = [
                    row
                    for row in board.rows
                    if (s := self.score(row, info, info.scores[0])) and round(s, 2) == top
                ]
                if top is not None and rows:
                    where = f" on {board.title}" if len(self.boards) > 1 else ""
                    names = " and ".join(row.label for row in rows)
                    lines.append(
                        f"{info.title}{where}: {names}, {info.scores[0]} "
                        f"{top:.2f}\N{NO-BREAK SPACE}%"
                    )
        return lines

    def main_scores(self, board: ScoreBoard, number: int) -> Table:
        """One row per run, one column per protocol: its main score."""
        columns = [
            Column("method", number=False),
            *(Column(info.scores[0], info.title) for info in self.infos),
        ]
        rows = []
        for row in board.rows if self.infos else ():
            assert row.run is not None
            remark = self.study.remarks.get(row.run.file, "")
            values = [self.value(board, row, info, info.scores[0]) for info in self.infos]
            rows.append([Value(row.label, row.label, detail=remark), *values])
        notes = [
            "The main score of each protocol in percent, measured here. The best of each column is "
            "bold."
        ]
        if any(row.result.sections.source for row in board.rows):
            notes.append("Voxels of a map of another program: those of the points that it keeps.")
        notes += _split(board)
        return Table(f"main-{number}", f"Main scores: {board.title}", columns, rows, notes)

    def all_scores(self, board: ScoreBoard, number: int) -> Table:
        """One row per run, one group of columns per protocol."""
        pairs = [(info, name) for info in self.infos for name in info.scores]
        columns = [Column(name, info.title, main=name == info.scores[0]) for info, name in pairs]
        rows = [
            [named(row.label), *(self.value(board, row, *pair) for pair in pairs)]
            for row in board.rows
            if pairs
        ]
        title = f"All scores: {board.title}"
        return Table(f"scores-{number}", title, [Column("method", number=False), *columns], rows)

    def across(self) -> list[Table]:
        """A table for each scoring and protocol.

        Methods by sequences, combined as the protocol does.
        """
        scorings = dict.fromkeys(board.scoring for board in self.boards)
        groups = [
            [board for board in self.boards if board.scoring == scoring] for scoring in scorings
        ]
        return [
            self._by_sequence(group, info)
            for group in groups
            if len(group) > 1
            for info in self.infos
        ]

    def _by_sequence(self, group: Sequence[ScoreBoard], info: ProtocolInfo) -> Table:
        """Methods by sequences of one scoring, with the main score of a protocol."""
        main = info.scores[0]
        scoring = group[0].scoring
        columns = [
            Column("method", number=False),
            *(Column(board.title, f"{main} [%] ↑") for board in group),
        ]
        columns.append(Column("all", f"{main} [%] ↑", main=True))
        rows = []
        for label in dict.fromkeys(row.label for board in group for row in board.rows):
            here = [(board, board.row(label)) for board in group]
            row = [
                self.value(board, found, info, main) if found else Value(ABSENT)
                for board, found in here
            ]
            rows.append([named(label), *row, self._combined([found for _, found in here], info)])
        notes = [
            f"All: {info.combines}; only for methods with scores on every sequence. Scoring: "
            f"{scoring}."
        ]
        return Table(f"across-{info.name}-{scoring}", info.title, columns, rows, notes)

    def _combined(self, rows: Sequence[ScoreRow | None], info: ProtocolInfo) -> Value:
        """The main score of a method over all sequences."""
        parts = [
            self.study.scores.get(row.run.file, {}).get(info.name)
            for row in rows
            if row and row.run
        ]
        known = [part for part in parts if part is not None]
        if len(known) < len(rows):
            return Value(ABSENT)
        return percent(self.study.protocols[info.name].combine(known).scores.get(info.scores[0]))


def protocol_table(infos: Sequence[ProtocolInfo]) -> Table:
    """What each protocol counts."""
    columns = [
        Column(name, number=False)
        for name in ("protocol", "counts", "leaves out", "combines", "source")
    ]
    rows = [
        [
            Value(info.title, info.title),
            *(Value(t, t) for t in (info.counts, info.ignores, info.combines, info.source)),
        ]
        for info in infos
    ]
    notes = [
        "IoU, precision and recall: of the moving points. PR: static voxels kept. RR: dynamic "
        "voxels removed. F1: "
        "harmonic mean of both. SA: static points kept. DA: dynamic points removed. AA = √(SA · "
        "DA). All in percent.",
        "Scores of different protocols cannot be compared with each other.",
    ]
    return Table("protocols", "What each protocol counts", columns, rows, notes)


def _split(board: ScoreBoard) -> list[str]:
    """The split of SemanticKITTI-MOS that the sequence is in, as a sentence.

    Empty if it is in none.
    """
    name = board.sequence.name.removeprefix("semantickitti_")
    splits = SemanticKittiMos.info.splits.items() if name != board.sequence.name else ()
    return [
        f"In the split {split} of SemanticKITTI-MOS."
        for split, numbers in splits
        if name in numbers
    ]
