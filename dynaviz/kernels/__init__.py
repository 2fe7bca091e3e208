"""Numba kernels, loaded when first used: ``kernels.voxels.pack(...)`` imports numba and ``kernels/voxels.py`` then.

Rules for a file here: leaf functions only, no call into another file (the cache on disk does not see its changes);
``cache=True``; the same answer on any number of threads, so threads store only equal values or integers of their own.
Parallel kernels run on the main thread only.

Compiling is what a newcomer waits for: an array assigned to a slice brings three seconds of text formatting for its
error, and a counter that begins as a bare 0 compiles those who take it twice.
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

COMPILING = "compiling kernels, first run only ..."
_heard = False


def __getattr__(name: str) -> ModuleType:
    if name.startswith("_"):
        raise AttributeError(name)
    _tell_when_compiling()
    return importlib.import_module(f"dynaviz.kernels.{name}")


def as_readonly(array: Any, dtype: DTypeLike) -> NDArray[Any]:
    """A read-only, C-contiguous view or copy: kernels then see one type each and are compiled once."""
    view = np.ascontiguousarray(array, dtype).view()
    view.flags.writeable = False
    return view


def set_threads(threads: int | None) -> int:
    """Use at most this many threads in kernels (None: all); returns the number in use."""
    import numba

    most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]  # set when numba starts
    numba.set_num_threads(min(threads or most, most))
    return threads_in_use()


def threads_in_use() -> int:
    """How many threads kernels use: as many lanes of scratch memory serve them all."""
    import numba

    return int(numba.get_num_threads())


def compiled() -> bool:
    """Whether there are compiled kernels on disk, from an earlier process."""
    folders = [elsewhere] if (elsewhere := os.environ.get("NUMBA_CACHE_DIR")) else __path__
    return any(next(Path(folder).glob("**/*.nbi"), None) for folder in folders)


def _tell_when_compiling() -> None:
    """Say once, on the first compilation of this process, what the wait is for."""
    global _heard
    if _heard:
        return
    _heard = True
    from numba.core import event

    class Teller(event.Listener):
        told = False

        def on_start(self, event: Any) -> None:
            if not Teller.told:
                Teller.told = True
                from rich.console import Console

                Console(stderr=True).print(f"[dim]{COMPILING}[/]")

        def on_end(self, event: Any) -> None:
            return None

    event.register("numba:compile", Teller())
