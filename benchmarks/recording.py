"""What a recording costs: time of a run as a ratio to the run without one, and the file's size.

    python benchmarks/recording.py                       a simulated street, HDL-64E, 60 frames
    python benchmarks/recording.py SEQ [METHOD] [ROUNDS]

All ways of recording are run in turn in each round, after a first run that compiles; the best round of each counts.
CPU seconds are of all threads together, and steadier than the clock on a machine that does other things. Sizes are
also given for 141 frames of 120 000 points, growing with the number of points.
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


Costs = dict[str, float]


def measure(sequence: Sequence, method: str, rounds: int, folder: Path) -> tuple[Costs, Costs, Costs, int]:
    """Best seconds, best CPU seconds and megabytes of each way, and the number of points; labels must not differ."""
    best, cpu = dict.fromkeys(WAYS, np.inf), dict.fromkeys(WAYS, np.inf)
    megabytes, labels, points = dict.fromkeys(WAYS, 0.0), set(), 0
    api.run(method, sequence, out=folder, record="errors")
    for _ in range(rounds):
        for way in WAYS:
            start, start_cpu = time.perf_counter(), time.process_time()
            result = api.run(method, sequence, out=folder, record=way)
            best[way] = min(best[way], time.perf_counter() - start)
            cpu[way] = min(cpu[way], time.process_time() - start_cpu)
            labels.add(result.labels_sha256)
            points = result.sequence["points"]
            if way != "none":
                megabytes[way] = (folder / "run.rrd").stat().st_size / 1e6
    assert len(labels) == 1, "recording changed the labels"
    return best, cpu, megabytes, points


def main(path: str | None = None, method: str = "octomap_gf", rounds: int = 2) -> None:
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if path is None:
            from dynaviz.simulate import simulate

            simulate("street_hdl64", folder / "street", frames=60)
        sequence = api.open(path or folder / "street")
        best, cpu, megabytes, points = measure(sequence, method, rounds, folder / "run")
    table = Table("recording", "seconds", "ratio", "CPU seconds", "ratio", "MB", "MB at 141 x 120 000")
    for way in WAYS:
        times = best[way], best[way] / best["none"], cpu[way], cpu[way] / cpu["none"]
        size = megabytes[way], megabytes[way] * STANDARD / points
        table.add_row(way, *map("{:.2f}".format, times), *map("{:.1f}".format, size))
    Console().print(f"{method} on {len(sequence)} frames of {points // len(sequence):,} points", table)


if __name__ == "__main__":
    arguments = sys.argv[1:]
    main(*arguments[:2], *map(int, arguments[2:]))
