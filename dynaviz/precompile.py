"""Compile the kernels of all methods ahead of their first use: ``python -m dynaviz.precompile``."""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """Have the kernels compiled by all cores meanwhile, the first time; one core would take minutes."""
    from dynaviz import kernels, registry

    if kernels.compiled():
        yield
        return
    print(kernels.COMPILING, file=sys.stderr, flush=True)
    families: dict[str, list[str]] = {}  # methods of one file share kernels, which two cores would compile twice
    for handle in registry.handles("methods"):
        families.setdefault(handle.target.partition(":")[0], []).append(handle.name)
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as cores:
        # What fails here is no loss: it fails again where it runs, and is told there.
        cores.submit(_score)
        for names in families.values():
            cores.submit(_clean, names)
        yield


def _clean(names: list[str]) -> None:
    """Have methods see a few scans, and show their states."""
    from dynaviz import registry
    from dynaviz.engine.loop import RunSpec, execute
    from dynaviz.probe import MemoryProbe
    from dynaviz.testing import InMemory, crossing

    with contextlib.redirect_stderr(io.StringIO()):
        for name in names:
            method = registry.load("methods", name)
            execute(RunSpec(method(method.Params()), InMemory(crossing(9)), method.Params()), probe=MemoryProbe())


def _score() -> None:
    """Score and record a map that lacks some points."""
    import numpy as np

    from dynaviz import api
    from dynaviz.testing import InMemory, crossing

    scans = crossing(9)
    with contextlib.redirect_stderr(io.StringIO()), tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder) / "map.npy", np.concatenate([scan.points for scan in scans])[::2])
        api.score(Path(folder) / "map.npy", InMemory(scans), out=folder)


if __name__ == "__main__":
    with compiling():
        pass
