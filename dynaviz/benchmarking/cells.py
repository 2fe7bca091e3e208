"""One cell of a bench: run it, store its error, and check whether it is finished."""

from __future__ import annotations

import contextlib
import json
import shlex
import traceback
from pathlib import Path
from typing import Any

import msgspec

from dynaviz import api
from dynaviz.benchmarking.plan import BenchCell, settings
from dynaviz.benchmarking.source import open_source
from dynaviz.engine.outputs import FILES
from dynaviz.errors import DataError, DynavizError
from dynaviz.io.atomic import sha256, write_atomic
from dynaviz.progress import Progress, silent
from dynaviz.results.result import Result, environment

ALL_FILES = (*FILES, "run.rrd", "config.toml", "result.json", "error.json", "error.log")
DECIDING = ("dynaviz", "numba", "numpy", "scipy")  # packages whose versions may change labels


def run(cell: BenchCell, folder: Path, threads: int | None, progress: Progress = silent) -> Result:
    """Run a cell in this process. The folder must not contain files of an earlier run.

    Raises:
        DynavizError: as ``dynaviz.run``, or if the data changed since the bench started.
    """
    result = api.run(
        cell.parameter_set.method,
        open_source(cell.source),
        out=folder,
        record=cell.record,
        settings=settings(cell.parameter_set.parameters),
        online=cell.parameter_set.online,
        seed=cell.parameter_set.seed,
        variant=cell.parameter_set.variant,
        threads=threads,
        command=command(cell),
        progress=progress,
    )
    if problem := difference(cell, result, folder):
        raise DynavizError(f"the result does not match the cell: {problem}. Run the bench again.")
    return result


def clear(folder: Path) -> None:
    """Remove the files of a run; ``result.json`` first, because its presence marks the others as complete."""
    for name in ("result.json", *ALL_FILES):
        (folder / name).unlink(missing_ok=True)


def finished(cell: BenchCell, folder: Path) -> Result | None:
    """The result of a finished cell, if it is complete and has the same data, parameters and versions; else None."""
    try:
        result = Result.load(folder / "result.json")
    except DataError:
        return None
    return None if difference(cell, result, folder) else result


def difference(cell: BenchCell, result: Result, folder: Path) -> str | None:
    """The first property in which a result differs from its cell, as text; None if it matches."""
    recorded = None if cell.record == "none" else cell.record
    here, there = environment(), result.environment
    expected: dict[str, Any] = {
        "sequence": cell.source.name,
        "digest": cell.digest,
        "method": cell.parameter_set.method,
        "variant": cell.parameter_set.variant,
        "parameters": dict(cell.parameter_set.parameters),
        "online": cell.parameter_set.online,
        "seed": cell.parameter_set.seed,
        "recording": recorded,
        **{package: here.versions[package] for package in DECIDING},
    }
    actual: dict[str, Any] = {
        "sequence": result.sequence.name,
        "digest": result.sequence.digest,
        "method": result.method,
        "variant": result.variant,
        "parameters": result.parameters,
        "online": result.online,
        "seed": result.seed,
        "recording": result.record,
        **{package: there.versions.get(package) for package in DECIDING},
    }
    if cell.timing:
        expected |= {"machine": here.machine, "threads": here.machine.cores, "states recorded": False}
        actual |= {
            "machine": there.machine,
            "threads": result.runtime.threads,
            "states recorded": result.instrumented,
        }
    for name, value in expected.items():
        if _plain(value) != _plain(actual[name]):
            return f"{name} is {actual[name]!r}, not {value!r}"
    if recorded:
        with contextlib.suppress(OSError):
            if sha256(folder / "run.rrd") == result.recording_sha256:
                return None
        return "run.rrd is missing or was changed"
    return None


def fail(cell: BenchCell, folder: Path, error: str) -> None:
    """Write ``error.json`` in place of a result."""
    (folder / "result.json").unlink(missing_ok=True)
    facts = {
        "method": cell.parameter_set.method,
        "sequence": cell.source.name,
        "variant": cell.parameter_set.variant,
        "error": error,
    }
    write_atomic(folder / "error.json", json.dumps(facts, indent=1).encode())


def error_of(folder: Path) -> str | None:
    """The error in the ``error.json`` of a folder, or None."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        return str(json.loads((folder / "error.json").read_bytes())["error"])
    return None


def sentence(error: BaseException) -> str:
    """An error in one line; errors other than ``DynavizError`` with their type."""
    if isinstance(error, DynavizError):
        return str(error)
    return " ".join("".join(traceback.format_exception_only(error)).split())


def command(cell: BenchCell) -> str:
    """The command that runs this cell alone."""
    source, chosen = cell.source, cell.parameter_set
    words = ["dynaviz", "run", chosen.method, source.path]
    words += ["--frames", str(source.frames)] if source.frames and not source.scene else []
    words += ["--stride", str(source.stride)] if source.stride > 1 else []
    words += ["--sensor", source.sensor] if source.sensor else []
    words += ["--poses", source.poses] if source.poses else []
    words += ["--points-in", source.points_in] if source.points_in else []
    words += ["--no-deskew"] if source.deskew is False else []
    words += [word for text in settings(chosen.parameters) for word in ("--set", text.replace(" = ", "=", 1))]
    words += ["--online"] if chosen.online else []
    words += ["--seed", str(chosen.seed), "--record", cell.record]
    return shlex.join(words)


def _plain(value: Any) -> Any:
    """A value as read back from JSON: tuples become lists, and structures become dicts."""
    return msgspec.json.decode(msgspec.json.encode(value))
