"""Whether coordinates are too coarse, because they were written as float32 far from zero."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynaviz.contracts.attributes import precision_of
from dynaviz.diagnosis.finding import Confidence, Finding
from dynaviz.sources.drive import Drive

COARSEST = 0.02  # metres; steps of coordinates that are not coarse


def check_precision(sequence: Drive, position: int) -> Iterator[Finding]:
    """A finding if the coordinates of a frame have steps of more than ``COARSEST``."""
    found = precision_of(sequence.coordinates(position))
    if found is None or found.step.max() <= COARSEST:
        return
    axis = int(np.argmax(found.step))
    problem = (
        f"coordinates were written as float32, which has steps of {found.step[axis]:g} m in "
        f"{'xyz'[axis]} there"
    )
    fix = "Write float64, or subtract an offset from points and positions first"
    yield Finding("coarse coordinates", Confidence.CERTAIN, problem, fix)
