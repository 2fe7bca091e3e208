"""Compile the kernels of all methods ahead of their first use: ``python -m dynaviz.precompile``."""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """Have the methods' kernels compiled by all cores meanwhile, the first time; one core would take a minute."""
    from dynaviz import kernels, registry

    if kernels.compiled():
        yield
        return
    print(kernels.COMPILING, file=sys.stderr, flush=True)
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as cores:
        # What fails here is no loss: it fails again where the method runs, and is told there.
        cores.map(_compile, [handle.name for handle in registry.handles("methods")])
        yield


def _compile(name: str) -> None:
    from dynaviz import api
    from dynaviz.testing import InMemory, crossing

    with contextlib.redirect_stderr(io.StringIO()), tempfile.TemporaryDirectory() as folder:
        api.run(name, InMemory(crossing(9)), out=folder)


if __name__ == "__main__":
    with compiling():
        pass
