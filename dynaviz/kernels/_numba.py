"""The package numba, prepared on first use."""

from __future__ import annotations

import gc
import os
import threading
from functools import cache
from pathlib import Path
from typing import Any

from dynaviz import source_files

COMPILING = "compiling kernels"  # begins what is printed when kernels are compiled
LAYERS = ("omp", "workqueue", "tbb")
"""Threading layers of numba, in order of preference.

- ``omp`` needs OpenMP: libgomp on Linux, vcomp140.dll on Windows, libomp on macOS. Each thread that
  calls a kernel has its own team of threads, so several runs at once are safe.
- ``workqueue`` needs nothing. It serves one thread at a time, so parallel kernels take turns.
- ``tbb`` is never reached, only selected with ``NUMBA_THREADING_LAYER=tbb``: numba takes whatever
  TBB another package has loaded before, and warns if it is too old.
"""
packages = {"dynaviz"}
"""Importable top-level packages that have kernels."""
_prepared = False
_preparing = threading.RLock()


def numba() -> Any:
    """The package numba, prepared: see ``LAYERS``."""
    global _prepared
    import numba

    with _preparing:
        if not _prepared:
            _prepared = True
            _postpone_blas()
            _watch_compilation()
            _stamp_caches()
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
    """Say what is compiled, once for each package or method of this process, and collect no
    garbage while a kernel is compiled.

    The compiler makes so many objects that collections would take a fifth of its time.
    """
    from numba.core import event

    class Watcher(event.Listener):
        depth = 0  # of kernels that call kernels; the compiler serves one thread at a time
        collects = False  # before the outermost kernel

        def __init__(self) -> None:
            self.announced = set[str]()

        def on_start(self, event: Any) -> None:
            owner = _owner(event.data["dispatcher"].py_func.__module__ or "")
            if self.depth == 0 and owner not in self.announced:
                self.announced.add(owner)
                from rich.console import Console

                Console(stderr=True).print(f"[dim]{COMPILING} of {owner}, kept for later ...[/]")
            if self.depth == 0:
                self.collects = gc.isenabled()
                gc.disable()
            self.depth += 1

        def on_end(self, event: Any) -> None:
            self.depth -= 1
            if self.depth == 0 and self.collects:
                gc.enable()

    event.register("numba:compile", Watcher())


def _owner(module: str) -> str:
    """Whose kernels a module has: the part of a package, such as a method, or the package."""
    parts = module.split(".")
    before = parts[: parts.index("kernels")] if "kernels" in parts else parts
    return before[-1] if before else module


def _stamp_caches() -> None:
    """Let numba's cache on disk belong to all sources of a kernel.

    Numba looks at the file of the kernel only, and would not notice a change in a file from which
    that imports a function or a constant.
    """
    from numba.core import caching

    locator = caching._SourceFileBackedLocatorMixin
    stamp_of_file = locator.get_source_stamp

    def get_source_stamp(self: Any) -> Any:
        return _digest(self._py_file) or stamp_of_file(self)

    locator.get_source_stamp = get_source_stamp  # type: ignore[method-assign]


@cache
def _digest(file: str) -> str:
    """A digest of a file of ``packages``, and of what it imports from there; empty for others."""
    path = Path(file)
    for package in packages:
        for root in source_files.folders(package):
            if path.is_relative_to(root) and path.is_file():
                parts = path.relative_to(root).with_suffix("").parts
                return _digest_of_module(".".join((package, *parts)), package)
    return ""


def _digest_of_module(name: str, package: str) -> str:
    own = "dynaviz", package
    files = source_files.closure(name, lambda other: source_files.is_within(other, *own))
    return source_files.digest(files)
