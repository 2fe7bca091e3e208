"""A saved run opened again: its files, its result, and the sequence that its command names."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence as Several
from pathlib import Path
from typing import Any

from dynaviz.contracts.scan import Sequence
from dynaviz.errors import DataError
from dynaviz.scores.result import Result
from dynaviz.sources.odometry.refine import refine
from dynaviz.sources.opening import open_source
from dynaviz.sources.options import SequenceOptions

# Options of commands that open a sequence.
_OPENING = ("frames", "stride", "sensor", "poses", "points_in", "deskew", "extrinsic", "refine_poses")
# Options without a value.
_FLAGS = ("online", "offline", "view", "map", "no-map", "deskew", "no-deskew", "quiet", "refine-poses")


def run_file(path: Path, name: str) -> Path:
    """A file of a run.

    Args:
        path: the run's folder, ``result.json`` or ``run.rrd``.
        name: of the file.

    Raises:
        DataError: if the file does not exist.
    """
    file = path / name if path.is_dir() else path if path.suffix == Path(name).suffix else path.with_name(name)
    if not file.is_file():
        hint = "Give a run that was recorded, without --record none" if name == "run.rrd" else "Give a finished run"
        raise DataError(file, "does not exist", hint=hint)
    return file


def open_result(path: Path) -> tuple[Path, Result]:
    """The file that contains a run's result, and the result.

    Args:
        path: the run's folder, ``result.json`` or ``run.rrd``.

    Raises:
        DataError: if there is no result, or the run did not finish.
    """
    if path.is_dir():
        path = next((path / name for name in ("result.json", "run.rrd") if (path / name).is_file()), path)
        if path.is_dir():
            raise DataError(path, "contains no result.json and no run.rrd", hint="Give the folder of a finished run")
    if path.suffix != ".rrd":
        return path, Result.load(path)
    from dynaviz.views.read.reader import RunRecording

    result = RunRecording(path).result
    if result is None:
        raise DataError(path, "is the recording of a run that did not finish", hint="Run the method again")
    return path, result


def open_sequence_of(result: Result, folder: Path, given: str | os.PathLike[str] | None = None) -> Sequence | None:
    """Open the sequence of a run, with the frames, poses and other options of its command.

    Args:
        result: of the run.
        folder: of the run.
        given: the path of the sequence; None for that in the command.

    Returns:
        None if no path is given and the command names none.

    Raises:
        DataError, UsageError: as ``dynaviz.open``.
    """
    words = shlex.split(result.command)[1:]
    options = sequence_options(words)
    source, refined = options.pop("sequence", None), options.pop("refine_poses", False)
    if words == ["demo"]:
        source = os.fspath(folder.parent / "street")
    if given is None and source is None:
        return None
    sequence = open_source(source if given is None else os.fspath(given), SequenceOptions(**options))
    return refine(sequence, folder) if refined else sequence


def sequence_options(words: Several[str]) -> dict[str, Any]:
    """The sequence of a ``run`` or ``score`` command, or its drives, and how it was opened; {} for other commands."""
    places, options = [], dict[str, Any]()
    left = iter(words)
    for word in left:
        if word == "-o":
            next(left, None)
        elif word.startswith("--"):
            name, joined, value = word[2:].partition("=")
            options[name.replace("-", "_")] = value if joined else True if name in _FLAGS else next(left, None)
        elif not word.startswith("-"):
            places.append(word)
    if len(places) < 3 or places[0] not in ("run", "score"):
        return {}
    if options.pop("no_deskew", False):
        options["deskew"] = False
    opening = {name: value for name, value in options.items() if name in _OPENING}
    if "stride" in opening:
        opening["stride"] = int(opening["stride"])
    return {"sequence": places[2] if len(places) == 3 else places[2:], **opening}
