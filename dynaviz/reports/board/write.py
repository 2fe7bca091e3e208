"""Write a board: the static page ``index.html``, and ``board.json`` with the digests and scores of
every entry.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec

from dynaviz.contracts import registry
from dynaviz.contracts.scan import Sequence
from dynaviz.errors import DataError, DynavizError
from dynaviz.io.atomic import write_atomic
from dynaviz.progress import Progress, silent
from dynaviz.reports.board.entries import FILE, BoardFile, Entry, read_board, save_board, version
from dynaviz.reports.reporting import Study
from dynaviz.runs.rescore import rescore
from dynaviz.runs.run import Run, open_run
from dynaviz.scores.collect import StudyRun, collect
from dynaviz.scores.result import Result
from dynaviz.sources.opening import Source, open_source
from dynaviz.sources.options import SequenceOptions

PAGE = "index.html"


@dataclass(frozen=True)
class Written:
    """A written board: its page, its content, and how many entries were scored now instead of taken
    over.
    """

    page: Path
    board: BoardFile
    rescored: int


def write_board(
    folder: Path, out: Path, sequences: Iterable[Source] = (), progress: Progress = silent
) -> Written:
    """Write the board of all results in a folder.

    Scores of an earlier board in the same place are taken over if the digests of labels and
    sequence agree, and the version of dynaviz and the protocols are the same.

    Args:
        folder: contains the runs.
        out: folder of the board.
        sequences: those of some of the runs, open or as paths, by their names; all others are
            opened as their run did.
        progress: called with a phase, the number of steps done, and their total.

    Raises:
        DataError: if there are no results, or files cannot be read or written.
        DynavizError: if a given sequence cannot be opened.
    """
    runs = collect([folder])
    given = {each.name: each for each in (open_source(one, SequenceOptions()) for one in sequences)}
    protocols = registry.loadable("protocols")
    known = _earlier(out / FILE)
    entries: dict[Path, Entry] = {}
    rescored = 0
    finished = [(run, run.result) for run in runs if run.result is not None]
    for number, (run, result) in enumerate(finished):
        progress("score", number, len(finished))
        entry = Entry.of(run, result, folder)
        same = known.entry(entry.key)
        if same is not None and same.protocols.keys() == protocols.keys():
            entry = msgspec.structs.replace(entry, protocols=same.protocols)
        else:
            entry = scored(entry, run, result, given)
            rescored += bool(entry.protocols)
        entries[run.file] = entry
    progress("score", len(finished), len(finished))
    scores = {file: entry.protocols for file, entry in entries.items()}
    remarks = {file: entry.remark for file, entry in entries.items() if entry.remark}
    study = Study(runs, out, progress, protocols, scores, remarks)
    board = BoardFile(dynaviz=version(), entries=tuple(entries.values()))
    write_atomic(out / PAGE, registry.load("reports", "html")(study).encode())
    save_board(out / FILE, board)
    return Written(out / PAGE, board, rescored)


def scored(entry: Entry, run: StudyRun, result: Result, given: Mapping[str, Sequence]) -> Entry:
    """The entry with its scores, or with a remark why there are none."""
    if not (run.folder / "labels.npz").is_file():
        return msgspec.structs.replace(entry, remark="labels.npz is missing")
    opened = open_run(result)
    sequence = given.get(result.sequence.name) or _opened(opened)
    if sequence is None:
        return msgspec.structs.replace(
            entry, remark="the sequence was not found; give it with --sequence"
        )
    try:
        found = rescore(opened, sequence)
    except DataError as error:
        return msgspec.structs.replace(entry, remark=str(error))
    if found.sequence_digest != result.sequence.digest:
        return msgspec.structs.replace(
            entry, remark=f"the sequence {sequence.name} differs from that of the run"
        )
    if found.labels_sha256 != result.labels_sha256:
        return msgspec.structs.replace(
            entry, remark="labels.npz differs from the labels that were scored"
        )
    return msgspec.structs.replace(entry, protocols=found.protocols)


def _opened(run: Run) -> Sequence | None:
    """The sequence of a run; None if the data moved."""
    with contextlib.suppress(DynavizError):
        return run.sequence()
    return None


def _earlier(path: Path) -> BoardFile:
    """The board that was written there by this version; empty if there is none."""
    if not path.is_file():
        return BoardFile()
    board = read_board(path)
    return board if board.dynaviz == version() else BoardFile()
