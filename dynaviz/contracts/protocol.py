"""The contract of a protocol: how a benchmark or a family of papers counts the labels of a run.

Protocols are computed on demand from the stored labels of a run (``dynaviz report --format
board``), not during the run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Protocol

from msgspec import Struct

from dynaviz.contracts.metric import Labelled


@dataclass(frozen=True, slots=True)
class ProtocolInfo:
    """What a protocol counts.

    Attributes:
        name: in commands and files; title: in tables.
        source: who counts like this.
        counts: what is counted, in a few words.
        ignores: what is left out.
        combines: how frames and sequences are combined.
        scores: names of its scores in percent; the first is the main one.
        splits: official splits, with the names of their sequences; empty if there are none, or if
            they are lists of frames.
    """

    name: str
    title: str
    source: str
    counts: str
    ignores: str
    combines: str
    scores: tuple[str, ...]
    splits: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


class ProtocolScores(Struct, frozen=True):
    """The scores of a run under a protocol in percent, None where undefined, and the counts that
    they follow from.
    """

    scores: Mapping[str, float | None]
    counts: Mapping[str, float] = {}


class EvaluationProtocol(Protocol):
    """Counts the labels of one run.

    Args:
        scoring: how labels were assigned to points: ``mask`` or ``nn`` (``eval/README.md``).
    """

    info: ClassVar[ProtocolInfo]

    def __init__(self, scoring: str) -> None: ...

    def update(self, labelled: Labelled) -> None:
        """Add one scan; scans come in the order of frames."""
        ...

    def finish(self) -> ProtocolScores:
        """The scores; called once, after the last scan."""
        ...

    @staticmethod
    def combine(parts: Sequence[ProtocolScores]) -> ProtocolScores:
        """Combine the scores of several sequences."""
        ...
