"""Colours of a recording."""

from __future__ import annotations

import pytest
from helpers.colour_vision import EYES, smallest_difference

from dynaviz.scan import Outcome
from dynaviz.viz import paths


@pytest.mark.parametrize("eye", EYES)
def test_outcomes_differ_to_every_eye(eye: str) -> None:
    assert smallest_difference([paths.COLOURS[Outcome(i)] for i in range(4)], eye) > 25
