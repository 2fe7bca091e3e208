"""How a method runs on a sequence: one set of options for the command line and for Python."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, TypedDict

from dynaviz.contracts import params, registry
from dynaviz.errors import UsageError
from dynaviz.scores.result import RecordMode
from dynaviz.sources.options import SequenceKeywords, SequenceOptions

Record = Literal[RecordMode, "none"]
Settings = Iterable[str] | Mapping[str, Any]


class MethodKeywords(TypedDict, total=False):
    """The keyword arguments of Python functions that start a method; see ``MethodOptions``."""

    preset: str | None
    config: str | os.PathLike[str] | None
    settings: Settings
    seed: int | None
    threads: int | None


class RunKeywords(MethodKeywords, total=False):
    """The keyword arguments of Python functions that run a method on a sequence.

    See ``RunOptions``.
    """

    online: bool | None
    variant: str
    record: Record | str | os.PathLike[str]
    record_budget: int | str | None
    view: bool
    tiles: float | str | None
    workers: int
    scheduler: str | None
    maps: bool
    review: str | os.PathLike[str] | None


class SequenceRunKeywords(SequenceKeywords, RunKeywords, total=False):
    """The keyword arguments of Python functions that open a sequence and run a method on it."""


@dataclass(frozen=True)
class MethodOptions:
    """With which parameters a method starts.

    Attributes:
        preset, config, settings: layers of parameters (``dynaviz.contracts.params.resolve``);
            settings may be a dictionary.
        seed: for all randomness in the method.
        threads: for kernels; None for all cores.
    """

    preset: str | None = None
    config: str | os.PathLike[str] | None = None
    settings: Settings = ()
    seed: int | None = None
    threads: int | None = None

    def __post_init__(self) -> None:
        if self.seed is not None and self.seed < 0:
            raise UsageError(f"seed = {self.seed}: give 0 or a positive number")

    def resolved(self, method: str) -> tuple[Any, params.Resolved]:
        """The class of a method, and its parameters.

        Raises:
            UsageError: for an unknown method, preset or parameter, or an invalid value.
        """
        kind = registry.load("methods", method)
        return kind, params.resolve(kind, self.preset, self.config, self.settings)


@dataclass(frozen=True)
class RunOptions(MethodOptions):
    """How a method runs on a sequence.

    Every verb that runs one takes all of these, under the same names.

    Attributes:
        online: label each scan right after it was observed, instead of after all scans.
        variant: a short name for the parameter set, for tables.
        record: how much the recording ``run.rrd`` contains (``recordings/README.md``); or the path
            of an ``.rrd`` file, which records in the mode ``errors``, with or without a folder.
        record_budget: size of the recordings together, bytes or text such as ``2GB``: states are
            left out first, then drawn points; the labels of all points are always recorded. None
            for any size.
        view: show the run in a viewer while it is running.
        tiles: edge of the squares into which the map is divided, metres; None runs it as a whole.
            Needs a folder. An interrupted run continues with the tiles that are missing.
        workers: number of tiles that run at a time, each in its own process.
        scheduler: address of a Dask scheduler whose workers run the tiles instead.
        maps: write ``static_map.pcd`` and ``dynamic_points.pcd``.
        review: a file with decisions (``docs/review.md``), which maps and ground truth follow. The
            labels stay those of the method.
    """

    online: bool | None = None
    variant: str = ""
    record: Record | str | os.PathLike[str] = "errors"
    record_budget: int | str | None = None
    view: bool = False
    tiles: float | str | None = None
    workers: int = 1
    scheduler: str | None = None
    maps: bool = True
    review: str | os.PathLike[str] | None = None

    @property
    def tile_size(self) -> float | None:
        """Edge of the tiles, metres; None to run the map as a whole.

        Raises:
            UsageError: for text that is not a number.
        """
        try:
            return None if self.tiles is None else float(self.tiles)
        except ValueError:
            raise UsageError(
                f"--tiles {self.tiles}: give metres, from 10 to 1000; or autoware, for clean"
            ) from None


def split(options: Mapping[str, Any]) -> tuple[SequenceOptions, RunOptions]:
    """The options of opening, and those of running."""
    names = {each.name for each in fields(SequenceOptions)}
    opening: Any = {name: value for name, value in options.items() if name in names}
    running: Any = {name: value for name, value in options.items() if name not in names}
    return SequenceOptions.of(**opening), RunOptions(**running)
