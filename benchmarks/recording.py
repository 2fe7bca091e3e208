"""Cost of a recording: runtime as a ratio to a run without recording, and file size.

    python benchmarks/recording.py                       a simulated street, HDL-64E, 60 frames
    python benchmarks/recording.py SEQ [METHOD] [ROUNDS]

Each round runs all recording modes, every second round in reverse order, after a first run that compiles. Seconds are
medians, and ratios are medians of the ratios of each round. CPU seconds are the sum over all threads and vary less than
wall time if other programs run. Sizes are also extrapolated to 141 frames of 120 000 points, in proportion to the
number of points.
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
from dynaviz.contracts.scan import Sequence

MODES = ("none", "scores", "errors", "full")
STANDARD = 141 * 120_000


Times = dict[str, list[tuple[float, float]]]  # by mode, of each round: seconds, CPU seconds


def measure(sequence: Sequence, method: str, rounds: int, folder: Path) -> tuple[Times, dict[str, float], int]:
    """Times and megabytes of each mode, and the number of points; checks for equal labels."""
    times: Times = {mode: [] for mode in MODES}
    megabytes, labels, points = dict.fromkeys(MODES, 0.0), set(), 0
    api.run(method, sequence, out=folder, record="errors")
    for turn in range(rounds):
        for mode in MODES[:: -1 if turn % 2 else 1]:
            start, start_cpu = time.perf_counter(), time.process_time()
            result = api.run(method, sequence, out=folder, record=mode)
            times[mode].append((time.perf_counter() - start, time.process_time() - start_cpu))
            labels.add(result.labels_sha256)
            points = result.sequence.points
            if mode != "none":
                megabytes[mode] = (folder / "run.rrd").stat().st_size / 1e6
    assert len(labels) == 1, "recording changed the labels"
    return times, megabytes, points


def main(path: str | None = None, method: str = "octomap_gf", rounds: int = 3) -> None:
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if path is None:
            from dynaviz.synthetic.simulate import simulate

            simulate("street_hdl64", folder / "street", frames=60)
        sequence = api.open(path or folder / "street")
        times, megabytes, points = measure(sequence, method, rounds, folder / "run")
    table = Table("recording", "seconds", "ratio", "CPU seconds", "ratio", "MB", "MB at 141 x 120 000")
    for mode in MODES:
        seconds, ratios = np.array(times[mode]), np.array(times[mode]) / np.array(times["none"])
        (wall, cpu), (wall_ratio, cpu_ratio) = np.median(seconds, axis=0), np.median(ratios, axis=0)
        size = megabytes[mode], megabytes[mode] * STANDARD / points
        figures = wall, wall_ratio, cpu, cpu_ratio
        table.add_row(mode, *map("{:.2f}".format, figures), *map("{:.1f}".format, size))
    Console().print(f"{method} on {len(sequence)} frames of {points // len(sequence):,} points", table)


if __name__ == "__main__":
    arguments = sys.argv[1:]
    main(*arguments[:2], *map(int, arguments[2:]))
