"""Numba kernels, loaded on first use.

``kernels.voxels.pack(...)`` imports numba and ``kernels/voxels.py``. ``kernels.load`` does the same
for the kernels of any package.

Rules for a file of kernels:

- Its functions are compiled with ``cache=True``. The cache on disk belongs to the sources of the
  file and of all that it imports, so kernels may share functions and constants.
- Results do not depend on the number of threads: threads write either equal values, or integers of
  their own.
- Parallel kernels are called as ``kernels.FILE.function``, so that they can run one at a time where
  numba's threading layer does not allow more (``workqueue``). No file imports a parallel kernel
  of another.

The first run is dominated by compilation. Do not assign an array to a slice: the formatting of its
error message takes three seconds to compile. Give counters that are passed to other functions a
type: a bare 0 compiles these twice.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from dynaviz.kernels._numba import COMPILING, LAYERS, numba, packages

__all__ = [
    "COMPILING",
    "LAYERS",
    "Kernels",
    "as_readonly",
    "compiled",
    "each",
    "load",
    "one_thread",
    "set_threads",
    "threading_layer",
    "threads_in_use",
]

T = TypeVar("T")
R = TypeVar("R")
_one_at_a_time = threading.RLock()
_loading = threading.RLock()


class Kernels:
    """The kernels of a package by file, loaded on first use; see ``load``."""

    def __init__(self, package: str) -> None:
        self._package = package

    def __getattr__(self, name: str) -> ModuleType:
        if name.startswith("_"):
            raise AttributeError(name)
        numba()
        files = vars(self)
        with _loading:
            if name not in files:
                files[name] = _safe_for_threads(_import(f"{self._package}.{name}"))
        module: ModuleType = files[name]
        return module


@functools.cache
def load(package: str) -> Kernels:
    """The kernels of a package, loaded on first use.

    ``kernels.load("my_package.kernels").counts.add(...)`` imports numba and
    ``my_package/kernels/counts.py``. Several threads may load and call kernels at once.

    Args:
        package: the full name of a package whose files hold kernels: functions with
            ``numba.njit(cache=True)``. They may import functions and constants of other files of
            their top-level package and of dynaviz; the cache on disk notices when these change.
            Write the name as a literal, so that results can state the code of the method.
    """
    packages.add(package.partition(".")[0])
    return Kernels(package)


_core = load(__name__)


def __getattr__(name: str) -> ModuleType:
    return getattr(_core, name)  # type: ignore[no-any-return]


def _import(name: str) -> ModuleType:
    """Import a module, without making it an attribute of its package, where another thread would
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
    most: int = numba().config.NUMBA_NUM_THREADS
    numba().set_num_threads(min(threads or most, most))
    return threads_in_use()


def threads_in_use() -> int:
    """The number of threads that kernels use, which is the number of lanes of scratch memory that
    they need.
    """
    return int(numba().get_num_threads())


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Let kernels use one thread: for little work, starting others would take most of the time."""
    threads = threads_in_use()
    set_threads(1)
    try:
        yield
    finally:
        set_threads(threads)


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

    with one_thread():
        with ThreadPoolExecutor(
            max(threads - 1, 1), initializer=set_threads, initargs=(1,)
        ) as pool:
            others = [pool.submit(work) for _ in range(threads - 1)]
            work()
        for other in others:
            other.result()
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
    """Whether an earlier process has stored compiled kernels on disk, and no source file of
    dynaviz's is newer.
    """
    stored = getattr(_core.voxels.insert, "stats", None)
    if stored is None:  # NUMBA_DISABLE_JIT: there is nothing to compile
        return True
    sources = Path(__file__).parent.glob("[!_]*.py")
    newest = max(file.stat().st_mtime for file in sources)
    return any(file.stat().st_mtime >= newest for file in Path(stored.cache_path).glob("*.nbi"))


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
