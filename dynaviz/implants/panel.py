"""Labels by agreement: what most methods of a panel keep is static, and what all remove from the sequence is dynamic.

A point that a single method removes is most often that method's error. If such points did not count, the errors of the
methods in the panel would not count either, and neither would points that are hard for every method.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

import numpy as np

from dynaviz import params, registry
from dynaviz.arrays import U8, Bool
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.metric import Labelled
from dynaviz.progress import Progress, silent
from dynaviz.scan import Sequence


def default_panel() -> tuple[str, ...]:
    """The installed methods of ``panel.toml``."""
    import tomllib

    names = tomllib.loads((resources.files(__package__) / "panel.toml").read_text(encoding="utf-8"))["methods"]
    installed = {handle.name for handle in registry.handles("methods")}
    return tuple(name for name in names if name in installed)


@dataclass(frozen=True)
class Votes:
    """How many methods of a panel remove each point of a sequence.

    Attributes:
        methods: number of methods.
        removed: for each frame and method the labels, one bit per point.
        counts: number of points of each frame.
    """

    methods: int
    removed: list[list[U8]]
    counts: list[int]

    def static(self, position: int) -> Bool:
        """(N,) bool: points that most methods of the panel keep."""
        return self._votes(position) < self.methods / 2

    def dynamic(self, position: int) -> Bool:
        """(N,) bool: points that every method of the panel removes."""
        return self._votes(position) == self.methods

    def _votes(self, position: int) -> U8:
        bits = [np.unpackbits(packed, count=self.counts[position]) for packed in self.removed[position]]
        votes: U8 = np.sum(bits, axis=0, dtype=np.uint8)
        return votes


def votes(sequence: Sequence, panel: tuple[str, ...], progress: Progress = silent) -> Votes:
    """Run the methods of a panel, with their default parameters, on a sequence.

    Raises:
        UsageError: for an unknown method.
    """
    kinds = {name: registry.load("methods", name) for name in panel}  # before any of them runs
    found = Votes(len(panel), [[] for _ in range(len(sequence))], [0] * len(sequence))
    for name, kind in kinds.items():
        resolved = params.resolve(kind)
        spec = RunSpec(kind(resolved.params), sequence, resolved.params, online=bool(resolved.online))
        execute(spec, [_Collect(found)], progress=lambda phase, *done, name=name: progress(f"{name}: {phase}", *done))
    return found


class _Collect(Listener):
    """Collects, frame by frame, the points that a method removed."""

    def __init__(self, votes: Votes) -> None:
        self._votes = votes

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Add the labels of a frame."""
        self._votes.removed[labelled.frame].append(np.packbits(labelled.dynamic))
        self._votes.counts[labelled.frame] = len(labelled.dynamic)
