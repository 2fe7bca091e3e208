"""Cost of every method and step as the work increases: ``python benchmarks [--quick]``.

    python benchmarks --quick                    small sizes, about ten minutes; --only STEP... for
        some steps
    python benchmarks -o FOLDER                  30 to 240 thousand points per frame, 100 to 5,000
        frames; takes hours
    python benchmarks --draw FOLDER/costs.json   draw curves and table of an earlier run again

Each step runs in its own process on one thread, and processor seconds are measured, so other
programs have little effect. Methods on short drives run twice, and the better round is used. Every
cost is a ratio to the plain walk along the rays of the same scans (``plain.py``), so a flat curve
means that a step grows linearly with its work. Exponents above 1.15 are printed in bold.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from curves import YARDSTICK, draw, table

from dynaviz.contracts import registry

QUICK = ((30_000, 60_000, 120_000), (24, 120))
FULL = ((30_000, 60_000, 120_000, 240_000), (100, 500, 2_000, 5_000))


def steps() -> dict[str, tuple[str, ...]]:
    """Arguments of ``costs.py`` for each step, in an order in which the files of earlier steps
    exist when needed.
    """
    return {
        YARDSTICK: ("reference",),
        **{handle.name: ("method", handle.name) for handle in registry.handles("methods")},
        "public dufomap": ("public_dufomap",),
        **{f"run, {way}": ("recorded", way) for way in ("none", "errors", "full", "coarse")},
        **{name: (name,) for name in ("reading", "metrics", "score", "compare", "report")},
    }


def measured(
    sizes: tuple[tuple[int, ...], tuple[int, ...]], only: list[str]
) -> Iterator[dict[str, Any]]:
    """Measure each step at each size.

    All numbers of points on the shortest drive, all drives with fewest points.
    """
    points, frames = sizes
    work = [*((p, frames[0]) for p in points), *((points[0], f) for f in frames[1:])]
    chosen = {
        name: step for name, step in steps().items() if not only or name in (YARDSTICK, *only)
    }
    with tempfile.TemporaryDirectory() as folder:
        for p, f in work:
            for name, words in chosen.items():
                if figures := run_step(p, f, f"{folder}/drive", *words):
                    yield {"step": name, "points": p, "frames": f, **figures}
            shutil.rmtree(f"{folder}/drive", ignore_errors=True)


def run_step(*words: object) -> dict[str, float] | None:
    """The figures of a step in its own process; None if it fails, and the error is printed."""
    command = [sys.executable, str(Path(__file__).with_name("costs.py")), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        print(*words, done.stderr.strip().rpartition("\n")[2], flush=True)
        return None
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="+", default=[], metavar="STEP")
    parser.add_argument("--draw", type=Path, metavar="JSON")
    parser.add_argument("-o", "--out", type=Path, default=Path("build/benchmarks"))
    arguments = parser.parse_args()
    if arguments.draw:
        rows = [json.loads(line) for line in arguments.draw.read_text().splitlines()]
    else:
        arguments.out.mkdir(parents=True, exist_ok=True)
        rows = []
        with (arguments.out / "costs.json").open("w") as file:
            for row in measured(QUICK if arguments.quick else FULL, arguments.only):
                rows.append(row)
                print(json.dumps(row), file=file, flush=True)
                print(f"{row['points']:>7} points {row['frames']:>5} frames  {row['step']:15} "
                      f"{row['seconds'] / row['frames'] * 1e3:9.2f} ms per "
                      "frame", flush=True)  # fmt: skip
    out = arguments.draw.parent if arguments.draw else arguments.out
    text = table(rows)
    (out / "costs.md").write_text(text)
    draw(rows, out / "costs.png")
    print(f"{text}\nWritten to {out}: costs.json, costs.md, costs.png.")


if __name__ == "__main__":
    main()
