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
from collections.abc import Collection, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

_SPAWN = multiprocessing.get_context("spawn")
# methods that the demo leaves out, to stay short; compiled on first use
LATE = (
    "freedom",
    "hmm_mos",
)


@contextlib.contextmanager
def compiling(late: Collection[str] = LATE) -> Iterator[None]:
    """Compile the kernels on all cores in the background if none are compiled yet.

    One core would take minutes.

    Args:
        late: names of methods to leave out.
    """
    from dynaviz import kernels
    from dynaviz.contracts import registry

    if kernels.compiled():
        yield
        return
    print(kernels.COMPILING, file=sys.stderr, flush=True)
    families: dict[
        str, list[str]
    ] = {}  # methods of one file share kernels; two cores would compile these twice
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
    """Compile on another core what casts rays, joins, scores and records, while this process runs a
    method.

    Nothing happens if any kernel is compiled already. The other process ends with this block at the
    latest.
    """
    from dynaviz import kernels

    if kernels.compiled():
        yield
        return
    rest = _SPAWN.Process(target=_the_rest, daemon=True)
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


def _the_rest() -> None:
    """Compile until SIGTERM, which lets this process remove its files.

    Errors occur again where kernels are used.
    """
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    with (
        contextlib.suppress(Exception, KeyboardInterrupt),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        _cast()
        _score()


def _cast() -> None:
    """Cast the rays of a scan, count its voxels and join its points.

    Kernels that compile for long and come late.
    """
    import numpy as np

    from dynaviz import kernels
    from dynaviz.arrays import all_finite
    from dynaviz.blocks.blocks import VOXELS, BlockGrid
    from dynaviz.contracts.extent import Extent
    from dynaviz.testing import crossing

    (scan,) = crossing(1)
    grid = BlockGrid(Extent.of(scan), 0.2)
    chosen = all_finite(scan.points)
    marks = grid.mark(scan, chosen, chosen)
    near = kernels.clearance.grown(
        np.zeros((len(marks.blocks) + 1, 8), np.uint64),
        np.zeros((len(marks.blocks), 6), np.int32),
        1,
    )
    counts = [np.zeros((len(grid) + 1, VOXELS), np.uint16) for _ in range(3)]
    kernels.clearance.count(marks.blocks, marks.bits, near, *counts)
    at = kernels.as_readonly(scan.position[:2], np.float64)
    objects, cells, wider = kernels.clusters.cells_of(scan.points, chosen, at, 0.2, 0.05)
    order = np.argsort(cells)
    kernels.clusters.connect(objects, order, cells[order], wider)


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


if __name__ == "__main__":
    with compiling(() if "--all" in sys.argv else LATE):
        pass
