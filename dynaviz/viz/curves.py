"""Curves over frames, written some frames at a time: a number written alone costs a hundred times its size."""

from __future__ import annotations

from collections import defaultdict

import rerun as rr

from dynaviz.scan import Outcome
from dynaviz.viz import paths
from dynaviz.viz.sink import RecordingFile

TOGETHER = 10  # frames; so many numbers of each curve are lost at most when a run is killed

_WRONG = {"false_negatives": Outcome.FALSE_NEGATIVE, "false_positives": Outcome.FALSE_POSITIVE}


class Curves:
    """Collects numbers of curves and writes them, with a name and a colour each."""

    def __init__(self, sink: RecordingFile) -> None:
        self._sink = sink
        self._styled: set[str] = set()
        self._waiting: defaultdict[str, list[tuple[int, int | None, float]]] = defaultdict(list)

    def add(self, path: str, frame: int, stamp_ns: int | None, value: float) -> None:
        """Add a number; NaN leaves a gap."""
        self._waiting[path].append((frame, stamp_ns, value))
        if len(self._waiting[path]) == TOGETHER:
            self._write(path)

    def write(self) -> None:
        """Write all that waits."""
        for path in list(self._waiting):
            self._write(path)

    def _write(self, path: str) -> None:
        if path not in self._styled:
            self._styled.add(path)
            self._sink.log(path, style(path), static=True)
        frames, stamps, values = zip(*self._waiting.pop(path), strict=True)
        self._sink.columns(path, frames, stamps, rr.Scalars.columns(scalars=values))


def style(path: str) -> rr.SeriesLines:
    """Name and colour of a curve, from its path."""
    words = path.split("/")[1:]
    name = words[0] if words[1:] == ["so_far"] else words[-1] if words[-1] in _WRONG else " ".join(words)
    colour = paths.COLOURS[_WRONG[name]] if name in _WRONG else paths.SERIES.get(words[0])
    return rr.SeriesLines(names=name.replace("_", " "), colors=colour, widths=1.5)
