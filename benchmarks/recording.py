"""What a recording costs: wall time of a run as a ratio to the run without one, and the file's size.

    python benchmarks/recording.py                       a simulated street, HDL-64E, 60 frames
    python benchmarks/recording.py SEQ [METHOD] [ROUNDS]

All ways of recording are run in turn in each round, after a first run that compiles; the best round of each counts.
Sizes are also given for 141 frames of 120 000 points, growing with the number of points.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from dynaviz import api
from dynaviz.scan import Sequence

WAYS = ("none", "scores", "errors", "full")
STANDARD = 141 * 120_000


def measure(
    sequence: Sequence, method: str, rounds: int, folder: Path
) -> tuple[dict[str, float], dict[str, float], int]:
    """Best seconds and megabytes of each way, and the number of points; the labels must not differ."""
    best, megabytes, labels, points = dict.fromkeys(WAYS, np.inf), dict.fromkeys(WAYS, 0.0), set(), 0
    api.run(method, sequence, out=folder, record="errors")
    for _ in range(rounds):
        for way in WAYS:
            start = time.perf_counter()
            result = api.run(method, sequence, out=folder, record=way)
            best[way] = min(best[way], time.perf_counter() - start)
            labels.add(result.labels_sha256)
            points = result.sequence["points"]
            if way != "none":
                megabytes[way] = (folder / "run.rrd").stat().st_size / 1e6
    assert len(labels) == 1, "recording changed the labels"
    return best, megabytes, points


def main(path: str | None = None, method: str = "octomap_gf", rounds: int = 2) -> None:
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if path is None:
            from dynaviz.simulate import simulate

            simulate("street_hdl64", folder / "street", frames=60)
        sequence = api.open(path or folder / "street")
        best, megabytes, points = measure(sequence, method, rounds, folder / "run")
    table = Table("recording", "seconds", "ratio", "more per frame", "MB", "MB at 141 x 120 000")
    for way in WAYS:
        more = (best[way] - best["none"]) / len(sequence)
        size = megabytes[way], megabytes[way] * STANDARD / points
        table.add_row(
            way,
            f"{best[way]:.2f}",
            f"{best[way] / best['none']:.2f}",
            f"{1e3 * more:.1f} ms",
            *map("{:.1f}".format, size),
        )
    Console().print(f"{method} on {len(sequence)} frames of {points // len(sequence):,} points", table)


if __name__ == "__main__":
    arguments = sys.argv[1:]
    main(*arguments[:2], *map(int, arguments[2:]))
