"""How much of a recording fits into a number of bytes.

States are left out first, then drawn points.
"""

from __future__ import annotations

import re

from dynaviz.errors import UsageError

_UNITS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
# bytes of the label, ground truth, reason and range band of a point, compressed; on simulated scans
ANSWER = 1.0
DRAWN = 1.0  # bytes per point of the sequence for the drawn points of frames
TEXTS = 1_000_000  # bytes of texts, curves and layout
# bytes per point of the map of the whole run, and its points at most
MAP = 5.0
MAPPED = 550_000
CASES = 20  # with the scan and the states of their worst frame
# bytes of a case: per point of its scan, and of its states
CASE = 1.6
CASE_STATES = 80_000


class Quota:
    """Spreads a budget evenly over a run.

    Args:
        budget: bytes of the whole file; None for any size.
        points, frames: of the sequence.
        two_passes: whether all scans are observed before the first one is labelled.
    """

    def __init__(
        self, budget: int | None, points: int, frames: int, two_passes: bool = True
    ) -> None:
        self._budget = budget
        self._points = points
        self._frames = max(frames, 1)
        self._first = 0.5 if two_passes else 0.0
        self._answered = 0
        self._fixed = fixed(points, self._frames)

    def answered(self, points: int) -> None:
        """Count the points of a scan whose labels are stored."""
        self._answered += points

    def states(self, size: int, frame: int, labels: bool = False) -> bool:
        """Whether the states of a frame fit.

        Args:
            size: bytes of the file so far.
            frame: position in the run.
            labels: whether they are those of labelling the scan, not of observing it.
        """
        if self._budget is None:
            return True
        others = ANSWER + DRAWN
        done = (self._first if labels else 0.0) + (1 - self._first) * (frame + 1) / self._frames
        room = self._budget - self._fixed - others * self._points
        return size - others * self._answered < room * done

    def drawing(self, size: int) -> bool:
        """Whether the drawn points of the next scan fit, given the bytes of the file so far."""
        left = (self._points - self._answered) * ANSWER
        return self._budget is None or size + left < self._budget - self._fixed


def fixed(points: int, frames: int) -> float:
    """Bytes of what follows the frames, at most.

    The map of the whole run, cases, texts and layout.
    """
    return (
        TEXTS + MAP * min(points, MAPPED) + CASES * (CASE * points / max(frames, 1) + CASE_STATES)
    )


def parse_bytes(text: str) -> int:
    """Read a size: ``500MB``, ``2GB``, ``1.5 TB``, or bytes.

    Raises:
        UsageError: for anything else.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kMGT]?)B?\s*", text, re.IGNORECASE)
    if not found:
        raise UsageError(f"--record-budget {text}: give a size, such as 500MB or 2GB")
    unit = next(number for name, number in _UNITS.items() if name.lower() == found[2].lower())
    return round(float(found[1]) * unit)
