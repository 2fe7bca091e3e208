"""Where the time of a method goes, step by step: ``python benchmarks/steps.py METHOD ...

[--folder FOLDER]``.

Prints processor milliseconds per frame on one thread of each step of ``observe`` and ``label``:
functions by name, and indented what they call. The profiler adds a few percent. Processor time
depends little on other programs; ``methods.py`` measures seconds on all threads.
"""

from __future__ import annotations

import cProfile
import pstats
import time
from collections.abc import Iterator
from typing import Any

from scenes import SENSOR, arguments_parser, read, street

from dynaviz import kernels
from dynaviz.contracts import registry
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.params import resolve
from dynaviz.contracts.scan import Scan

# frames; the first few run once before, to load kernels
FRAMES = 24
WARM = 4
LEAST = 0.5  # milliseconds per frame of the steps to print
Function = tuple[str, int, str]  # file, line and name, as in pstats


def run(running: Any, scans: list[Scan], context: Context, profile: cProfile.Profile) -> None:
    """Observe and label all scans; profile that, but not ``begin``."""
    running.begin(context)
    profile.enable()
    for scan in scans:
        running.observe(scan)
    for scan in scans:
        running.label(scan)
    profile.disable()


def steps(name: str, preset: str | None, scans: list[Scan]) -> Iterator[tuple[int, str, float]]:
    """Depth, name and milliseconds per frame of each step, the costliest first."""
    method = registry.load("methods", name)
    params = resolve(method, preset).params
    run(method(params), scans[:WARM], Context(Extent.of(*scans[:WARM]), SENSOR), cProfile.Profile())
    profile = cProfile.Profile(time.process_time)
    run(method(params), scans, Context(Extent.of(*scans), SENSOR), profile)
    stats: Any = pstats.Stats(profile)
    stats.calc_callees()

    def below(caller: Function, depth: int) -> Iterator[tuple[int, str, float]]:
        for step, (*_, seconds) in sorted(
            stats.all_callees[caller].items(), key=lambda item: -item[1][3]
        ):
            yield depth, step[2].strip("<>"), 1000 * seconds / len(scans)
            if (
                "dynaviz_methods" in step[0] and len(stats.stats[step][4]) == 1
            ):  # what only this caller calls
                yield from below(step, depth + 1)

    for pass_ in ("observe", "label"):
        caller = next(f for f in stats.stats if f[2] == pass_ and "dynaviz_methods" in f[0])
        yield 0, pass_, 1000 * stats.stats[caller][3] / len(scans)
        yield from below(caller, 1)


def main() -> None:
    arguments = arguments_parser(__doc__, FRAMES, "+").parse_args()
    kernels.set_threads(1)
    scans = (
        read(arguments.folder, arguments.frames) if arguments.folder else street(arguments.frames)
    )
    for name in arguments.methods:
        print(
            f"\n{name}, {len(scans[0]):,} points per frame, ms per frame on one thread", flush=True
        )
        for depth, step, ms in steps(name, arguments.preset, scans):
            if ms >= LEAST:
                print(f"  {'  ' * depth + step:36} {ms:7.1f}")


if __name__ == "__main__":
    main()
