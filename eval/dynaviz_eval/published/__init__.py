"""Numbers that others published, to stand beside ours: one TOML file a sequence, and one of runtimes.

Collected from their sources, not computed here. The benchmark scores by nearest neighbour (``nn``, eval/README.md), so
beside ``mask`` scores they are for orientation only.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any


@dataclass(frozen=True, slots=True)
class Published:
    """A row of somebody's table, in percent, rounded as it was printed.

    Attributes:
        method: dynaviz's name of the method where it has one.
        title: as the source writes it.
        SA, DA, AA, HA: AA and HA follow from SA and DA where the source does not print them.
        online: labels were asked for right after each scan.
        source: where it was published.
    """

    method: str
    title: str
    SA: float
    DA: float
    AA: float
    HA: float
    online: bool
    source: str


@dataclass(frozen=True, slots=True)
class PublishedRuntime:
    """Seconds per frame of a method, with the number of its parameters where that was printed."""

    method: str
    title: str
    sequence: str | None
    mean_s: float
    std_s: float
    n_parameters: int | None
    source: str


def published_sequences() -> list[str]:
    """Names of the sequences with published scores, sorted."""
    files = [file.name for file in resources.files(__package__).iterdir()]
    return sorted(name.removesuffix(".toml") for name in files if name.endswith(".toml") and name != "runtime.toml")


def published(sequence: str) -> tuple[Published, ...]:
    """Published scores of a sequence by its name, for example ``kitti_00``; empty where none are known."""
    if sequence not in published_sequences():
        return ()
    content = _load(sequence)
    return tuple(
        Published(
            method=row["method"],
            title=row["title"],
            SA=row["SA"],
            DA=row["DA"],
            AA=row.get("AA", math.sqrt(row["SA"] * row["DA"])),
            HA=row.get("HA", 2 * row["SA"] * row["DA"] / (row["SA"] + row["DA"])),
            online=row.get("online", False),
            source=content["sources"][row["source"]],
        )
        for row in content["results"]
    )


def published_runtimes() -> tuple[PublishedRuntime, ...]:
    """Published seconds per frame, on an Intel i9-12900KF."""
    content = _load("runtime")
    return tuple(
        PublishedRuntime(
            method=row["method"],
            title=row["title"],
            sequence=row.get("sequence"),
            mean_s=row["mean_s"],
            std_s=row["std_s"],
            n_parameters=row.get("n_parameters"),
            source=content["sources"][row["source"]],
        )
        for row in content["results"]
    )


@cache
def _load(name: str) -> dict[str, Any]:
    return tomllib.loads(resources.files(__package__).joinpath(f"{name}.toml").read_text("utf-8"))
