"""Counts of the points of each tile by outcome."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dynaviz.arrays import I64
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Outcome
from dynaviz.engine.loop import Listener
from dynaviz.runs.tiles.grid import Tile, TileGrid, unpacked
from dynaviz.scores.sections import TileRow


class TileCounts(Listener):
    """Counts points by tile and outcome; memory grows with the number of tiles only.

    Args:
        size: edge of a tile, metres.

    Attributes:
        outcomes: (6,) int64 numbers of points by ``Outcome``, of each tile with points.
    """

    def __init__(self, size: float) -> None:
        self.size, self._grid = size, TileGrid(size)
        self.outcomes: dict[Tile, I64] = {}

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Count the points of a scan."""
        tiles, of, _ = self._grid.counted(labelled.scan)
        kinds = len(Outcome)
        counts = np.bincount(of * kinds + labelled.outcome, minlength=len(tiles) * kinds).reshape(-1, kinds)
        for tile, count in zip(map(unpacked, tiles.tolist()), counts, strict=True):
            self.outcomes[tile] = self.outcomes.get(tile, 0) + count

    def rows(self) -> tuple[TileRow, ...]:
        """The counts for the result, by column and row."""
        return tuple(
            TileRow(
                *tile,
                *(
                    int(count[outcome])
                    for outcome in (
                        Outcome.STATIC_KEPT,
                        Outcome.FALSE_POSITIVE,
                        Outcome.DYNAMIC_REMOVED,
                        Outcome.FALSE_NEGATIVE,
                        Outcome.UNLABELLED_KEPT,
                        Outcome.UNLABELLED_REMOVED,
                    )
                ),
            )
            for tile, count in sorted(self.outcomes.items())
        )
