"""Cost of a recording: runtime as a ratio to a run without recording, and file size.

    python benchmarks/recording.py                       a simulated street, HDL-64E, 60 frames
    python benchmarks/recording.py SEQ [METHOD] [ROUNDS]

Each round runs all recording modes, after a first run that compiles; the best round of each mode is used. CPU seconds
are the sum over all threads and vary less than wall time if other programs run. Sizes are also extrapolated to 141
frames of 120 000 points, in proportion to the number of points.
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

MODES = ("none", "scores", "errors", "full")
STANDARD = 141 * 120_000


Costs = dict[str, float]


def measure(sequence: Sequence, method: str, rounds: int, folder: Path) -> tuple[Costs, Costs, Costs, int]:
    """Best seconds, best CPU seconds and megabytes of each mode, and the number of points; checks for equal labels."""
    best, cpu = dict.fromkeys(MODES, np.inf), dict.fromkeys(MODES, np.inf)
    megabytes, labels, points = dict.fromkeys(MODES, 0.0), set(), 0
    api.run(method, sequence, out=folder, record="errors")
    for _ in range(rounds):
        for mode in MODES:
            start, start_cpu = time.perf_counter(), time.process_time()
            result = api.run(method, sequence, out=folder, record=mode)
            best[mode] = min(best[mode], time.perf_counter() - start)
            cpu[mode] = min(cpu[mode], time.process_time() - start_cpu)
            labels.add(result.labels_sha256)
            points = result.sequence.points
            if mode != "none":
                megabytes[mode] = (folder / "run.rrd").stat().st_size / 1e6
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
    for mode in MODES:
        times = best[mode], best[mode] / best["none"], cpu[mode], cpu[mode] / cpu["none"]
        size = megabytes[mode], megabytes[mode] * STANDARD / points
        table.add_row(mode, *map("{:.2f}".format, times), *map("{:.1f}".format, size))
    Console().print(f"{method} on {len(sequence)} frames of {points // len(sequence):,} points", table)


if __name__ == "__main__":
    arguments = sys.argv[1:]
    main(*arguments[:2], *map(int, arguments[2:]))
