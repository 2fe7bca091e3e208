"""Published numbers to compare with: one TOML file per sequence, and one of runtimes.

Copied from their sources, not computed here. The benchmark scores by nearest neighbour (``nn``,
eval/README.md), so compared with ``mask`` scores they are only a rough guide.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

from dynaviz.scores.scores import associated_accuracy, harmonic_mean
from dynaviz.scores.sections import SequenceInfo


@dataclass(frozen=True, slots=True)
class Published:
    """A row of a published table, in percent, rounded as printed.

    Attributes:
        method: the name of the method in dynaviz, if it has one.
        title: the name in the source.
        SA, DA, AA, HA: AA and HA are computed from SA and DA if the source does not print them.
        online: whether each scan was labelled right after it was added.
        source: the publication.
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
    """Seconds per frame of a method, with its number of parameters if published."""

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
    return sorted(
        name.removesuffix(".toml")
        for name in files
        if name.endswith(".toml") and name != "runtime.toml"
    )


def published(sequence: str) -> tuple[Published, ...]:
    """Published scores of a sequence by name, for example ``kitti_00``; empty if none are known."""
    if sequence not in published_sequences():
        return ()
    content = _load(sequence)
    return tuple(
        Published(
            method=row["method"],
            title=row["title"],
            SA=row["SA"],
            DA=row["DA"],
            AA=row.get("AA", float(associated_accuracy(row["SA"], row["DA"]))),
            HA=row.get("HA", float(harmonic_mean(row["SA"], row["DA"]))),
            online=row.get("online", False),
            source=content["sources"][row["source"]],
        )
        for row in content["results"]
    )


@dataclass(frozen=True, slots=True)
class Match:
    """A sequence with the name of a public one, and whether it is the same.

    Attributes:
        name: name of the public sequence, as in ``published``.
        same: whether frames and points are those of the public sequence, as far as these are known.
        doubt: a sentence on what matches and what does not.
    """

    name: str
    same: bool
    doubt: str


def matching(sequence: SequenceInfo, frames: Sequence[int] = ()) -> Match | None:
    """The public sequence with the name of a result's sequence, or None.

    Args:
        sequence: name, frames and points, as in a result.
        frames: numbers of the frames in the data set, if known.
    """
    for name in published_sequences():
        facts = _load(name)["sequence"]
        if sequence.name in facts["names"]:
            same, doubt = _compare(facts, sequence, frames)
            return Match(name, same, doubt)
    return None


def _compare(
    facts: Mapping[str, Any], sequence: SequenceInfo, frames: Sequence[int]
) -> tuple[bool, str]:
    here = f"{sequence.frames:,} frames"
    there = f"{facts['frames']:,} frames"
    numbered = "first" in facts and len(frames) > 0
    if numbered:
        here += f" from {min(frames)} to {max(frames)}"
        there += f" from {facts['first']} to {facts['last']}"
    if here != there:
        return False, f"Only the name matches: {here} here, {there} in the public sequence."
    points = sequence.points
    known = facts.get("points")
    if known is None:
        return True, f"Name and frames match ({there}); the number of points was not published."
    if points != known:
        return (
            False,
            f"Name and frames match ({there}), but not the points: {points:,} here, {known:,} "
            "published.",
        )
    return True, f"Name, frames and points match ({there}, {known:,} points)."


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
