"""What the looks cost: their share of the processor time of a run, by recording.

    python benchmarks/looks.py SEQUENCE [METHOD ...]        octomap and seethrough

Each run is repeated in the same process, and the second counts, so that nothing compiles.
"""

from __future__ import annotations

import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, cast

import dynaviz as dv
from dynaviz.engine.looks import LookTables

METHODS = ("octomap", "seethrough")
RECORDS = ("errors", "none")


def timed(spent: dict[str, float], name: str, clock: Callable[[], float]) -> None:
    """Add the processor time of a method of the tables to what was spent."""
    call = getattr(LookTables, name)

    def measured(*args: Any, **kwargs: Any) -> Any:
        begin = clock()
        try:
            return call(*args, **kwargs)
        finally:
            spent[name] = spent.get(name, 0.0) + clock() - begin

    setattr(LookTables, name, measured)


def main(sequence: str, *methods: str) -> None:
    warnings.simplefilter("ignore")
    spent: dict[str, float] = {}
    timed(spent, "add", time.thread_time)  # next to the metrics, on one thread
    timed(spent, "seen", time.process_time)  # alone, on all threads
    print("| method | recording | s | keeping scans | looking | share |\n|---|---|---|---|---|---|")
    for method in methods or METHODS:
        for record in RECORDS:
            for _ in range(2):
                spent.clear()
                begin = time.process_time()
                with tempfile.TemporaryDirectory() as folder:
                    mode = cast(Literal["errors", "none"], record)
                    dv.run(method, sequence, out=Path(folder) / "run", record=mode)
                total = time.process_time() - begin
            share = 100 * sum(spent.values()) / total
            print(
                f"| {method} | {record} | {total:.1f} | {spent['add']:.2f} | {spent['seen']:.2f} "
                f"| {share:.1f} % |",
                flush=True,
            )


if __name__ == "__main__":
    main(*sys.argv[1:])
