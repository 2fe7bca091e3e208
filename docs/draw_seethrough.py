"""Draw the figures of docs/methods/seethrough.md, one for each idea, from a run on a scene.

    python docs/draw_seethrough.py

Everything that is drawn is what the method itself computed: nothing is sketched.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import TwoSlopeNorm

import dynaviz as dv
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.scan import Scan
from dynaviz_methods.seethrough import SeeThrough, SeeThroughParams, history

mpl.use("Agg")
import matplotlib.pyplot as plt  # after the choice of a backend

PICTURES = Path(__file__).resolve().parent / "pictures"
SCENE = "simulate:demo?frames=60"
CAR = 1  # an object of the scene, which moves by a little more than its length
FRAMES = 60
AROUND = (11.0, 25.0, -6.0, 5.5)  # metres: x from and to, y from and to, around the car
HEIGHT = 0.8  # metres above the ground, of the layer of voxels that is drawn
SCAN = 30  # whose objects are drawn
DPI = 110
COLOURS = {"itself": "#d1495b", "moved": "#edae49", "continues": "#30638e", "static": "#9a9a9a"}


@dataclass
class Run:
    """What the method computed.

    Attributes:
        scans: of the scene; method: after the last of them.
        objects: (N,) int32 for each scan: the object of each point, from 0; -1 for none.
        firsts: the first object of each scan.
        visits: of each scan.
        itself, moved, dynamic: (O,) bool, by object: by its places, by its outline, in the end.
        certain: (O,) float64, by object.
    """

    scans: list[Scan]
    method: SeeThrough
    objects: list[Any]
    firsts: Any
    visits: list[history.Visits]
    itself: Any
    moved: Any
    dynamic: Any
    decision: history.Decision

    @classmethod
    def of(cls, scene: str) -> Run:
        """Run the method, and keep what it computes on the way."""
        sequence = dv.open(scene)
        scans = [sequence[k] for k in range(len(sequence))]
        method = SeeThrough(SeeThroughParams())
        method.begin(Context(Extent.of(*scans), sensor=sequence.sensor))
        kept: dict[str, Any] = {}
        objects: list[Any] = []
        of_history = method._history
        add = of_history.add
        followed = of_history._followed
        compiled = history.KERNELS

        def keep_objects(number: int, points: Any, voxels: Any, of: Any, count: int) -> None:
            objects.append(of.copy())
            add(number, points, voxels, of, count)

        def keep_dynamic(visits: Any, firsts: Any, *rest: Any) -> Any:
            kept.update(visits=list(visits), firsts=firsts, itself=rest[-1].copy())
            kept["dynamic"] = followed(visits, firsts, *rest)
            return kept["dynamic"].copy()

        class Moves:
            def moved(self, *arguments: Any) -> Any:
                kept["moved"] = compiled.moves.moved(*arguments)
                return kept["moved"]

        class Kernels:
            moves = Moves()

            def __getattr__(self, name: str) -> Any:
                return getattr(compiled, name)

        of_history.add = keep_objects  # type: ignore[method-assign]
        of_history._followed = keep_dynamic  # type: ignore[method-assign]
        for scan in scans:
            method.observe(scan.without_truth())
        history.KERNELS = Kernels()
        try:
            decision = of_history.decide()
        finally:
            history.KERNELS = compiled
        return cls(scans, method, objects, decision=decision, **kept)

    def of_car(self) -> Iterator[tuple[int, int, Any]]:
        """For each scan with the car: its number, the largest object of it, and its points."""
        for t, scan in enumerate(self.scans):
            assert scan.instances is not None
            its = self.objects[t][(scan.instances == CAR) & (self.objects[t] >= 0)]
            if len(its):
                local = int(np.bincount(its).argmax())
                yield t, int(self.firsts[t]) + local, scan.points[self.objects[t] == local]

    def kind(self, of: int) -> str:
        """Why an object is dynamic."""
        if self.itself[of]:
            return "itself"
        if self.moved[of]:
            return "moved"
        return "continues" if self.dynamic[of] else "static"


def figure(columns: int, width: float = 10.5, height: float = 3.9) -> tuple[Any, Any]:
    """Axes side by side that show the surroundings of the car from above."""
    fig, axes = plt.subplots(1, columns, figsize=(width, height), squeeze=False, layout="tight")
    for ax in axes[0]:
        ax.set_xlim(AROUND[0], AROUND[1])
        ax.set_ylim(AROUND[2], AROUND[3])
        ax.set_aspect("equal")
        ax.set_xlabel("x [m]")
        ax.set_ylabel("y [m]")
    return fig, axes[0]


def save(fig: Any, name: str) -> None:
    """Write a picture."""
    path = PICTURES / f"seethrough_{name}.png"
    fig.savefig(path, dpi=DPI)
    plt.close(fig)
    print(path.name, path.stat().st_size // 1000, "kB")


def layer(run: Run) -> tuple[Any, Any, Any, Any]:
    """Indices (K, 2) of the voxels of one layer that were hit, and their hits, clear and grazed."""
    grid = run.method._grid
    hits, clear, grazed = (of.ravel() for of in run.method._counts)
    voxels = np.flatnonzero(hits[: 512 * len(grid)])
    keys = grid.keys(voxels)
    size = grid.resolution
    ground = _ground(run)
    chosen = keys[:, 2] == int(np.floor((ground + HEIGHT) / size))
    xy = (keys[:, :2] + 0.5) * size
    chosen &= (xy[:, 0] > AROUND[0]) & (xy[:, 0] < AROUND[1])
    chosen &= (xy[:, 1] > AROUND[2]) & (xy[:, 1] < AROUND[3])
    found = voxels[chosen]
    return xy[chosen], hits[found], clear[found], grazed[found]


def _ground(run: Run) -> float:
    """Height of the ground under the car, metres."""
    t, _, points = next(run.of_car())
    return float(points[:, 2].min() - 0.2) if t >= 0 else 0.0


def draw_evidence(run: Run) -> None:
    """Hits, clear scans, and the evidence that follows from them, by voxel."""
    xy, hits, clear, grazed = layer(run)
    p = run.method.params
    against = p.near * grazed + p.hit * hits
    prior = run.decision.prior
    for_it = np.minimum(clear / p.votes, 1) * (clear - against) / np.maximum(clear + against, 1e-9)
    evidence = np.where(clear > against, for_it, prior * (clear - against) / (clear + against + 1))
    fig, axes = figure(3, 13.0, 3.6)
    parts = (
        (hits, "scans that hit the voxel", "YlOrBr", None),
        (clear, "scans that saw it clear", "Blues", None),
        (evidence, "evidence", "RdBu_r", TwoSlopeNorm(0, -prior, 1)),
    )
    for ax, (values, title, colours, norm) in zip(axes, parts, strict=True):
        top = None if norm else max(float(np.quantile(values, 0.98)), 1.0)
        shown = ax.scatter(
            *xy.T, c=values, s=9, marker="s", cmap=colours, norm=norm, vmax=top, linewidths=0
        )
        ax.set_title(title, fontsize=10)
        fig.colorbar(shown, ax=ax, shrink=0.7)
    save(fig, "evidence")


def draw_place(run: Run) -> None:
    """The evidence of places, alone and with what they inherit."""
    grid = run.method._grid
    size = 4 * grid.resolution
    rows = run.decision.rows[: 4 * len(grid)]
    places = np.flatnonzero(rows)
    blocks = grid.blocks[places >> 2]
    level = blocks[:, 2] == int(np.floor((_ground(run) + HEIGHT) / (2 * size)))
    places = places[level]
    quarter = np.stack([places >> 1 & 1, places & 1], 1)
    corners = (2 * blocks[level][:, :2] + quarter) * size
    own = run.decision.own[rows[places]]
    whole = own + run.decision.inherit * np.maximum(run.decision.shared[rows[places]], 0)
    fig, axes = figure(2)
    parts = ((own, "evidence of the place alone"), (whole, "with what it inherits"))
    for ax, (values, title) in zip(axes, parts, strict=True):
        norm = TwoSlopeNorm(0, -0.2, 0.8)
        colours = plt.get_cmap("RdBu_r")(norm(values))
        for (x, y), colour in zip(corners, colours, strict=True):
            ax.add_patch(plt.Rectangle((x, y), size, size, facecolor=colour, edgecolor="none"))
        ax.set_title(f"{title}; above 0: dynamic", fontsize=10)
        fig.colorbar(mpl.cm.ScalarMappable(norm=norm, cmap="RdBu_r"), ax=ax, shrink=0.7)
    save(fig, "place")


def draw_object(run: Run) -> None:
    """The points of one scan by object, and how certain it is that each is dynamic."""
    scan = run.scans[SCAN]
    objects = run.objects[SCAN]
    chosen = objects >= 0
    x, y = scan.points[chosen, 0], scan.points[chosen, 1]
    of = objects[chosen]
    kinds = np.array([run.kind(int(run.firsts[SCAN]) + k) for k in range(of.max() + 1)])
    fig, axes = figure(2)
    axes[0].scatter(x, y, c=of * 7 % 20, cmap="tab20", s=5, linewidths=0)
    axes[0].set_title(f"objects of scan {SCAN}: adjacent points of one scan", fontsize=10)
    for kind, colour in COLOURS.items():
        here = kinds[of] == kind
        axes[1].scatter(x[here], y[here], color=colour, s=5, linewidths=0, label=NAMES[kind])
    axes[1].legend(fontsize=8, markerscale=3, loc="upper left")
    axes[1].set_title("why they are dynamic, or static", fontsize=10)
    save(fig, "object")


NAMES = {
    "itself": "dynamic by its places",
    "moved": "moved: its outline is displaced",
    "continues": "continues a track",
    "static": "static",
}


def draw_track(run: Run) -> None:
    """The car in every sixth scan: by itself, by its outline, or as part of its track."""
    seen = list(run.of_car())
    fig, axes = plt.subplots(2, 1, figsize=(9.0, 5.2), height_ratios=(6, 1), layout="tight")
    for t, of, points in seen[:: max(len(seen) // 9, 1)]:
        axes[0].scatter(points[:, 0], points[:, 1], s=4, color=COLOURS[run.kind(of)], linewidths=0)
        if run.itself[of]:  # later ones stand in one place
            axes[0].annotate(str(t), points[:, :2].mean(0), fontsize=8)
    axes[0].set_aspect("equal")
    axes[0].set_xlabel("x [m]")
    axes[0].set_ylabel("y [m]")
    axes[0].set_title("the car from above; numbers: scans", fontsize=10)
    for t, of, _ in seen:
        axes[1].bar(t, 1, width=1, color=COLOURS[run.kind(of)])
    axes[1].set_yticks([])
    axes[1].set_xlabel("scan")
    axes[1].set_xlim(-0.5, FRAMES - 0.5)
    for kind, colour in COLOURS.items():
        axes[1].bar(-9, 1, color=colour, label=NAMES[kind])
    axes[1].legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.9), ncols=4)
    save(fig, "track")


def draw_move(run: Run) -> None:
    """Two outlines of the car, of which only the ends are places that differ."""
    seen = list(run.of_car())
    later = next((k for k, (_, of, _) in enumerate(seen) if run.kind(of) == "moved"), len(seen) - 1)
    ways = history.KERNELS.moves.WAYS
    fig, axes = figure(1, 7.5, 4.4)
    reaches = [run.visits[t].reach[of - int(run.firsts[t])] for t, of, _ in seen]
    guard = run.method.params.guard
    displaced = [
        k
        for k in range(later)
        if history.KERNELS.moves.displacement(reaches[k], reaches[later], guard) >= 0
    ]
    earlier = displaced[-1]
    for k, colour in ((earlier, COLOURS["continues"]), (later, COLOURS["moved"])):
        t, _, points = seen[k]
        corners = _outline(ways, reaches[k])
        axes[0].fill(*corners.T, facecolor="none", edgecolor=colour, linewidth=1.5)
        axes[0].scatter(
            points[:, 0], points[:, 1], s=5, color=colour, linewidths=0, label=f"scan {t}"
        )
    axes[0].legend(fontsize=9)
    axes[0].set_xlim(17.5, 25)
    axes[0].set_ylim(-1, 4.5)
    axes[0].set_title("outlines: how far the points reach in eight directions", fontsize=10)
    save(fig, "move")


def _outline(ways: Any, reach: Any) -> Any:
    """(8, 2) corners of the polygon that reaches so far in eight directions."""
    order = np.argsort(np.arctan2(ways[:, 1], ways[:, 0]))
    corners = []
    for a, b in zip(order, np.roll(order, -1), strict=True):
        corners.append(np.linalg.solve(ways[[a, b]], reach[[a, b]]))
    return np.array(corners)


def main() -> None:
    """Run the method and draw all figures."""
    run = Run.of(SCENE)
    for draw in (draw_evidence, draw_place, draw_object, draw_track, draw_move):
        draw(run)


if __name__ == "__main__":
    main()
