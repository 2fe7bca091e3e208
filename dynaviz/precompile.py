"""Compile kernels before their first use.

``python -m dynaviz.precompile``, with ``--all`` those of all methods.
"""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import signal
import sys
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

_SPAWN = multiprocessing.get_context("spawn")


@contextlib.contextmanager
def compiling(methods: Iterable[str]) -> Iterator[None]:
    """Compile the kernels on all cores in the background if none are compiled yet.

    One core would take minutes.

    Args:
        methods: names of those whose kernels are compiled, too.
    """
    from dynaviz import kernels
    from dynaviz.contracts import registry

    if kernels.compiled():
        yield
        return
    methods = set(methods)
    print(
        f"{kernels.COMPILING} of {len(methods)} methods, kept for later ...",
        file=sys.stderr,
        flush=True,
    )
    # methods of one module share kernels; two cores would compile these twice
    families: dict[str, list[str]] = {}
    for handle in registry.handles("methods"):
        if handle.name in methods:
            families.setdefault(handle.target.partition(":")[0], []).append(handle.name)
    with ProcessPoolExecutor(mp_context=_SPAWN) as cores:
        # Errors are ignored here: they occur again, and are reported, when the kernel runs.
        cores.submit(_score)
        for names in families.values():
            cores.submit(_label, names)
        yield


@contextlib.contextmanager
def compiling_the_rest(method: str) -> Iterator[None]:
    """Compile on another core what casts rays, scores and records, and what the method needs late,
    while this process runs it.

    Nothing happens if any kernel is compiled already. The other process ends with this block at the
    latest.

    Args:
        method: its name; see ``dynaviz.contracts.method.CompilesAhead``.
    """
    from dynaviz import kernels

    if kernels.compiled():
        yield
        return
    rest = _SPAWN.Process(target=_the_rest, args=(method,), daemon=True)
    rest.start()
    try:
        yield
    finally:
        rest.terminate()
        rest.join()


def _label(names: list[str]) -> None:
    """Run methods on a few scans, with all their states."""
    from dynaviz.contracts import registry
    from dynaviz.contracts.probe import MemoryProbe
    from dynaviz.engine.loop import RunSpec, execute
    from dynaviz.testing import InMemory, crossing

    with contextlib.redirect_stderr(io.StringIO()):
        for name in names:
            method = registry.load("methods", name)
            execute(
                RunSpec(method(method.Params()), InMemory(crossing(9)), method.Params()),
                probe=MemoryProbe(),
            )


def _the_rest(name: str) -> None:
    """Compile until SIGTERM, which lets this process remove its files.

    Errors occur again where kernels are used.
    """
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    with (
        contextlib.suppress(Exception, KeyboardInterrupt),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        _cast()
        _ahead(name)
        _score()


def _cast() -> None:
    """Cast the rays of a scan: kernels that compile for long and come late."""
    from dynaviz.arrays import all_finite
    from dynaviz.blocks.blocks import BlockGrid
    from dynaviz.contracts.extent import Extent
    from dynaviz.testing import crossing

    (scan,) = crossing(1)
    grid = BlockGrid(Extent.of(scan), 0.2)
    chosen = all_finite(scan.points)
    grid.mark(scan, chosen, chosen)


def _ahead(name: str) -> None:
    """Compile what a method needs late, if it knows."""
    from dynaviz.contracts import registry
    from dynaviz.contracts.method import CompilesAhead
    from dynaviz.testing import crossing

    (scan,) = crossing(1)
    method = registry.load("methods", name)
    if issubclass(method, CompilesAhead):
        method.compile_ahead(scan)


def _score() -> None:
    """Record, then score and record a map that lacks half of the points.

    Runs score first. In the other order, two processes would reach the same kernel, and compile all
    later ones twice.
    """
    import numpy as np

    from dynaviz import api
    from dynaviz.engine.external import ExternalMap
    from dynaviz.engine.loop import RunSpec, execute
    from dynaviz.testing import InMemory, crossing
    from dynaviz.views.record.recorder import Recorder

    scans = crossing(9)
    with contextlib.redirect_stderr(io.StringIO()), tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.npy"
        np.save(path, np.concatenate([scan.points for scan in scans])[::2])
        labels = ExternalMap(path, "map")
        with Recorder(Path(folder) / "run.rrd") as recorder:
            execute(RunSpec(labels, InMemory(scans), labels.params), [recorder], recorder)
        api.score(path, InMemory(scans), out=folder)


def quick_to_compile() -> dict[str, Any]:
    """The methods by name, without those that compile for long: they compile on first use."""
    from dynaviz.contracts import registry

    methods = registry.loadable("methods")
    return {name: each for name, each in methods.items() if not each.info.compiles_long}


def main() -> None:
    """Compile the kernels of all methods with ``--all``, else of the quick ones."""
    from dynaviz.contracts import registry

    handles = registry.handles("methods")
    every = "--all" in sys.argv
    with compiling([each.name for each in handles] if every else quick_to_compile()):
        pass


if __name__ == "__main__":
    main()
