"""The document that says why a point got its label.

Commands, recordings, the explorer and reports read it and add nothing.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dynaviz.contracts.method import Reason
from dynaviz.explain.case_evidence import evidence_of, flip
from dynaviz.explain.deciding import deciding_scans
from dynaviz.explain.point_ledger import PointLedger
from dynaviz.explain.words import rule_words
from dynaviz.scores.result import Result

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
        note: what the ledger cannot show, or that the run was repeated; empty if nothing.
        about: the case that was asked about, and the evidence on all of its points; empty for none.
    """

    method: str
    title: str
    sequence: str
    online: bool
    ledger: PointLedger
    cause: str | None = None
    note: str = ""
    about: str = ""

    @property
    def sentence(self) -> str:
        """Truth, label and reason in a sentence."""
        found = self.ledger
        cause = self.cause
        if cause is not None and found.case is not None:
            cause = f"{cause} (case {found.case})"
        return sentence(found.truth, "removed" if found.removed else "kept", found.reason, cause)

    @property
    def evidence(self) -> str:
        """The rays that touched the cell around the point, what decided, and what would change the
        label.
        """
        return f"{evidence_of([self.ledger]).text} {flip(self.ledger)}".strip()

    def to_dict(self) -> dict[str, Any]:
        """Everything in plain types that JSON knows; numbers that are not finite become None."""
        plain: dict[str, Any] = _plain(
            {
                **dataclasses.asdict(self),
                "sentence": self.sentence,
                "evidence": self.evidence,
                "deciding": [
                    {**dataclasses.asdict(row), "span": row.span}
                    for row in deciding_scans(self.ledger)
                ],
            }
        )
        for rule, shown in zip(self.ledger.rules, plain["ledger"]["rules"], strict=True):
            shown["text"] = rule_words(rule)
        return plain

    def __rich__(self) -> RenderableType:
        from dynaviz.explain.table import ledger_table

        place = " ".join(f"{x:.2f}" for x in self.ledger.position)
        where = f"point {self.ledger.point} of frame {self.ledger.frame}, at ({place}) m"
        title = f"{self.title} on {self.sequence}: {where}"
        head = self.about, title, self.sentence, self.evidence, self.note
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


def cause_at(result: Result, ledger: PointLedger) -> str | None:
    """The cause of the failure case of a point.

    None if it is in no listed case, or the label is right.
    """
    if not ledger.wrong or ledger.case is None:
        return None
    return result.failures[ledger.case - 1].cause


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
