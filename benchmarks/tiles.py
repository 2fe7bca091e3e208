"""What tiles cost, on drives of a simulated street, and what they keep.

Labels, memory, and a run that loses a worker.

python benchmarks/tiles.py equal [SEQUENCE]    labels of every method on tiles of 60 m and as a
whole python benchmarks/tiles.py cost [METRES]       processor time on tiles of 200 m and as a
whole; 1000 m python benchmarks/tiles.py workers [METRES]    elapsed time of two workers against
one; set NUMBA_NUM_THREADS=1
                                               and run it with nothing else running
python benchmarks/tiles.py memory              peak memory at 1, 4 and 16 times 1.25 km
python benchmarks/tiles.py city                20 km on a Dask cluster of two workers, one of which
is killed
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scenes import Drive

import dynaviz as dv
from dynaviz.contracts import registry
from dynaviz.engine.loop import peak_rss_mb
from dynaviz.runs.tiles.label_tiles import TileOptions, label_tiles, tileable
from dynaviz.scores.result import Result

BLOCK = 18.0  # metres after which a drive repeats
FRAMES = 8  # in that distance: 80 km/h at 10 Hz
SPARSE = 2000  # points per frame
KILOMETRES = 20


def drive(points: int, metres: float, folder: Path) -> Drive:
    """A drive of some length with about this many points per frame."""
    dense = Drive.of(points, 0, folder)
    return replace(
        dense,
        block=dense.block[:: len(dense.block) // FRAMES],
        frames=round(metres / BLOCK * FRAMES),
    )


def equal(sequence: str | None, folder: Path) -> None:
    """Compare the labels of every method on tiles with those of one run."""
    whole = dv.open(sequence, frames="0:12") if sequence else drive(60_000, 9.0, folder)
    for method in tileable():
        labels = []
        for name, tiles in (("whole", None), ("tiles", 60.0)):
            dv.run(method, whole, out=folder / name, record="none", tiles=tiles)
            with np.load(folder / name / "labels.npz") as z:
                labels.append(np.unpackbits(z["dynamic"])[: z["points"].sum()])
        differ = int((labels[0] != labels[1]).sum())
        print(f"{method:12} {differ:6} of {len(labels[0]):,} points differ", flush=True)


def cost(metres: float, folder: Path) -> None:
    """Print processor time against a run without tiles, for a road in the middle and on the border
    of tiles.
    """
    on_border = drive(20_000, metres, folder)
    in_middle = replace(
        on_border, block=[scan.moved(np.array([0.0, 100.0, 0.0])) for scan in on_border.block]
    )
    cases = (
        ("whole", on_border, None),
        ("in the middle", in_middle, 200.0),
        ("on the border", on_border, 200.0),
    )
    for method in ("octomap", "seethrough"):
        dv.run(method, drive(2000, 2.0, folder), threads=1)  # loads the kernels
        spent = []
        for name, sequence, tiles in cases:
            start = time.process_time()
            dv.run(
                method,
                sequence,
                out=folder / f"{method} {name}",
                record="none",
                tiles=tiles,
                threads=1,
            )
            spent.append(time.process_time() - start)
            print(f"{method} {name}: {spent[-1]:.0f} s, x {spent[-1] / spent[0]:.2f}", flush=True)


def workers(metres: float, folder: Path) -> None:
    """Print elapsed time of the tiles of a drive with one and with two workers, each with one
    thread.
    """
    whole = drive(20_000, metres, folder)
    elapsed = []
    for count in (1, 2):
        ends: dict[str, float] = {}
        progress = partial(_note, ends)
        with TemporaryDirectory(dir=folder) as out:
            options = TileOptions(200.0, count)
            kind = registry.load("methods", "octomap_g")
            folder_of_run = Path(out)
            params = kind.Params()
            label_tiles(folder_of_run, kind, params, whole, options, progress=progress)
        elapsed.append(ends["tiles"] - ends["index"])
        print(f"octomap_g: {elapsed[-1]:.0f} s on tiles with {count} workers", flush=True)
    print(f"x {elapsed[0] / elapsed[1]:.2f}")


def _note(ends: dict[str, float], phase: str, done: int, total: int) -> None:
    ends[phase] = time.perf_counter()


def memory(folder: Path) -> None:
    """Print the peak memory of a process that runs drives of growing length."""
    for times in (1, 4, 16):
        code = (
            "from pathlib import Path; import dynaviz as dv; from tiles import SPARSE, drive, "
            "peak_rss_mb\n"
            f"folder = Path({str(folder)!r}); sequence = drive(SPARSE, {1250.0 * times}, folder)\n"
            f"dv.run('octomap', sequence, out=folder / 'memory{times}', record='none', "
            "tiles=200.0, threads=1)\n"
            "print(peak_rss_mb())"
        )
        found = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=_path()
        )
        print(f"{1250 * times:6} m: {float(found.stdout):.0f} MB", flush=True)


def city(folder: Path) -> None:
    """Clean a drive of 20 km on a cluster; kill a worker in the middle."""
    from distributed import LocalCluster

    whole = drive(SPARSE, 1000.0 * KILOMETRES, folder)
    out = folder / "city"
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        victim = next(iter(cluster.workers.values())).pid

        def kill() -> None:
            while len(list(out.glob("tiles/*/answers.npz"))) < 10:
                time.sleep(1.0)
            os.kill(victim, signal.SIGKILL)
            print(f"killed a worker after {time.perf_counter() - start:.0f} s", flush=True)

        start = time.perf_counter()
        threading.Thread(target=kill, daemon=True).start()
        result = dv.run(
            "octomap",
            whole,
            out=out,
            record="none",
            tiles=500.0,
            scheduler=cluster.scheduler_address,
        )
    _describe(result, out, time.perf_counter() - start)


def _describe(result: Result, out: Path, seconds: float) -> None:
    with np.load(out / "labels.npz") as z:
        names = z["reason_names"].tolist()
        lost = int((z["reasons"] == names.index("out_of_reach")).sum())
    tiling = result.sections.tiling
    points = result.sequence.points
    assert tiling
    print(
        f"{result.sequence.frames:,} frames, {points:,} points, {tiling.tiles} tiles in "
        f"{seconds:.0f} s"
    )
    print(
        f"{lost} points out of reach; SA {result.metrics['SA']:.2f}, DA {result.metrics['DA']:.2f}"
    )
    print(
        f"{peak_rss_mb():.0f} MB in this process, {result.runtime.peak_rss_mb:.0f} MB at most in "
        "those of the tiles"
    )


def _path() -> dict[str, str]:
    """The environment in which other processes find this folder's modules, to unpickle a drive."""
    return {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("equal", "cost", "workers", "memory", "city"))
    parser.add_argument(
        "argument", nargs="?", help="a sequence, or the length of the drive in metres"
    )
    arguments = parser.parse_args()
    os.environ.update(_path())
    with TemporaryDirectory() as name:
        folder = Path(name)
        if arguments.what == "equal":
            equal(arguments.argument, folder)
        elif arguments.what == "cost":
            cost(float(arguments.argument or 1000.0), folder)
        elif arguments.what == "workers":
            workers(float(arguments.argument or 1000.0), folder)
        else:
            {"memory": memory, "city": city}[arguments.what](folder)


if __name__ == "__main__":
    main()
