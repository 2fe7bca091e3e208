"""Static points by agreement: points that no method of a panel removes from the original sequence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import resources

import numpy as np

from dynaviz import params, registry
from dynaviz.arrays import U8, Bool
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.metric import Labelled
from dynaviz.progress import Progress
from dynaviz.scan import Sequence


def default_panel() -> tuple[str, ...]:
    """The installed methods of ``panel.toml``."""
    import tomllib

    names = tomllib.loads((resources.files(__package__) / "panel.toml").read_text(encoding="utf-8"))["methods"]
    installed = {handle.name for handle in registry.handles("methods")}
    return tuple(name for name in names if name in installed)


def undisputed(sequence: Sequence, panel: tuple[str, ...], progress: Progress) -> Callable[[int], Bool]:
    """Run the methods of a panel, with their default parameters, on a sequence.

    Returns:
        A function that gives, for a position in the sequence, (N,) bool: the points that no method removes.

    Raises:
        UsageError: for an unknown method.
    """
    kinds = {name: registry.load("methods", name) for name in panel}  # before any of them runs
    union: list[tuple[int, U8]] = []
    for name, kind in kinds.items():
        resolved = params.resolve(kind)
        spec = RunSpec(kind(resolved.params), sequence, resolved.params, online=bool(resolved.online))
        execute(spec, [_Union(union)], progress=lambda phase, *done, name=name: progress(f"{name}: {phase}", *done))

    def static(position: int) -> Bool:
        count, removed = union[position]
        kept: Bool = np.unpackbits(removed, count=count) == 0
        return kept

    return static


class _Union(Listener):
    """Collects, frame by frame, the points that any method removed, one bit per point."""

    def __init__(self, union: list[tuple[int, U8]]) -> None:
        self._union = union

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Add the labels of a frame."""
        bits = np.packbits(labelled.dynamic)
        if labelled.frame == len(self._union):
            self._union.append((len(labelled.dynamic), bits))
        else:
            count, earlier = self._union[labelled.frame]
            self._union[labelled.frame] = count, earlier | bits
