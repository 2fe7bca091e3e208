"""One cell of a bench: run it, keep its error, and tell whether it is done."""

from __future__ import annotations

import contextlib
import json
import shlex
import traceback
from pathlib import Path
from typing import Any

from dynaviz import api
from dynaviz.benchmarking.plan import BenchCell, settings
from dynaviz.benchmarking.source import open_source
from dynaviz.engine.outputs import FILES
from dynaviz.errors import DataError, DynavizError
from dynaviz.io.atomic import sha256, write_atomic
from dynaviz.progress import Progress, silent
from dynaviz.results.result import Result, environment

ALL_FILES = (*FILES, "run.rrd", "config.toml", "result.json", "error.json", "error.log")
DECIDING = ("dynaviz", "numba", "numpy", "scipy")  # packages whose versions decide about labels


def run(cell: BenchCell, folder: Path, threads: int | None, progress: Progress = silent) -> Result:
    """Run a cell in this process, into a folder without files of an earlier run.

    Raises:
        DynavizError: as ``dynaviz.run``, or where the data are others than those that the bench began with.
    """
    result = api.run(
        cell.what.method,
        open_source(cell.source),
        out=folder,
        record=cell.record,
        settings=settings(cell.what.parameters),
        online=cell.what.online,
        seed=cell.what.seed,
        variant=cell.what.variant,
        threads=threads,
        command=command(cell),
        progress=progress,
    )
    if problem := difference(cell, result, folder):
        raise DynavizError(f"what came out is not what was asked for: {problem}.")
    return result


def clear(folder: Path) -> None:
    """Remove the files of a run; ``result.json`` first, for it says that the others are whole."""
    for name in ("result.json", *ALL_FILES):
        (folder / name).unlink(missing_ok=True)


def finished(cell: BenchCell, folder: Path) -> Result | None:
    """The result of a cell that is done, whole and of exactly these data, parameters and versions; else None."""
    try:
        result = Result.load(folder / "result.json")
    except DataError:
        return None
    return None if difference(cell, result, folder) else result


def difference(cell: BenchCell, result: Result, folder: Path) -> str | None:
    """The first thing in which a result is not the cell's, in words; None where it is."""
    recorded = None if cell.record == "none" else cell.record
    here, there = environment(), result.environment
    asked: dict[str, Any] = {
        "sequence": cell.source.name,
        "digest": cell.digest,
        "method": cell.what.method,
        "variant": cell.what.variant,
        "parameters": dict(cell.what.parameters),
        "online": cell.what.online,
        "seed": cell.what.seed,
        "recording": recorded,
        **{package: here.versions[package] for package in DECIDING},
    }
    told: dict[str, Any] = {
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
        asked |= {"machine": here.machine, "threads": here.machine.cores, "states recorded": False}
        told |= {
            "machine": there.machine,
            "threads": result.runtime.threads,
            "states recorded": result.instrumented,
        }
    for name, value in asked.items():
        if _plain(value) != _plain(told[name]):
            return f"{name} is {told[name]!r}, not {value!r}"
    if recorded:
        with contextlib.suppress(OSError):
            if sha256(folder / "run.rrd") == result.recording_sha256:
                return None
        return "run.rrd is missing or not the one that was written"
    return None


def fail(cell: BenchCell, folder: Path, error: str) -> None:
    """Leave ``error.json`` in place of a result."""
    (folder / "result.json").unlink(missing_ok=True)
    facts = {"method": cell.what.method, "sequence": cell.source.name, "variant": cell.what.variant, "error": error}
    write_atomic(folder / "error.json", json.dumps(facts, indent=1).encode())


def error_of(folder: Path) -> str | None:
    """What ``error.json`` in a folder says, if it is there."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        return str(json.loads((folder / "error.json").read_bytes())["error"])
    return None


def sentence(error: BaseException) -> str:
    """An error in one line: a user's mistake as it is told, any other with its type."""
    if isinstance(error, DynavizError):
        return str(error)
    return " ".join("".join(traceback.format_exception_only(error)).split())


def command(cell: BenchCell) -> str:
    """The command that runs this cell alone."""
    source, what = cell.source, cell.what
    words = ["dynaviz", "run", what.method, source.path]
    words += ["--frames", str(source.frames)] if source.frames and not source.scene else []
    words += ["--stride", str(source.stride)] if source.stride > 1 else []
    words += ["--sensor", source.sensor] if source.sensor else []
    words += ["--poses", source.poses] if source.poses else []
    words += ["--points-in", source.points_in] if source.points_in else []
    words += ["--no-deskew"] if source.deskew is False else []
    words += [word for text in settings(what.parameters) for word in ("--set", text.replace(" = ", "=", 1))]
    words += ["--online"] if what.online else []
    words += ["--seed", str(what.seed), "--record", cell.record]
    return shlex.join(words)


def _plain(value: Any) -> Any:
    """As JSON holds it: tuples are lists."""
    return json.loads(json.dumps(value))
