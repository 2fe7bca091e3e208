"""Latency and memory of methods that run live: ``python benchmarks/live.py [METHOD ...]``.

    python benchmarks/live.py                         p50, p95, p99 and worst time per scan at 30,
        60 and 120 k points
    python benchmarks/live.py --memory                resident memory over 10,000 scans of a drive
        along a corridor
    python benchmarks/live.py [METHOD ...] --accuracy SEQ ...    SA and DA online and offline

The street of ``scenes.py`` is driven at 7.5 m/s; each scan goes through the whole session, static
map included. Besides the elapsed time it prints processor time divided by the number of threads:
what the scan would take on idle cores.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scenes import Drive

import dynaviz as dv
from dynaviz import kernels
from dynaviz.arrays import Bool
from dynaviz.contracts import registry
from dynaviz.contracts.method import Live
from dynaviz.contracts.scan import Scan, Sequence

SIZES = (30_000, 60_000, 120_000)
SCANS = 80
WARM = 10
QUANTILES = (50, 95, 99, 100)
# scans, and metres between them
LONG = 10_000
STEP = 0.5


def able() -> list[str]:
    """Methods that run live."""
    return [name for name, kind in registry.loadable("methods").items() if issubclass(kind, Live)]


def latency(names: list[str], sizes: list[int], scans: int, folder: Path) -> None:
    """Print a table of times per scan, milliseconds."""
    print(
        f"| method | points | {' | '.join(f'p{q}' for q in QUANTILES[:-1])} | worst | p99 of "
        "processor time |"
    )
    print(f"|---|---|{'---|' * 5}")
    for name in names:
        for size in sizes:
            drive = Drive.of(size, scans + WARM, folder)
            live = dv.live(name, sensor=drive.sensor)
            elapsed = []
            processor = []
            for scan in drive:
                bare = scan.without_truth()
                start = (time.perf_counter(), time.process_time())
                live.add(bare)
                elapsed.append(1000 * (time.perf_counter() - start[0]))
                processor.append(1000 * (time.process_time() - start[1]) / kernels.threads_in_use())
            shown = " | ".join(f"{np.percentile(elapsed[WARM:], q):.0f}" for q in QUANTILES)
            print(
                f"| {name} | {size} | {shown} | {np.percentile(processor[WARM:], 99):.0f} |",
                flush=True,
            )


def corridor(frame: int, random: np.random.Generator) -> Scan:
    """A scan of 600 points in a corridor with pillars, somewhere along it."""
    x = STEP * frame
    azimuth = random.uniform(-np.pi, np.pi, 600)
    direction = np.stack([np.cos(azimuth), np.sin(azimuth), random.uniform(-0.3, 0.3, 600)], 1)
    with np.errstate(divide="ignore"):
        walls = np.abs(3.0 / direction[:, 1])
        planes = np.abs(1.5 / direction[:, 2])
    ranges = np.minimum(np.minimum(walls, planes), 25.0)
    T = np.eye(4)
    T[:3, 3] = x, 0.0, 1.5
    return Scan(
        frame, (T[:3, 3] + ranges[:, None] * direction).astype(np.float32), T, 100_000_000 * frame
    )


def resident() -> float:
    """Memory of this process now, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def memory(names: list[str], scans: int) -> None:
    """Print resident memory along a drive."""
    print("| method | scans | MB | ms of processor time per scan |")
    print("|---|---|---|---|")
    for name in names:
        live = dv.live(name, sensor="vlp16", reach=20.0)
        random = np.random.default_rng(0)
        start = time.process_time()
        for frame in range(scans):
            live.add(corridor(frame, random))
            if (frame + 1) % (scans // 10) == 0:
                each = 1000 * (time.process_time() - start) / (frame + 1)
                print(f"| {name} | {frame + 1} | {resident():.0f} | {each:.1f} |", flush=True)


def accuracy(names: list[str], sources: list[str], frames: str | None) -> None:
    """Print SA and DA of each scan as it comes (online), and of all scans after the last one
    (offline).
    """
    print("| method | sequence | SA online | DA online | SA offline | DA offline |")
    print(f"|---|---|{'---|' * 4}")
    for source in sources:
        sequence = dv.open(source, frames=frames)
        scans = [sequence[position] for position in range(len(sequence))]
        for name in names:
            online, offline = answers(name, sequence, scans)
            rates = [*rates_of(scans, online), *rates_of(scans, offline)]
            print(
                f"| {name} | {sequence.name} | {' | '.join(f'{rate:.2f}' for rate in rates)} |",
                flush=True,
            )


def answers(name: str, sequence: Sequence, scans: list[Scan]) -> tuple[list[Bool], list[Bool]]:
    """Dynamic points by scan, online and offline.

    Methods that cannot run live see the whole sequence first.
    """
    if name not in able():
        runs = [
            dv.run(name, sequence, online=online, record="none", maps=False).labels
            for online in (True, False)
        ]
        return [runs[0][n] for n in range(len(scans))], [runs[1][n] for n in range(len(scans))]
    live = dv.live(name, sensor=sequence.sensor, reach=150.0, keep=len(scans))
    online = [
        live.add(replace(scan.without_truth(), index=n)).dynamic for n, scan in enumerate(scans)
    ]
    return online, [revised.labels.dynamic for revised in live.revise()]


def rates_of(scans: list[Scan], answers: list[Bool]) -> tuple[float, float]:
    """Shares of the static points kept and of the dynamic points removed, %."""
    counts = np.zeros((2, 2), np.int64)
    for scan, dynamic in zip(scans, answers, strict=True):
        scored = scan.labels <= 1
        np.add.at(counts, (scan.labels[scored], dynamic[scored].astype(int)), 1)
    return 100 * counts[0, 0] / counts[0].sum(), 100 * counts[1, 1] / max(counts[1].sum(), 1)


def main() -> None:
    """Measure what was asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("methods", nargs="*")
    parser.add_argument("--points", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--scans", type=int)
    parser.add_argument("--memory", action="store_true")
    parser.add_argument("--accuracy", nargs="+", metavar="SEQ")
    parser.add_argument("--frames")
    parser.add_argument("--folder", type=Path, help="keeps the generated street for the next time")
    chosen = parser.parse_args()
    names = chosen.methods or able()
    if chosen.memory:
        memory(names, chosen.scans or LONG)
    elif chosen.accuracy:
        accuracy(names, chosen.accuracy, chosen.frames)
    else:
        with tempfile.TemporaryDirectory() as folder:
            latency(names, chosen.points, chosen.scans or SCANS, chosen.folder or Path(folder))


if __name__ == "__main__":
    sys.exit(main())
