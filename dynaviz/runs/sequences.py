"""Find the sequence of a run."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

from dynaviz.contracts.scan import Sequence
from dynaviz.errors import DynavizError
from dynaviz.runs.saved_run import open_sequence_of
from dynaviz.scores.collect import StudyRun
from dynaviz.scores.result import Result
from dynaviz.sources.datasets import is_sequence, open_sequence

OpenedBy = Callable[[Result, Path], Sequence | None]
"""Opens the sequence of a result in a folder again; None if it cannot."""


def by_command(result: Result, folder: Path) -> Sequence | None:
    """Open the sequence that the command of a run names; None if that fails, as for a path that moved."""
    try:
        return open_sequence_of(result, folder)
    except DynavizError:
        return None


class SequenceFinder:
    """Finds the sequence of a run: given by the user, by its command, or a folder of its name near the run.

    A sequence is chosen by its name. Whether it is the same is decided by its digest, which needs a pass over it.

    Args:
        given: sequences of the user; opened at once.
        opened_by: how to open it if it was not given.

    Raises:
        DynavizError: if a given sequence cannot be opened.
    """

    def __init__(self, given: Iterable[str | os.PathLike[str]] = (), opened_by: OpenedBy = by_command) -> None:
        self._given = [open_sequence(os.fspath(path)) for path in given]
        self._opened_by = opened_by

    def find(self, run: StudyRun, result: Result) -> Sequence | None:
        """The sequence of a run; None if it is not found."""
        name = result.sequence.name
        for sequence in self._given:
            if sequence.name == name:
                return sequence
        opened = self._opened_by(result, run.folder)
        if opened is not None and opened.name == name:
            return opened
        return next(filter(None, (_opened(folder / name, name) for folder in run.folder.resolve().parents[:3])), None)


def _opened(path: Path, name: str) -> Sequence | None:
    """The sequence at a path, if there is one of this name."""
    try:
        if not path.is_dir() or not is_sequence(str(path)):
            return None
        sequence = open_sequence(str(path))
    except DynavizError:
        return None
    return sequence if sequence.name == name else None
