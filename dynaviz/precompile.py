"""Compile kernels before their first use: ``python -m dynaviz.precompile``, with ``--all`` those of all methods."""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import signal
import sys
import tempfile
from collections.abc import Collection, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

_SPAWN = multiprocessing.get_context("spawn")
LATE = ("freedom", "hmm_mos")  # methods that the demo leaves out, to stay short; compiled on first use


@contextlib.contextmanager
def compiling(late: Collection[str] = LATE) -> Iterator[None]:
    """Compile the kernels on all cores in the background if none are compiled yet; one core would take minutes.

    Args:
        late: names of methods to leave out.
    """
    from dynaviz import kernels
    from dynaviz.contracts import registry

    if kernels.compiled():
        yield
        return
    print(kernels.COMPILING, file=sys.stderr, flush=True)
    families: dict[str, list[str]] = {}  # methods of one file share kernels; two cores would compile these twice
    for handle in registry.handles("methods"):
        if handle.name in late:
            continue
        families.setdefault(handle.target.partition(":")[0], []).append(handle.name)
    with ProcessPoolExecutor(mp_context=_SPAWN) as cores:
        # Errors are ignored here: they occur again, and are reported, when the kernel runs.
        cores.submit(_score)
        for names in families.values():
            cores.submit(_label, names)
        yield


@contextlib.contextmanager
def compiling_the_rest() -> Iterator[None]:
    """Compile on another core what scores and records, while this process compiles the method that it runs.

    Nothing happens if any kernel is compiled already. The other process ends with this block at the latest.
    """
    from dynaviz import kernels

    if kernels.compiled():
        yield
        return
    rest = _SPAWN.Process(target=_score_in_background, daemon=True)
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
            execute(RunSpec(method(method.Params()), InMemory(crossing(9)), method.Params()), probe=MemoryProbe())


def _score_in_background() -> None:
    """As ``_score``, until SIGTERM, which lets it remove its files; errors occur again where the kernels are used."""
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    with contextlib.suppress(Exception, KeyboardInterrupt):
        _score()


def _score() -> None:
    """Score and record a map that lacks half of the points."""
    import numpy as np

    from dynaviz import api
    from dynaviz.testing import InMemory, crossing

    scans = crossing(9)
    with contextlib.redirect_stderr(io.StringIO()), tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder) / "map.npy", np.concatenate([scan.points for scan in scans])[::2])
        api.score(Path(folder) / "map.npy", InMemory(scans), out=folder)


if __name__ == "__main__":
    with compiling(() if "--all" in sys.argv else LATE):
        pass
