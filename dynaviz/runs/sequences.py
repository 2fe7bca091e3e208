"""Find the sequence of a run."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from pathlib import Path

from dynaviz.contracts.scan import Sequence
from dynaviz.errors import DynavizError
from dynaviz.runs.run import Run
from dynaviz.sources.datasets import is_sequence, open_sequence
from dynaviz.sources.opening import Source, open_source
from dynaviz.sources.options import SequenceOptions


class SequenceFinder:
    """Finds the sequence of a run: given by the user, where the run found it, or in a folder of its name near the run.

    A sequence is chosen by its name. Whether it is the same is decided by its digest, which needs a pass over it.

    Args:
        given: sequences of the user, open or as paths; opened at once.

    Raises:
        DynavizError: if a given sequence cannot be opened.
    """

    def __init__(self, given: Iterable[Source] = ()) -> None:
        self._given = [open_source(each, SequenceOptions()) for each in given]

    def find(self, run: Run) -> Sequence | None:
        """The sequence of a run; None if it is not found."""
        name = run.result.sequence.name
        for sequence in self._given:
            if sequence.name == name:
                return sequence
        with contextlib.suppress(DynavizError):  # the data moved
            return run.sequence()
        near = [] if run.folder is None else run.folder.resolve().parents[:3]
        return next(filter(None, (_opened(folder / name, name) for folder in near)), None)


def _opened(path: Path, name: str) -> Sequence | None:
    """The sequence at a path, if there is one of this name."""
    try:
        if not path.is_dir() or not is_sequence(str(path)):
            return None
        sequence = open_sequence(str(path))
    except DynavizError:
        return None
    return sequence if sequence.name == name else None
