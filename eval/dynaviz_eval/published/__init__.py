"""Published numbers to compare with, copied from their sources, not computed here.

A TOML file per sequence has scores under the public benchmark's protocol, ``by_protocol.toml``
those under all other protocols, and ``runtime.toml`` seconds. The benchmark scores by nearest
neighbour (``nn``, eval/README.md), so compared with ``mask`` scores they are only a rough guide.
"""

from __future__ import annotations

import fnmatch
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Literal

from dynaviz.scores.scores import associated_accuracy, harmonic_mean
from dynaviz.scores.sections import SequenceInfo

_SCORES = ("F1", "PR", "RR", "IoU")
_OTHERS = ("runtime", "by_protocol")  # files that are not of one sequence
Read = Literal["paper", "repository", "secondary"]
READ = {
    "paper": "read in the paper",
    "repository": "read in the authors' repository, package or page",
    "secondary": "transcribed by others",
}
"""In words, where numbers were read."""


@dataclass(frozen=True, slots=True)
class PublishedSource:
    """Where numbers come from: the publication, and where they were read."""

    text: str
    read: Read

    def __str__(self) -> str:
        return f"{self.text} ({READ[self.read]})"


@dataclass(frozen=True, slots=True)
class Published:
    """A row of a published table, in percent, rounded as printed.

    Attributes:
        method: the name of the method in dynaviz, if it has one.
        title: the name in the source.
        SA, DA, AA, HA: AA and HA are computed from SA and DA if the source does not print them.
        online: whether each scan was labelled right after it was added.
        source: the publication, and where it was read.
    """

    method: str
    title: str
    SA: float
    DA: float
    AA: float
    HA: float
    online: bool
    source: PublishedSource


@dataclass(frozen=True, slots=True)
class PublishedScores:
    """A row of a published table under a protocol, in percent, as printed.

    Attributes:
        protocol: its name in dynaviz.
        sequence: key of the sequence.
        where: the sequence in words.
        method: the name of the method in dynaviz, if it has one.
        title: the name in the source.
        scores: by name, as ``dynaviz.contracts.protocol.ProtocolInfo`` lists them.
        learned: whether the method was trained on labels.
        source: the publication, and where it was read.
    """

    protocol: str
    sequence: str
    where: str
    method: str
    title: str
    scores: Mapping[str, float]
    learned: bool
    source: PublishedSource


@dataclass(frozen=True, slots=True)
class PublishedRuntime:
    """Seconds per frame of a method, with its number of parameters if published."""

    method: str
    title: str
    sequence: str | None
    mean_s: float
    std_s: float
    n_parameters: int | None
    source: PublishedSource


def published_sequences() -> list[str]:
    """Names of the sequences with published scores, sorted."""
    files = [file.name for file in resources.files(__package__).iterdir()]
    return sorted(
        name.removesuffix(".toml")
        for name in files
        if name.endswith(".toml") and name.removesuffix(".toml") not in _OTHERS
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
            source=_source(content, row),
        )
        for row in content["results"]
    )


def published_by_protocol(name: str | None = None) -> tuple[PublishedScores, ...]:
    """Published scores under protocols other than the public benchmark's.

    Args:
        name: of a sequence of dynaviz, such as ``semantickitti_00`` or ``doals_station_1``: only
            rows of this sequence; None for all rows.
    """
    content = _load("by_protocol")
    own = content["sequences"]
    titles = {key: facts["title"] for key, facts in own.items()}
    names = {key: facts["names"] for key, facts in own.items()}
    for key in published_sequences():
        names[key] = _load(key)["sequence"]["names"]
    rows = (
        row
        for row in content["results"]
        if name is None or any(fnmatch.fnmatchcase(name, each) for each in names[row["sequence"]])
    )
    return tuple(
        PublishedScores(
            protocol=row["protocol"],
            sequence=row["sequence"],
            where=titles.get(row["sequence"], row["sequence"]),
            method=row["method"],
            title=row["title"],
            scores={score: row[score] for score in _SCORES if score in row},
            learned=row.get("learned", False),
            source=_source(content, row),
        )
        for row in rows
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
            source=_source(content, row),
        )
        for row in content["results"]
    )


def _source(content: Mapping[str, Any], row: Mapping[str, Any]) -> PublishedSource:
    return PublishedSource(**content["sources"][row["source"]])


@cache
def _load(name: str) -> dict[str, Any]:
    return tomllib.loads(resources.files(__package__).joinpath(f"{name}.toml").read_text("utf-8"))
