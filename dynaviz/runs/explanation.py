"""Why a point of a run got its label: the run is replayed, and the ledger of the point kept."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dynaviz.contracts.evidence import Explains
from dynaviz.contracts.method import Reason
from dynaviz.engine.case_evidence import evidence_of, flip
from dynaviz.engine.ledger import Ledger
from dynaviz.engine.point_ledger import PointLedger
from dynaviz.errors import DataError, UsageError
from dynaviz.progress import Progress, silent
from dynaviz.runs.run import Run, open_run
from dynaviz.scores.failure_case import case_at
from dynaviz.scores.result import Result
from dynaviz.sources.opening import Source

if TYPE_CHECKING:
    from rich.console import RenderableType


@dataclass(frozen=True, slots=True)
class Why:
    """Why a point got its label; printing it shows the ledger.

    Attributes:
        method, title: of the run.
        sequence: name of the sequence.
        online: whether labels were decided right after each scan.
        ledger: the scans that touched the point, what each contributed, and the rules that decided.
        cause: of the failure case that contains the point; None if no listed case does, or the
            label is right.
        note: what the ledger cannot show; empty if nothing.
    """

    method: str
    title: str
    sequence: str
    online: bool
    ledger: PointLedger
    cause: str | None = None
    note: str = ""

    @property
    def sentence(self) -> str:
        """Truth, label and reason in a sentence."""
        found = self.ledger
        return sentence(
            found.truth, "removed" if found.removed else "kept", found.reason, self.cause
        )

    @property
    def evidence(self) -> str:
        """The rays that touched the cell around the point, what decided, and what would change the
        label.
        """
        return f"{evidence_of([self.ledger]).text} {flip(self.ledger)}".strip()

    def to_dict(self) -> dict[str, Any]:
        """Everything in plain types that JSON knows; numbers that are not finite become None."""
        plain: dict[str, Any] = _plain(
            {**dataclasses.asdict(self), "sentence": self.sentence, "evidence": self.evidence}
        )
        return plain

    def __rich__(self) -> RenderableType:
        from dynaviz.runs.ledger_table import ledger_table

        place = " ".join(f"{x:.2f}" for x in self.ledger.position)
        where = f"point {self.ledger.point} of frame {self.ledger.frame}, at ({place}) m"
        head = f"{self.title} on {self.sequence}: {where}", self.sentence, self.evidence, self.note
        return ledger_table(self.ledger, [line for line in head if line])


def sentence(truth: str | None, answer: str, reason: Reason, cause: str | None) -> str:
    """The label of a point in a sentence.

    Args:
        truth: ``static``, ``dynamic`` or None.
        answer: ``removed`` or ``kept``; without ground truth also what the point did, as
            ``appeared``.
        reason: why it got the label.
        cause: of the failure case that contains it, if any.
    """
    meaning = reason.meaning.partition(": ")[2] or reason.meaning
    if truth is None:
        return f"{answer.capitalize()} (no ground truth): {meaning}."
    if (answer == "removed") == (truth == "dynamic"):
        return f"Right: {truth}, and {answer}: {meaning}."
    return f"Wrong: {truth}, but {answer}: {meaning}.{f' Cause: {cause}.' if cause else ''}"


def why(
    run: str | os.PathLike[str] | Result | Run,
    frame: int,
    point: int,
    *,
    sequence: Source | None = None,
    threads: int | None = None,
    progress: Progress = silent,
) -> Why:
    """Explain the label of a point.

    Every scan whose rays touched it, what each contributed, and the verdict.

    The run is repeated to ask the method after each scan, so this takes as long as the run.

    Args:
        run: a run's folder, ``result.json`` or ``run.rrd``; or a result, also of a run on arrays in
            this process.
        frame: position in the run, as in the recording and in failure cases.
        point: row in the scan of that frame.
        sequence: the run's sequence, open or as a path, if the data moved. A path is opened as the
            run opened it.
        threads: for kernels; None for all cores.
        progress: called with a phase, the number of frames done and their total.

    Raises:
        UsageError: for a frame or point that does not exist, an unknown method, or a run without a
            known sequence.
        DataError: for files that cannot be read, a different sequence, or if the replay gives
            different labels.
    """
    found = explain(run, {frame: [point]}, sequence=sequence, threads=threads, progress=progress)
    return found[frame][0]


def explain(
    run: str | os.PathLike[str] | Result | Run,
    points: Mapping[int, Sequence[int]],
    *,
    sequence: Source | None = None,
    threads: int | None = None,
    progress: Progress = silent,
) -> dict[int, tuple[Why, ...]]:
    """Explain several points in one replay.

    Args:
        run, sequence, threads, progress: as for ``why``.
        points: for each frame, rows in its scan.

    Returns:
        By frame, in the order of ``points``.

    Raises:
        UsageError, DataError: as ``why``.
    """
    opened = run if isinstance(run, Run) else open_run(run)
    ledger = Ledger(points)
    spec = opened.replay([ledger], at=sequence, threads=threads, progress=progress)
    info = spec.labeller.info
    note = ""
    if spec.method is None:
        note = (
            "The labels come from another program, so there is no ledger: only the rays are known."
        )
    elif not isinstance(spec.method, Explains):
        note = f"{info.name} states no evidence, so there is no ledger: only the rays are known."
    facts = opened.result.method, info.title, spec.sequence.name, opened.result.online
    return {
        frame: tuple(
            Why(*facts, each, cause_at(opened.result, each), note)
            for each in (_stored(opened, e) for e in found)
        )
        for frame, found in ledger.ledgers.items()
    }


def cause_at(result: Result, ledger: PointLedger) -> str | None:
    """The cause of the failure case that contains a point.

    None if no listed case does, or the label is right.
    """
    if not ledger.wrong:
        return None
    if ledger.case is not None:
        return result.failures[ledger.case - 1].cause
    kind = "false_positive" if ledger.removed else "false_negative"
    case = case_at(result.failures, kind, ledger.frame, ledger.position)
    return None if case is None else case.cause


def _stored(run: Run, ledger: PointLedger) -> PointLedger:
    """The ledger with the number of the case, if the recording of the run stores that.

    The boxes of cases overlap.
    """
    try:
        recording = run.recording
    except (DataError, UsageError):  # not recorded
        return ledger
    for number, case in enumerate(run.result.failures, 1):
        if case.worst_frame == ledger.frame and any(
            each.point == ledger.point for each in recording.ledgers(number)
        ):
            return dataclasses.replace(ledger, case=number)
    return ledger


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
