"""Curves over frames, written in batches.

A value written on its own takes a hundred times its size.
"""

from __future__ import annotations

from collections import defaultdict

import rerun as rr

from dynaviz import colours
from dynaviz.contracts.scan import ERRORS, Outcome
from dynaviz.views import paths
from dynaviz.views.record.sink import RecordingFile

BATCH = 10  # frames; a killed run loses at most this many values of each curve

# of the curves of reasons: the outcome whose colour they have, and their name as on hover
_KINDS = {
    "false_negative": (ERRORS["false_negative"], "ghost"),
    "false_positive": (ERRORS["false_positive"], "hole"),
    "removed": (Outcome.UNLABELLED_REMOVED, "removed"),
}
WRONG_POINTS = {f"{kind}s": outcome for kind, outcome in ERRORS.items()}  # by curve


class Curves:
    """Collects the values of curves and writes them in batches, with a name and a
    colour per curve.
    """

    def __init__(self, sink: RecordingFile) -> None:
        self._sink = sink
        self._styled: set[str] = set()
        self._pending: defaultdict[str, list[tuple[int, int | None, float]]] = defaultdict(list)

    def add(self, path: str, frame: int, stamp_ns: int | None, value: float) -> None:
        """Add a value; NaN leaves a gap."""
        self._pending[path].append((frame, stamp_ns, value))
        if len(self._pending[path]) == BATCH:
            self._write(path)

    def write(self) -> None:
        """Write all pending values."""
        for path in list(self._pending):
            self._write(path)

    def _write(self, path: str) -> None:
        if path not in self._styled:
            self._styled.add(path)
            self._sink.log(path, style(path), static=True)
        frames, stamps, values = zip(*self._pending.pop(path), strict=True)
        self._sink.columns(path, frames, stamps, rr.Scalars.columns(scalars=values))


def style(path: str) -> rr.SeriesLines:
    """Name and colour of a curve, from its path."""
    words = path.split("/")[1:]
    if path.startswith(f"{paths.REASONS}/") and words[0] in _KINDS:
        outcome, kind = _KINDS[words[0]]
        label = f"{kind}: {' '.join(words[1:])}".replace("_", " ")
        return rr.SeriesLines(
            names=label, colors=colours.shade(colours.FIRM[outcome], words[-1]), widths=1.5
        )
    name = (
        words[0]
        if words[1:] == ["so_far"]
        else words[-1]
        if words[-1] in WRONG_POINTS
        else " ".join(words)
    )
    wrong = WRONG_POINTS.get(name)
    colour = colours.SCORES.get(words[0]) if wrong is None else colours.FIRM[wrong]
    return rr.SeriesLines(names=name.replace("_", " "), colors=colour, widths=1.5)
