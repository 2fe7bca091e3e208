"""The overview of a run on tiles.

Tiles coloured by error, the worst ones ranked, the trajectory and a coarse map.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from dynaviz import colours
from dynaviz.arrays import F32, F64, I64
from dynaviz.contracts.metric import Figure, Labelled
from dynaviz.contracts.scan import Outcome
from dynaviz.engine.loop import Listener, RunSpec
from dynaviz.scores.result import Result
from dynaviz.sources.summary import SequenceSummary
from dynaviz.views import keys, paths
from dynaviz.views.compare.compare_layout import above
from dynaviz.views.layout import blueprint, solid
from dynaviz.views.record.downsampling import DownsampledMap, by_outcome
from dynaviz.views.record.report import table
from dynaviz.views.record.sink import RecordingFile

TILES = "world/tiles"
WORST = "world/worst_tiles"
RANKING = "ranking"
NAMED = 10  # worst tiles with a number in the map
LISTED = 40  # tiles in the ranking
VOXEL = 1.0  # metres: edge of the voxels of the map
POINTS = {  # of the map, at most, by outcome
    Outcome.STATIC_KEPT: 150_000,
    Outcome.UNLABELLED_KEPT: 150_000,
    Outcome.FALSE_POSITIVE: 30_000,
    Outcome.FALSE_NEGATIVE: 30_000,
    Outcome.UNLABELLED_REMOVED: 30_000,
}
# metres: tiles are drawn this far below the lowest sensor position, minus its height of some 2 m
BELOW = 1.0
GAP = 0.02  # of a tile's edge: a gap between tiles
STEP = 2.0  # metres between two points of the trajectory
ERRORS = (Outcome.FALSE_POSITIVE, Outcome.FALSE_NEGATIVE)
REMOVED = (Outcome.UNLABELLED_REMOVED,)
_LABELLED = slice(Outcome.STATIC_KEPT, Outcome.FALSE_NEGATIVE + 1)


class CountsByTile(Protocol):
    """Where the counts come from: ``dynaviz.runs.tiles.grid.TileCounts``."""

    size: float
    outcomes: dict[tuple[int, int], I64]


class Overview(Listener):
    """Writes ``overview.rrd``; its size does not depend on the number of points.

    Args:
        path: the recording.
        counts: a listener that is notified before this one.
    """

    def __init__(self, path: Path, counts: CountsByTile) -> None:
        self._path = path
        self._counts = counts

    def begin(self, run: RunSpec, summary: SequenceSummary) -> None:
        """Prepare the map."""
        self._run = run
        self._middle: F32 = np.round((summary.extent.low + summary.extent.high) / 2).astype(
            np.float32
        )
        self._maps = {
            kind: DownsampledMap(VOXEL, most, self._middle) for kind, most in POINTS.items()
        }
        self._way: list[F64] = []
        self._frames: list[int] = []

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Add a scan to the map."""
        position = labelled.scan.position
        if not self._way or np.linalg.norm(position - self._way[-1]) >= STEP:
            self._way.append(position.copy())
            self._frames.append(labelled.frame)
        rows = by_outcome(labelled, self._middle)
        for outcome, downsampled in self._maps.items():
            if len(rows[outcome]):
                downsampled.add(labelled.scan.points, labelled.reasons, rows[outcome])

    def finish(self, result: Result, figures: Mapping[str, Figure]) -> None:
        """Write the recording.

        Raises:
            DataError: if it cannot be written.
        """
        info = self._run.labeller.info
        name = self._run.sequence.name
        kinds = ERRORS if result.has_truth else REMOVED
        ranked = ranking(self._counts.outcomes, kinds)
        title = f"{info.title} on {name}: {len(ranked)} tiles"
        layout = _layout(self._corners(), result.has_truth)
        sink = RecordingFile(self._path, f"dynaviz overview {info.name} {name}", title, layout)
        facts = {
            "schema": paths.SCHEMA,
            "title": title,
            "sequence": name,
            "frames": result.sequence.frames,
        }
        sink.properties(paths.OVERVIEW, **facts)
        sink.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        shades = colours.BRIGHT if result.has_truth else colours.UNSCORED
        for outcome, downsampled in self._maps.items():
            points, _ = downsampled.thinned()
            radius = rr.Radius.ui_points(
                1.0 if outcome in (Outcome.STATIC_KEPT, Outcome.UNLABELLED_KEPT) else 2.5
            )
            cloud = rr.Points3D(points, colors=shades[outcome], radii=radius)
            sink.log(f"{paths.MAP}/{outcome.name.lower()}", cloud, static=True)
        sink.log(
            paths.TRAJECTORY, rr.LineStrips3D([self._way], colors=[240, 240, 240]), static=True
        )
        here = rr.Points3D.columns(
            positions=self._way,
            colors=[colours.LABEL] * len(self._way),
            radii=[-4.0] * len(self._way),
        )
        sink.columns(paths.SENSOR, self._frames, [None], here)
        self._draw_tiles(sink, ranked, kinds)
        text = self._text(result, ranked, kinds)
        sink.log(RANKING, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
        sink.finish()

    def _corners(self) -> F64:
        """(N, 3) float64, metres: the tiles' corners, at the height of the sensor."""
        low = np.array(sorted(self._counts.outcomes), np.float64).reshape(-1, 2) * self._counts.size
        corners = np.concatenate([low, low + self._counts.size])
        return np.column_stack(
            [corners, np.full(len(corners), np.median([place[2] for place in self._way]))]
        )

    def _draw_tiles(
        self, sink: RecordingFile, ranked: list[tuple[int, int]], kinds: Iterable[Outcome]
    ) -> None:
        """A square per tile in the colour of its errors, and the ranks of the worst ones."""
        edge = self._counts.size
        height = float(np.min(self._way, axis=0)[2]) - 1.73 - BELOW
        low = np.array([(x * edge, y * edge, height) for x, y in ranked])
        errors = np.array([_sum(self._counts.outcomes[tile], kinds) for tile in ranked], np.float64)
        shares = np.log1p(errors) / max(float(np.log1p(errors.max(initial=0.0))), 1e-9)
        corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]) * (1 - 2 * GAP) + [
            GAP,
            GAP,
            0,
        ]
        shades = keys.coloured(shares.astype(np.float32))
        squares = rr.Mesh3D(
            vertex_positions=(low[:, None] + corners * edge).reshape(-1, 3),
            triangle_indices=(
                4 * np.arange(len(low))[:, None, None] + [(0, 1, 2), (0, 2, 3)]
            ).reshape(-1, 3),
            vertex_colors=np.repeat(shades, 4, axis=0),
        )
        sink.log(TILES, squares, static=True)
        worst = min(NAMED, int((errors > 0).sum()))
        names = rr.Points3D(
            low[:worst] + np.array([edge / 2, edge / 2, 15.0]),
            labels=[str(rank) for rank in range(1, worst + 1)],
            colors=colours.LABEL,
            radii=rr.Radius.ui_points(0.0),
            show_labels=True,
        )
        sink.log(WORST, names, static=True)

    def _text(
        self, result: Result, ranked: list[tuple[int, int]], kinds: tuple[Outcome, ...]
    ) -> str:
        """The scores, and the ranking with the command that opens each tile."""
        what = "wrong" if result.has_truth else "removed"
        scores = ", ".join(f"{k} {v:.2f}" for k, v in result.metrics.items() if v is not None)
        total = sum(_sum(count, kinds) for count in self._counts.outcomes.values())
        rows: list[tuple[Any, ...]] = [
            ("#", "tile", f"{what} points", "% of all", "% of tile", "points")
        ]
        head = f"### {result.method} on {result.sequence.name}\n\n{scores}\n\n" if scores else ""
        listed = [tile for tile in ranked if _sum(self._counts.outcomes[tile], kinds)]
        for rank, tile in enumerate(listed[:LISTED], 1):
            count = self._counts.outcomes[tile]
            here = _sum(count, kinds)
            points = int(count[_LABELLED].sum() if result.has_truth else count.sum())
            shares = (f"{100 * here / max(total, 1):.1f}", f"{100 * here / max(points, 1):.2f}")
            rows.append((rank, f"`{tile[0]}_{tile[1]}`", f"{here:,}", *shares, f"{points:,}"))
        first = "{}_{}".format(*ranked[0]) if ranked else "X_Y"
        folder = shlex.quote(str(self._path.parent / "tiles" / first))
        key = f"Tiles are bright where many points are {what}. Numbers mark the {NAMED} worst."
        if none := len(ranked) - len(listed):
            key += f" {none:,} of {len(ranked):,} tiles have no {what} points."
        return (
            f"{head}{key}\n\nOpen the recording of a tile with:\n\n`dynaviz view "
            f"{folder}`\n\n{table(rows)}"
        )


def ranking(
    outcomes: Mapping[tuple[int, int], I64], kinds: Iterable[Outcome]
) -> list[tuple[int, int]]:
    """The tiles, those with the most points of some outcomes first."""
    kinds = tuple(kinds)
    return sorted(outcomes, key=lambda tile: (-_sum(outcomes[tile], kinds), tile))


def _sum(count: I64, kinds: Iterable[Outcome]) -> int:
    return int(sum(count[kind] for kind in kinds))


def _layout(corners: F64, truth: bool) -> rrb.Blueprint:
    title = "tiles: bright = many wrong points" if truth else "tiles: bright = many removed points"
    tiles = solid(title, [TILES, WORST, paths.TRAJECTORY, paths.SENSOR], above(corners))
    points = solid(
        "map", [f"{paths.MAP}/**", WORST, paths.TRAJECTORY, paths.SENSOR], above(corners)
    )
    words = rrb.TextDocumentView(name="worst tiles", origin=RANKING)
    return blueprint(rrb.Horizontal(rrb.Vertical(tiles, points), words, column_shares=[5, 3]))
