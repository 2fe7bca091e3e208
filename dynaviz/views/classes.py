"""Class ids of drawn points.

Outcome and reason in one number, so that the viewer shows the reason on hover.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynaviz import colours
from dynaviz.arrays import U8, U16
from dynaviz.contracts.method import Reason
from dynaviz.contracts.scan import Outcome

REASONS = (
    256  # reason codes per outcome; smaller ids are plain outcomes, as in recordings of schema 1
)

Entry = tuple[int, str, colours.Colour]  # of an annotation context: id, label, colour

WORDS: dict[Outcome, str] = {  # short: the viewer shows about 20 characters
    Outcome.STATIC_KEPT: "kept",
    Outcome.DYNAMIC_REMOVED: "removed",
    Outcome.FALSE_POSITIVE: "hole",
    Outcome.FALSE_NEGATIVE: "ghost",
    Outcome.UNLABELLED_KEPT: "unlabelled",
    Outcome.UNLABELLED_REMOVED: "unlabelled, removed",
}
_WITHOUT_TRUTH = {**WORDS, Outcome.UNLABELLED_KEPT: "kept", Outcome.UNLABELLED_REMOVED: "removed"}


def encode(outcome: U8, reasons: U8, named: int) -> U16:
    """Class ids of points.

    Args:
        outcome: (N,) uint8, an ``Outcome`` per point.
        reasons: (N,) uint8, reason codes.
        named: number of reasons in the method's legend; points with other codes get the id of their
            outcome alone.
    """
    ids = (outcome.astype(np.uint16) + 1) * REASONS + reasons
    return np.where(reasons < named, ids, outcome).astype(np.uint16)


def outcomes(ids: U16) -> U8:
    """(N,) uint8, the ``Outcome`` of each class id, also of recordings of schema 1."""
    return np.where(ids < REASONS, ids, ids // REASONS - 1).astype(np.uint8)


def legend(reasons: Sequence[Reason], has_labels: bool, compares: bool = False) -> list[Entry]:
    """The entry of each outcome, and of each outcome with each reason.

    Of changes between drives, with the reason.
    """
    words = WORDS if has_labels else _WITHOUT_TRUTH
    shades = colours.BRIGHT if has_labels else colours.UNSCORED
    entries: list[Entry] = []
    for outcome in Outcome:
        entries.append((int(outcome), words[outcome], shades[outcome]))
        for code, reason in enumerate(reasons):
            number = (int(outcome) + 1) * REASONS + code
            label = plain(reason) if compares else f"{words[outcome]}: {plain(reason)}"
            entries.append((number, label, shades[outcome]))
    return entries


def plain(reason: Reason) -> str:
    """The name of a reason as words."""
    return reason.name.replace("_", " ")
