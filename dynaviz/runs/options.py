"""How a method runs on a sequence: one set of options for the command line and for Python."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TypedDict

from dynaviz.contracts import params, registry
from dynaviz.contracts.options import Record, option
from dynaviz.errors import UsageError
from dynaviz.sources.options import SequenceKeywords, SequenceOptions

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
    """With which parameters a method starts; ``dynaviz.contracts.params.resolve`` joins them."""

    preset: str | None = field(
        default=None,
        metadata=option("Published parameter set; see 'dynaviz list presets'.", metavar="NAME"),
    )
    config: str | os.PathLike[str] | None = field(
        default=None,
        metadata=option(
            "TOML file with parameters, such as config.toml of a run.",
            metavar="FILE",
            typed=Path | None,
        ),
    )
    settings: Settings = field(
        default=(),
        metadata=option(
            "Set one parameter. Repeatable.",
            more="In Python: several texts such as 'resolution=0.2', or a dictionary.",
            metavar="KEY=VALUE",
            flags=("--set",),
            typed=list[str] | None,
        ),
    )
    seed: int | None = field(
        default=None,
        metadata=option("Random seed of the method. [default: 0]", metavar="N", least=0),
    )
    threads: int | None = field(
        default=None,
        metadata=option("Threads for kernels. [default: all cores]", metavar="N", least=1),
    )

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
    """

    online: bool | None = field(
        default=None,
        metadata=option(
            "Label each scan as soon as it is observed, or all scans at the end. [default: "
            "offline]",
            flags=("--online/--offline",),
        ),
    )
    variant: str = field(
        default="", metadata=option("Name of the parameter set, for tables.", metavar="NAME")
    )
    record: Record | str | os.PathLike[str] = field(
        default="errors",
        metadata=option(
            "How much to record in run.rrd.",
            more="Or the path of an .rrd file, which records in the mode 'errors', with or without "
            "a folder.",
            typed=Record,
        ),
    )
    record_budget: int | str | None = field(
        default=None,
        metadata=option(
            "Maximum size of the recordings, such as 2GB; the states of the method are left out "
            "first.",
            more="Drawn points are next; the labels of all points are always recorded.",
            metavar="SIZE",
            typed=str | None,
        ),
    )
    view: bool = field(
        default=False, metadata=option("Show the run live in the viewer.", flags=("--view",))
    )
    tiles: float | str | None = field(
        default=None,
        metadata=option(
            "Divide the map into squares of this size, for drives of any length.",
            more="Needs a folder. An interrupted run continues with the tiles that are missing.",
            metavar="METRES",
            typed=str | None,
        ),
    )
    workers: int = field(
        default=1,
        metadata=option(
            "Number of tiles that run at a time.",
            more="Each has its own process.",
            metavar="N",
            least=1,
        ),
    )
    scheduler: str | None = field(
        default=None,
        metadata=option("Run the tiles on the workers of this Dask scheduler.", metavar="ADDRESS"),
    )
    maps: bool = field(
        default=True,
        metadata=option("Write static_map.pcd and dynamic_points.pcd.", flags=("--map/--no-map",)),
    )
    review: str | os.PathLike[str] | None = field(
        default=None,
        metadata=option(
            "Decisions of a person (review.json), which ground truth and maps follow.",
            more="The labels stay those of the method.",
            metavar="FILE",
            typed=Path | None,
        ),
    )

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
