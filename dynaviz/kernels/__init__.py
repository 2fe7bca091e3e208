"""Numba kernels, loaded on first use.

``kernels.voxels.pack(...)`` imports numba and ``kernels/voxels.py``.

Rules for a file in this folder:

- It calls no function of another file, because numba's cache on disk does not notice changes there.
- Its functions are compiled with ``cache=True``.
- Results do not depend on the number of threads: threads write either equal values, or integers of
  their own.
- Parallel kernels are called as ``kernels.FILE.function``, so that they can run one at a time where
  numba's threading layer does not allow more (``workqueue``).

The first run is dominated by compilation. Do not assign an array to a slice: the formatting of its
error message takes three seconds to compile. Give counters that are passed to other functions a
type: a bare 0 compiles these twice.
"""

from __future__ import annotations

import functools
import gc
import importlib.util
import os
import sys
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

COMPILING = "compiling kernels, first run only ..."
LAYERS = ("omp", "workqueue", "tbb")
"""Threading layers of numba, in order of preference.

- ``omp`` needs OpenMP: libgomp on Linux, vcomp140.dll on Windows, libomp on macOS. Each thread that
  calls a kernel has its own team of threads, so several runs at once are safe.
- ``workqueue`` needs nothing. It serves one thread at a time, so parallel kernels take turns.
- ``tbb`` is never reached, only selected with ``NUMBA_THREADING_LAYER=tbb``: numba takes whatever
  TBB another package has loaded before, and warns if it is too old.
"""
T = TypeVar("T")
R = TypeVar("R")
_prepared = False
_one_at_a_time = threading.RLock()
_loading = threading.RLock()


def __getattr__(name: str) -> ModuleType:
    if name.startswith("_"):
        raise AttributeError(name)
    _numba()
    with _loading:
        if name not in globals():
            globals()[name] = _safe_for_threads(_load(f"{__name__}.{name}"))
    module: ModuleType = globals()[name]
    return module


def _load(name: str) -> ModuleType:
    """Import a module, without making it an attribute of this package, where another thread would
    find it at once.
    """
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.find_spec(name)
    if spec is None or spec.loader is None:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def as_readonly(array: Any, dtype: DTypeLike) -> NDArray[Any]:
    """A read-only, C-contiguous view or copy of an array, so that each kernel is compiled for one
    type only.
    """
    view = np.ascontiguousarray(array, dtype).view()
    view.flags.writeable = False
    return view


def set_threads(threads: int | None) -> int:
    """Set the maximum number of threads of kernels (None for all); return the number in use."""
    numba = _numba()
    most: int = numba.config.NUMBA_NUM_THREADS
    numba.set_num_threads(min(threads or most, most))
    return threads_in_use()


def threads_in_use() -> int:
    """The number of threads that kernels use, which is the number of lanes of scratch memory that
    they need.
    """
    return int(_numba().get_num_threads())


def each(call: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """The results of a call for each item. This thread and others take the items in order.

    Each runs kernels alone.
    """
    waiting = enumerate(list(items))
    results = dict[int, R]()
    threads = threads_in_use()

    def work() -> None:
        for number, item in waiting:  # the threads share the iterator
            results[number] = call(item)

    set_threads(1)
    try:
        with ThreadPoolExecutor(
            max(threads - 1, 1), initializer=set_threads, initargs=(1,)
        ) as pool:
            others = [pool.submit(work) for _ in range(threads - 1)]
            work()
        for other in others:
            other.result()
    finally:
        set_threads(threads)
    return [results[number] for number in sorted(results)]


def threading_layer() -> str | None:
    """The threading layer of numba in this process, one of ``LAYERS``.

    None if no kernel has run yet.
    """
    try:
        return str(sys.modules["numba"].threading_layer())
    except (KeyError, ValueError):  # not imported, not chosen
        return None


def compiled() -> bool:
    """Whether an earlier process has stored compiled kernels on disk."""
    folders = [folder] if (folder := os.environ.get("NUMBA_CACHE_DIR")) else __path__
    return any(next(Path(folder).glob("**/*.nbi"), None) for folder in folders)


def _safe_for_threads(module: ModuleType) -> ModuleType:
    """The module, or a copy whose kernels run one at a time.

    Several threads may call parallel kernels at once with the threading layers ``omp`` and ``tbb``.
    With ``workqueue`` that ends the process.
    """
    kernels = {
        name: value for name, value in vars(module).items() if hasattr(value, "targetoptions")
    }
    if not any(kernel.targetoptions.get("parallel") for kernel in kernels.values()):
        return module
    threads_in_use()  # loads the threading layer
    if threading_layer() != "workqueue":
        return module
    copy = ModuleType(module.__name__, module.__doc__)
    vars(copy).update(vars(module), **{name: _locked(kernel) for name, kernel in kernels.items()})
    return copy


def _locked(kernel: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(kernel)
    def call(*arguments: Any) -> Any:
        with _one_at_a_time:
            return kernel(*arguments)

    return call


def _numba() -> Any:
    """The package numba, prepared on first use: see ``LAYERS``."""
    global _prepared
    import numba

    with _loading:
        if not _prepared:
            _prepared = True
            _postpone_blas()
            _watch_compilation()
            if "NUMBA_THREADING_LAYER_PRIORITY" not in os.environ:
                numba.config.THREADING_LAYER_PRIORITY = list(LAYERS)  # type: ignore[attr-defined]
    return numba


def _postpone_blas() -> None:
    """Let numba look for scipy's linear algebra only when a function that needs it is compiled.

    It would import it with the first kernel, for 0.3 s and 20 MB.
    """
    from numba.np import linalg

    check = linalg.ensure_blas
    linalg.ensure_blas = lambda: None
    try:
        from numba.np import arraymath  # noqa: F401
    finally:
        linalg.ensure_blas = check


def _watch_compilation() -> None:
    """Print a message on the first compilation of this process, and collect no garbage while a
    kernel is compiled.

    The compiler makes so many objects that collections would take a fifth of its time.
    """
    from numba.core import event

    class Watcher(event.Listener):
        announced = False
        depth = 0  # of kernels that call kernels; the compiler serves one thread at a time
        collects = False  # before the outermost kernel

        def on_start(self, event: Any) -> None:
            if not self.announced:
                self.announced = True
                from rich.console import Console

                Console(stderr=True).print(f"[dim]{COMPILING}[/]")
            if self.depth == 0:
                self.collects = gc.isenabled()
                gc.disable()
            self.depth += 1

        def on_end(self, event: Any) -> None:
            self.depth -= 1
            if self.depth == 0 and self.collects:
                gc.enable()

    event.register("numba:compile", Watcher())
