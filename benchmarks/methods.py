"""Seconds per frame of every method, its profile by kernel and its memory, on 120 000 points per
frame.

    python benchmarks/methods.py                              all methods on a generated street
    python benchmarks/methods.py dufomap removert             some methods
    python benchmarks/methods.py --folder FOLDER --frames 30  on pcd/*.pcd of a folder in the
        benchmark's layout
    python benchmarks/methods.py removert --preset port

Each method runs in its own process, after a first round that compiles. Rounds on all threads and on
one thread alternate, and the fastest of three is used. Memory is the peak beyond the scans, which
are all in memory here, and beyond the raw map that some methods receive; both sizes are printed.
The profile is measured in a separate round and sums all calls of each kernel while scans are
observed and labelled.
"""

from __future__ import annotations

import multiprocessing
import pkgutil
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from scenes import SENSOR, arguments_parser, read, street

from dynaviz import kernels
from dynaviz.contracts import registry
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.params import resolve
from dynaviz.contracts.scan import Scan
from dynaviz.engine.loop import peak_rss_mb

ROUNDS = 3
FRAMES = 60


def run(
    running: Any, scans: list[Scan], context: Context, ready: Callable[[], None] = lambda: None
) -> tuple[float, float, float, np.ndarray]:
    """Seconds for begin, seconds per frame for observe and for label, all labels.

    Calls ``ready`` after ``begin``.
    """
    start = time.perf_counter()
    running.begin(context)
    ready()
    begun = time.perf_counter()
    for scan in scans:
        running.observe(scan)
    observed = time.perf_counter()
    labels = [running.label(scan).dynamic for scan in scans]
    end = time.perf_counter()
    return (
        begun - start,
        (observed - begun) / len(scans),
        (end - observed) / len(scans),
        np.concatenate(labels),
    )


def watch(spent: defaultdict[str, float]) -> None:
    """Time every later call of a kernel from Python.

    Kernels called by a kernel are included in its time.
    """

    def timed(call: Callable[..., Any], step: str) -> Callable[..., Any]:
        def wrapped(*arguments: Any) -> Any:
            start = time.perf_counter()
            answer = call(*arguments)
            spent[step] += time.perf_counter() - start
            return answer

        return wrapped

    for module in pkgutil.iter_modules(kernels.__path__):
        home: ModuleType = getattr(kernels, module.name)
        for name, call in list(vars(home).items()):
            if hasattr(call, "py_func") and not name.startswith("_"):
                setattr(home, name, timed(call, f"{module.name}.{name}"))


def measure(name: str, preset: str | None, folder: Path | None, frames: int) -> None:
    """Measure a method and print its figures."""
    method = registry.load("methods", name)
    params = resolve(method, preset).params
    scans = read(folder, frames) if folder else street(frames)
    raw_map = np.concatenate([scan.points for scan in scans]) if method.info.needs_map else None
    context = Context(Extent.of(*scans), SENSOR, raw_map=raw_map)
    few = np.concatenate([scan.points for scan in scans[:2]]) if method.info.needs_map else None
    threads = kernels.set_threads(None)
    run(method(params), scans[:2], Context(Extent.of(*scans[:2]), SENSOR, raw_map=few))  # compile
    before = peak_rss_mb()
    run(method(params), scans, context)
    held = peak_rss_mb() - before

    best: dict[int, tuple[float, float, float, np.ndarray]] = {}
    for _ in range(ROUNDS):
        for n in (threads, 1):
            kernels.set_threads(n)
            answer = run(method(params), scans, context)
            if n not in best or sum(answer[1:3]) < sum(best[n][1:3]):
                best[n] = answer
    kernels.set_threads(threads)
    begin, observe, label, labels = best[threads]
    ratio = (best[1][1] + best[1][2]) / (observe + label)
    print(
        f"\n{name}{f' --preset {preset}' if preset else ''}: {observe + label:.4f} s per frame on "
        f"{threads} threads"
    )
    print(f"  observe {observe:.4f}, label {label:.4f}; begin {begin:.2f} s")
    print(
        f"  on one thread {ratio:.2f} times as slow; identical labels: "
        f"{np.array_equal(labels, best[1][3])}"
    )
    raw = f", and the raw map of {raw_map.nbytes / 1e6:.0f} MB" if raw_map is not None else ""
    print(
        f"  memory {held:.0f} MB beyond {sum(scan.points.nbytes for scan in scans) / 1e6:.0f} MB "
        f"of scans{raw}"
    )

    spent: defaultdict[str, float] = defaultdict(float)
    watch(spent)
    _, observe, label, _ = run(method(params), scans, context, ready=spent.clear)
    steps = {step: seconds / len(scans) for step, seconds in spent.items()}
    for step, mean in sorted(steps.items(), key=lambda pair: -pair[1])[:8]:
        print(f"  {step:28} {1000 * mean:7.2f} ms per frame")
    print(
        f"  {'other steps, in numpy':28} {1000 * (observe + label - sum(steps.values())):7.2f} ms "
        "per frame",
        flush=True,
    )


def main() -> None:
    arguments = arguments_parser(__doc__, FRAMES).parse_args()
    for name in arguments.methods or [handle.name for handle in registry.handles("methods")]:
        task = (name, arguments.preset, arguments.folder, arguments.frames)
        process = multiprocessing.get_context("spawn").Process(target=measure, args=task)
        process.start()
        process.join()


if __name__ == "__main__":
    main()
