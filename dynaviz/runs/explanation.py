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
from dynaviz.engine.ledger import GRAZING, Ledger, PointLedger
from dynaviz.progress import Progress, silent
from dynaviz.runs.run import Run, open_run
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
        note: what the ledger cannot show; empty if nothing.
    """

    method: str
    title: str
    sequence: str
    online: bool
    ledger: PointLedger
    note: str = ""

    @property
    def sentence(self) -> str:
        """Truth, label and reason in a sentence."""
        found = self.ledger
        return sentence(found.truth, found.removed, found.reason)

    @property
    def rays(self) -> str:
        """The rays that touched the cell around the point, in a sentence."""
        entries = self.ledger.entries
        hits, crossings = ([e for e in entries if getattr(e, name)] for name in ("hits", "crossed"))
        text = f"Of {self.ledger.searched:,} scans, {len(hits):,} hit its cell and {len(crossings):,} crossed it"
        low = sum(e.angle_deg is not None and e.angle_deg < GRAZING for e in crossings)
        return f"{text}{f', {low:,} of them at less than {GRAZING:g}° to its surface' if low else ''}."

    def to_dict(self) -> dict[str, Any]:
        """Everything in plain types that JSON knows; numbers that are not finite become None."""
        plain: dict[str, Any] = _plain({**dataclasses.asdict(self), "sentence": self.sentence, "rays": self.rays})
        return plain

    def __rich__(self) -> RenderableType:
        from dynaviz.runs.ledger_table import ledger_table

        place = " ".join(f"{x:.2f}" for x in self.ledger.position)
        where = f"point {self.ledger.point} of frame {self.ledger.frame}, at ({place}) m"
        head = f"{self.title} on {self.sequence}: {where}", self.sentence, self.rays, self.note
        return ledger_table(self.ledger, [line for line in head if line])


def sentence(truth: str | None, removed: bool, reason: Reason) -> str:
    """The label of a point in a sentence.

    Args:
        truth: ``static``, ``dynamic`` or None.
        removed: the label.
        reason: why it got the label.
    """
    meaning = reason.meaning.partition(": ")[2] or reason.meaning
    answer = "removed" if removed else "kept"
    if truth is None:
        return f"{answer.capitalize()} (no ground truth): {meaning}."
    if removed == (truth == "dynamic"):
        return f"Right: {truth}, and {answer}: {meaning}."
    cause = f" Likely cause: {reason.cause}." if reason.cause else ""
    return f"Wrong: {truth}, but {answer}: {meaning}.{cause}"


def why(
    run: str | os.PathLike[str] | Result | Run,
    frame: int,
    point: int,
    *,
    sequence: Source | None = None,
    threads: int | None = None,
    progress: Progress = silent,
) -> Why:
    """Explain the label of a point: every scan whose rays touched it, what each contributed, and the verdict.

    The run is repeated to ask the method after each scan, so this takes as long as the run.

    Args:
        run: a run's folder, ``result.json`` or ``run.rrd``; or a result, also of a run on arrays in this process.
        frame: position in the run, as in the recording and in failure cases.
        point: row in the scan of that frame.
        sequence: the run's sequence, open or as a path, if the data moved. A path is opened as the run opened it.
        threads: for kernels; None for all cores.
        progress: called with a phase, the number of frames done and their total.

    Raises:
        UsageError: for a frame or point that does not exist, an unknown method, or a run without a known sequence.
        DataError: for files that cannot be read, a different sequence, or if the replay gives different labels.
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
        points: for each frame, rows in its scan; at most 32 for a frame.

    Returns:
        By frame, in the order of ``points``.

    Raises:
        UsageError, DataError: as ``why``.
    """
    opened = run if isinstance(run, Run) else open_run(run)
    ledgers = {frame: Ledger(frame, rows) for frame, rows in points.items()}
    spec = opened.replay(ledgers.values(), at=sequence, threads=threads, progress=progress)
    info, note = spec.labeller.info, ""
    if spec.method is None:
        note = "The labels come from another program, so there is no ledger: only the rays are known."
    elif not isinstance(spec.method, Explains):
        note = f"{info.name} states no evidence, so there is no ledger: only the rays are known."
    facts = opened.result.method, info.title, spec.sequence.name, opened.result.online
    return {frame: tuple(Why(*facts, found, note) for found in ledger.ledgers) for frame, ledger in ledgers.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
