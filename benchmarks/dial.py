"""Whether the estimates of the dial agree with runs: ``dial.py SEQUENCE ...``.

For each sequence, some methods run once with a recording, whose sample estimates SA and DA with
other values of a parameter; then the method runs with these values. Prints a table, and how many
runs lie within both whiskers.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dynaviz as dv
from dynaviz.explain.dial import PointSample, pack
from dynaviz.explain.words import number
from dynaviz.views.read.reader import RunRecording

TURNS: dict[str, tuple[dict[str, Any], list[tuple[str, float]]]] = {
    "octomap": ({}, [("prob_miss", 0.3), ("prob_hit", 0.85), ("clamp_min", 0.3)]),
    "octomap_g": ({}, [("prob_miss", 0.45), ("clamp_max", 0.6)]),
    "octomap_gf": ({}, [("prob_miss", 0.25), ("prob_hit", 0.6)]),
    "removert": ({}, [("threshold", 0.02), ("threshold", 0.1)]),
    "dynablox": ({"clusters": True}, [("min_cluster", 40)]),
}
HEADS = (
    "sequence",
    "method",
    "value",
    "SA estimated",
    "SA of the run",
    "DA estimated",
    "DA of the run",
    "within",
)
TOLERANCE = 0.005  # percent: of scores that are equal


def main(sequences: list[str]) -> None:
    """Print the table."""
    print(f"| {' | '.join(HEADS)} |\n|{'---|' * len(HEADS)}")
    runs = 0
    right = 0
    costs: list[str] = []
    for path in sequences:
        for method in TURNS:
            for row, within in measured(path, method, costs):
                print(row, flush=True)
                runs += 1
                right += within
    print(f"\n{right} of {runs} runs are within both whiskers.\n")
    print("\n".join(costs))


def measured(path: str, method: str, costs: list[str]) -> Iterator[tuple[str, bool]]:
    """A row for each value of a method on a sequence, and whether the run is within whiskers."""
    settings, turns = TURNS[method]
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "run.rrd"
        sequence = dv.open(path)
        begin = time.perf_counter()
        dv.run(method, sequence, settings=settings, record=recording)
        seconds = time.perf_counter() - begin
        sample = RunRecording(recording).sample
        assert sample is not None
        size = recording.stat().st_size
        packed = len(pack(sample))
        costs.append(f"- {method} on {sequence.name}: {seconds:.1f} s, {len(sample.drawn.row):,} "
                     f"points in {packed / 1e3:.0f} kB of {size / 1e6:.1f} MB")  # fmt: skip
        for name, value in turns:
            run = dv.run(method, sequence, settings={**settings, name: value})
            yield row_of(sequence.name, method, name, value, sample, run)


def row_of(
    sequence: str, method: str, name: str, value: float, sample: PointSample, run: Any
) -> tuple[str, bool]:
    """A row, and whether the scores of the run are within both whiskers."""
    scores = sample.scores({name: value})
    within = [
        abs(run.metrics[each] - score.value) <= score.whisker + TOLERANCE
        for each, score in scores.items()
    ]
    cells = [f"{score} | {run.metrics[each]:.1f}" for each, score in scores.items()]
    verdict = "yes" if all(within) else "no"
    given = f"{name} {number(sample.given[name])} → {number(value)}"
    return f"| {sequence} | {method} | {given} | {' | '.join(cells)} | {verdict} |", all(within)


if __name__ == "__main__":
    main(sys.argv[1:])
