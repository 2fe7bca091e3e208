"""Recompute the entries of a board from the stored labels and the sequences, or by running the methods again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from dynaviz.contracts.scan import Sequence, SequenceSlice
from dynaviz.engine.loop import execute
from dynaviz.errors import DataError
from dynaviz.io.atomic import sha256
from dynaviz.progress import Progress, silent
from dynaviz.reports.board.entries import FILE, BoardFile, Entry, read_board
from dynaviz.runs.rescore import Rescored, rescore
from dynaviz.runs.run import open_run
from dynaviz.runs.sequences import SequenceFinder
from dynaviz.scores.collect import StudyRun, collect
from dynaviz.scores.result import Result

SAME, DIFFERENT, ABSENT = "same", "different", "–"
PARTS = ("sequence", "labels", "counts", "protocols", "recording", "rerun")


@dataclass(frozen=True)
class CheckedEntry:
    """An entry after its check.

    Attributes:
        run: the run.
        verdicts: ``SAME``, ``DIFFERENT`` or ``ABSENT`` (not there, or not requested) by part:
            sequence: digest of points, poses and ground truth; labels: digest of the stored labels;
            counts: of correct and wrong points; protocols: all scores on the board; recording: digest of its file;
            rerun: digest of the labels of the method when run again.
        problem: what differs, or why the entry could not be recomputed; empty if all is the same.
    """

    run: StudyRun
    verdicts: dict[str, str]
    problem: str = ""

    @property
    def passed(self) -> bool:
        """Whether the entry was recomputed and nothing differs."""
        return not self.problem


def check_board(
    folder: Path, site: Path, finder: SequenceFinder, rerun: bool = False, progress: Progress = silent
) -> list[CheckedEntry]:
    """Recompute every result in a folder.

    Args:
        folder: contains the runs; a single run may be given, too.
        site: folder of the board whose scores are compared; without ``board.json`` only the results are checked.
        finder: finds the sequences.
        rerun: also run each method again with its stored parameters and compare the labels.
        progress: called with a phase, the number of steps done, and their total.

    Raises:
        DataError: if there are no results, or ``board.json`` cannot be read.
    """
    runs = [run for run in collect([folder]) if run.result is not None]
    board = read_board(site / FILE) if (site / FILE).is_file() else None
    checked = []
    for number, run in enumerate(runs):
        progress("check", number, len(runs))
        assert run.result is not None
        checked.append(_checked(run, run.result, board, finder, rerun))
    progress("check", len(runs), len(runs))
    return checked


def _checked(
    run: StudyRun, result: Result, board: BoardFile | None, finder: SequenceFinder, rerun: bool
) -> CheckedEntry:
    verdicts = dict.fromkeys(PARTS, ABSENT)
    verdicts["recording"] = _recording(run, result)
    opened = open_run(result)
    sequence = finder.find(opened)
    if sequence is None:
        problem = f"the sequence {result.sequence.name} was not found; give it with --sequence"
        return CheckedEntry(run, verdicts, problem)
    try:
        found = rescore(opened, sequence)
    except DataError as error:
        return CheckedEntry(run, verdicts, str(error))
    verdicts |= _compared(result, found, board, Entry.of(run, result, run.folder))
    if rerun and result.sections.source is None:
        again = execute(opened.spec(_same_frames(sequence, found)))
        verdicts["rerun"] = _verdict(again.labels_sha256 == result.labels_sha256)
    return CheckedEntry(run, verdicts, "; ".join(_problems(verdicts)))


def _compared(result: Result, found: Rescored, board: BoardFile | None, entry: Entry) -> dict[str, str]:
    """The verdicts on digests and scores."""
    verdicts = {
        "sequence": _verdict(found.sequence_digest == result.sequence.digest),
        "labels": _verdict(found.labels_sha256 == result.labels_sha256),
    }
    if result.counts:
        verdicts["counts"] = _verdict(dict(result.counts) == found.counts)
    listed = board.entry(entry.key) if board else None
    if board is not None:
        verdicts["protocols"] = _verdict(listed is not None and dict(listed.protocols) == dict(found.protocols))
    return verdicts


def _recording(run: StudyRun, result: Result) -> str:
    if run.recording is None or result.recording_sha256 is None:
        return ABSENT
    return _verdict(sha256(run.recording) == result.recording_sha256)


def _verdict(same: bool) -> str:
    return SAME if same else DIFFERENT


_DIFFERENCES = {
    "sequence": "the sequence differs from that of the run",
    "labels": "labels.npz differs from the labels that were scored",
    "counts": "result.json has other counts than its labels give",
    "protocols": "board.json has other scores, or lacks the entry",
    "recording": "run.rrd was changed",
    "rerun": "the method gives other labels",
}


def _problems(verdicts: dict[str, str]) -> Iterator[str]:
    return (_DIFFERENCES[part] for part, verdict in verdicts.items() if verdict == DIFFERENT)


def _same_frames(sequence: Sequence, found: Rescored) -> Sequence:
    """The frames of the run, in a sequence that may contain others."""
    first, *rest = found.positions
    step = rest[0] - first if rest else 1
    positions = range(first, found.positions[-1] + 1, step)
    return SequenceSlice(sequence, positions, sequence.sensor, sequence.name)
