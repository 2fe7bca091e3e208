"""One cell of a bench as a task: run it, and check whether it is finished."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from dynaviz.benchmarking.plan import BenchCell, SequenceSpec, settings
from dynaviz.benchmarking.source import open_spec
from dynaviz.contracts.plugin_code import plugin
from dynaviz.engine.outputs import FILES
from dynaviz.errors import DataError, DynavizError
from dynaviz.io.atomic import sha256
from dynaviz.progress import Progress, silent
from dynaviz.runs.execution import Surveyed, run_method
from dynaviz.runs.options import RunOptions
from dynaviz.runs.reviewed import digest_of
from dynaviz.scores.result import Result, environment
from dynaviz.sources.drive import Drive

DECIDING = ("dynaviz", "numba", "numpy", "scipy")  # packages whose versions may change labels


@dataclass(frozen=True)
class CellTask:
    """A cell of a bench, as a ``dynaviz.tasks.task.Task``; its last file is ``result.json``."""

    cell: BenchCell
    kind = "cell"
    smaller = "Use --record errors or scores, or run it without --scheduler."
    files = (*FILES, "run.rrd", "config.toml", "result.json")

    @property
    def path(self) -> Path:
        """Its folder, relative to the folder of the bench."""
        return self.cell.path

    @property
    def facts(self) -> Mapping[str, str]:
        """What identifies the cell."""
        chosen = self.cell.parameter_set
        return {
            "method": chosen.method,
            "sequence": self.cell.source.name,
            "variant": chosen.variant,
        }

    def run(self, folder: Path, threads: int | None, progress: Progress = silent) -> None:
        """Run the cell in this process.

        Raises:
            DynavizError: as ``dynaviz.run``, or if the data changed since the bench started.
        """
        cell = self.cell
        chosen = self.cell.parameter_set
        options = RunOptions(
            settings=chosen.parameters,
            online=chosen.online,
            seed=chosen.seed,
            variant=chosen.variant,
            threads=threads,
            record=cell.record,
            review=cell.review or None,
        )
        sequence = open_spec(cell.source)
        refine = cell.source.options.refine_poses
        result = run_method(
            chosen.method,
            sequence,
            options,
            out=folder,
            refine_poses=refine,
            survey=None if refine else _surveyed(cell.source, sequence, progress),
            command=command(cell),
            progress=progress,
        )
        if problem := difference(cell, result, folder):
            raise DynavizError(
                f"the result does not match the cell: {problem}. Run the bench again."
            )

    def finished(self, folder: Path) -> bool:
        """Whether its result is complete and has the same data, parameters and versions."""
        return result_of(self.cell, folder) is not None


_surveys: dict[
    tuple[SequenceSpec, int, int], Surveyed
] = {}  # of the last sequence that this process has read


def _surveyed(source: SequenceSpec, sequence: Drive, progress: Progress) -> Surveyed | None:
    """The survey of a sequence, whose cells follow each other.

    Made again if a file was added, removed or written.

    None for a path that cannot be watched, such as that of a simulation.
    """
    files = [
        file.stat()
        for name in (source.path, source.options.poses or source.path)
        for file in _files(Path(name))
    ]
    if not files:
        return None
    key = source, len(files), max(file.st_mtime_ns for file in files)
    if key not in _surveys:
        _surveys.clear()
        _surveys[key] = Surveyed.of(sequence, progress)
    return _surveys[key]


def _files(place: Path) -> Iterator[Path]:
    """A file or folder, and all that is in it; nothing if there is none."""
    if place.exists():
        yield from (place, *place.rglob("*"))


def result_of(cell: BenchCell, folder: Path) -> Result | None:
    """The result of a finished cell, if it is complete and has the same data, parameters and
    versions; else None.
    """
    result, problem = earlier_result(cell, folder)
    return None if problem else result


def earlier_result(cell: BenchCell, folder: Path) -> tuple[Result | None, str]:
    """The result in the folder of a cell, and why it is not that of the cell, as a clause.

    Empty if it is.
    """
    try:
        result = Result.load(folder / "result.json")
    except DataError:
        return None, ""
    return result, difference(cell, result, folder) or ""


def difference(cell: BenchCell, result: Result, folder: Path) -> str | None:
    """The first property in which a result differs from its cell, as text; None if it matches."""
    recorded = None if cell.record == "none" else cell.record
    here = environment()
    there = result.environment
    chosen = cell.parameter_set
    code = plugin("methods", cell.parameter_set.method)
    same: dict[str, tuple[Any, Any]] = {  # what the result has, and what the cell needs
        "sequence": (result.sequence.name, cell.source.name),
        "digest": (result.sequence.digest, cell.digest),
        "method": (result.method, chosen.method),
        "variant": (result.variant, chosen.variant),
        "parameters": (result.parameters, dict(chosen.parameters)),
        "online": (result.online, chosen.online),
        "seed": (result.seed, chosen.seed),
        "recording": (result.record, recorded),
        "review": (result.sections.review and result.sections.review.sha256, _review(cell)),
        "code": (result.plugin.sha256 if result.plugin else "", code.sha256 if code else ""),
        **{package: (there.versions.get(package), here.versions[package]) for package in DECIDING},
    }
    if cell.timing:
        same["machine"] = there.machine, here.machine
        same["threads"] = result.runtime.threads, here.machine.cores
        same["states recorded"] = result.instrumented, False
    for name, (found, needed) in same.items():
        if _plain(found) != _plain(needed):
            changed = {"code": f"the code of {chosen.method}", "review": "the review"}
            return (
                f"{changed[name]} changed"
                if name in changed
                else f"{name} is {found!r}, not {needed!r}"
            )
    if recorded:
        with contextlib.suppress(OSError):
            if sha256(folder / "run.rrd") == result.recording_sha256:
                return None
        return "run.rrd is missing or was changed"
    return None


def _review(cell: BenchCell) -> str | None:
    """The digest of the decisions that a cell follows; None if it follows none."""
    return digest_of(cell.review) if cell.review else None


def command(cell: BenchCell) -> str:
    """The command that runs this cell alone."""
    source = cell.source
    chosen = cell.parameter_set
    words = ["dynaviz", "run", chosen.method, source.path, *source.options.words]
    words += [
        word
        for text in settings(chosen.parameters)
        for word in ("--set", text.replace(" = ", "=", 1))
    ]
    words += ["--online"] if chosen.online else []
    words += ["--seed", str(chosen.seed), "--record", cell.record]
    words += ["--review", cell.review] if cell.review else []
    return shlex.join(words)


def _plain(value: Any) -> Any:
    """A value as read back from JSON: tuples become lists, and structures become dicts."""
    return msgspec.json.decode(msgspec.json.encode(value))
