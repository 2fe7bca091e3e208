"""Curves and a table of costs, as ratios to the plain walk, with growth exponents."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Row = dict[str, Any]
# larger exponents mean that a step grows faster than its work
YARDSTICK = "plain walk"
FAST = 1.15
HIDDEN = ("run, coarse",)


def ratios(rows: list[Row]) -> dict[str, dict[tuple[int, int], float]]:
    """By step and size: processor seconds per frame, in plain walks of a frame of that size."""
    # the best of all drives: the work per frame is the same
    walks: defaultdict[int, float] = defaultdict(lambda: np.inf)
    for row in rows:
        if row["step"] == YARDSTICK:
            walks[row["points"]] = min(walks[row["points"]], row["seconds"] / row["frames"])
    found: defaultdict[str, dict[tuple[int, int], float]] = defaultdict(dict)
    for row in rows:
        if row["step"] not in (YARDSTICK, *HIDDEN):
            found[row["step"]][row["points"], row["frames"]] = (
                row["seconds"] / row["frames"] / walks[row["points"]]
            )
    return dict(found)


def axes(rows: list[Row]) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """The sizes with increasing points per frame, and those with increasing frames."""
    sizes = sorted({(row["points"], row["frames"]) for row in rows})
    fewest = min(p for p, _ in sizes)
    shortest = min(f for _, f in sizes)
    return [size for size in sizes if size[1] == shortest], [
        size for size in sizes if size[0] == fewest
    ]


def exponent(work: list[int], cost: list[float]) -> float:
    """The exponent k of the best power law cost = work ** k; NaN for fewer than two values."""
    return (
        float(np.polyfit(np.log(work), np.log(np.maximum(cost, 1e-9)), 1)[0])
        if len(work) > 1
        else np.nan
    )


def growth(
    rows: list[Row], step: str, sizes: list[tuple[int, int]], cost: Callable[[Row], float]
) -> float:
    """Exponent with which the total cost of a step grows with the points of the whole drive."""
    found = [row for row in rows if row["step"] == step and (row["points"], row["frames"]) in sizes]
    return exponent([row["points"] * row["frames"] for row in found], [cost(row) for row in found])


def table(rows: list[Row]) -> str:
    """A Markdown table: ratio at each size, exponents with points and with frames, memory at the
    largest sizes.
    """
    wide, long = axes(rows)
    sizes = list(dict.fromkeys([*wide, *long]))
    head = [f"{p // 1000} k x {f:,}" for p, f in sizes]
    lines = [
        f"| step | {' | '.join(head)} | with points | with frames | MB, {head[len(wide) - 1]} | "
        f"MB, {head[-1]} |",
        "|---" * (len(head) + 5) + "|",
    ]
    for step, by_size in ratios(rows).items():
        cells = [f"{by_size[size]:.2f}" if size in by_size else "" for size in sizes]
        grown = [growth(rows, step, axis, lambda row: row["seconds"]) for axis in (wide, long)]
        bold = [f"**{k:.2f}**" if k > FAST else f"{k:.2f}" for k in grown]
        memory = [
            next(
                (
                    f"{row['memory_mb']:.0f}"
                    for row in rows
                    if (row["step"], row["points"], row["frames"]) == (step, *at)
                ),
                "",
            )
            for at in (wide[-1], long[-1])
        ]
        lines.append(f"| {step} | {' | '.join([*cells, *bold, *memory])} |")
    return "\n".join(lines) + "\n"


def draw(rows: list[Row], path: Path) -> None:
    """Six panels: ratios of methods, ratios of other steps, and memory, by points per frame and by
    frames.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.ticker import FuncFormatter

    found = ratios(rows)
    around = axes(rows)
    others = [step for step in found if step.startswith("run, ")] + [
        "reading",
        "metrics",
        "score",
        "compare",
        "report",
    ]
    methods = [step for step in found if step not in others]
    memory = {
        step: {
            (r["points"], r["frames"]): r["memory_mb"]
            for r in rows
            if r["step"] == step and "memory_mb" in r
        }
        for step in found
    }
    figure, panels = pyplot.subplots(2, 3, figsize=(17, 10), layout="constrained")
    labels = ("points per frame", "frames of the drive")
    for line, sizes, position, label in zip(panels, around, (0, 1), labels, strict=True):
        shown = (
            (methods, found, "methods: cost per frame, in plain walks"),
            (
                [step for step in others if step in found],
                found,
                "other steps: cost per frame, in plain walks",
            ),
            (list(found), memory, "peak memory, MB"),
        )
        for panel, (steps, values, title) in zip(line, shown, strict=True):
            for n, step in enumerate(steps):
                at = [size for size in sizes if size in values[step]]
                style = {
                    "marker": "o",
                    "ms": 3.5,
                    "ls": ("-", "--")[n // 10],
                    "color": f"C{n % 10}",
                    "label": step,
                }
                panel.plot(
                    [size[position] for size in at],
                    [max(values[step][size], 0.1 if values is memory else 1e-3) for size in at],
                    **style,
                )
            panel.set(xscale="log", yscale="log", xlabel=label, title=title)
            panel.set_xticks(
                [size[position] for size in sizes], [f"{size[position]:,}" for size in sizes]
            )
            panel.minorticks_off()
            panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            panel.grid(alpha=0.3)
            # hides no curve
            panel.legend(fontsize=7, ncols=5, loc="upper center", bbox_to_anchor=(0.5, -0.12))
    figure.suptitle("Cost by amount of work; a flat curve means linear growth")
    figure.savefig(path, dpi=90)
    pyplot.close(figure)
