"""Labels by agreement: what most methods of a panel keep is static, and what all remove from the
sequence is dynamic.

A point that a single method removes is most often that method's error. If such points did not
count, the errors of the methods in the panel would not count either, and neither would points that
are hard for every method.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

import numpy as np

from dynaviz.arrays import F32, U8, Bool
from dynaviz.contracts import params, registry
from dynaviz.contracts.metric import Labelled
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.engine.needs import suited
from dynaviz.progress import Progress, silent
from dynaviz.sources.drive import Drive

HALO = 0.3  # metres


def default_panel(without: str = "") -> tuple[str, ...]:
    """The first three installed methods of ``panel.toml``.

    Args:
        without: a method that is left out, because it would judge its own errors.
    """
    import tomllib

    names = tomllib.loads(
        (resources.files(__package__) / "panel.toml").read_text(encoding="utf-8")
    )["methods"]
    installed = {handle.name for handle in registry.handles("methods")} - {without}
    return tuple(name for name in names if name in installed)[:3]


@dataclass(frozen=True)
class Votes:
    """What the methods of a panel agree on.

    Attributes:
        counts: number of points of each frame.
        kept, removed: of each frame, one bit per point: see ``static`` and ``dynamic``.
    """

    counts: list[int]
    kept: list[U8]
    removed: list[U8]

    def static(self, position: int) -> Bool:
        """(N,) bool: points that most methods of the panel keep, and that are not next to a point
        that they remove.
        """
        return self._unpacked(self.kept, position)

    def dynamic(self, position: int) -> Bool:
        """(N,) bool: points that every method of the panel removes."""
        return self._unpacked(self.removed, position)

    def _unpacked(self, bits: list[U8], position: int) -> Bool:
        mask: Bool = np.unpackbits(bits[position], count=self.counts[position]).astype(np.bool_)
        return mask


def votes(sequence: Drive, panel: tuple[str, ...], progress: Progress = silent) -> Votes:
    """Run the methods of a panel, with their default parameters, on a sequence.

    Raises:
        UsageError: for an unknown method, or one that needs a fact of the sensor that cannot be
            estimated.
    """
    kinds = {name: registry.load("methods", name) for name in panel}  # before any of them runs
    found = Votes([], [], [])
    tally = [np.empty(0, np.uint8)] * len(sequence)
    for left, (name, kind) in zip(reversed(range(len(kinds))), kinds.items(), strict=True):
        resolved = params.resolve(kind)
        known = suited(kind, resolved.params, sequence)
        spec = RunSpec(kind(resolved.params), known, resolved.params, online=bool(resolved.online))
        collect = _Collect(tally, len(kinds), None if left else found)
        execute(
            spec,
            [collect],
            progress=lambda phase, *done, name=name: progress(f"{name}: {phase}", *done),
        )
    return found


class _Collect(Listener):
    """Adds the votes of a method to the tally.

    With the votes of the last method it fills in the result.
    """

    def __init__(self, tally: list[U8], methods: int, result: Votes | None) -> None:
        self._tally = tally
        self._methods = methods
        self._result = result

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Add the labels of a frame."""
        frame = labelled.frame
        own = labelled.dynamic.astype(np.uint8)
        self._tally[frame] = self._tally[frame] + own if len(self._tally[frame]) else own
        if self._result is None:
            return
        disputed = 2 * self._tally[frame] >= self._methods
        self._result.counts.append(len(own))
        self._result.kept.append(np.packbits(~around(labelled.scan.points, disputed)))
        self._result.removed.append(np.packbits(self._tally[frame] == self._methods))


def around(points: F32, chosen: Bool) -> Bool:
    """(N,) bool: the chosen points, and those within ``HALO`` of one.

    Methods often miss a part of a mover.
    """
    from scipy.spatial import cKDTree

    near = chosen.copy()
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(points).all(1)
    rest = np.flatnonzero(finite & ~chosen)
    if len(rest) and (finite & chosen).any():
        away, _ = cKDTree(points[finite & chosen]).query(points[rest], distance_upper_bound=HALO)
        near[rest] = np.isfinite(away)
    return near
