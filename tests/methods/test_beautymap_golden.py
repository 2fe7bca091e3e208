"""The labels of the public implementation on the same input."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz_methods.beautymap.method import BeautyMap


def test_every_label_on_a_street_matches_the_public_program(mini):
    np.testing.assert_array_equal(mini.run(BeautyMap), mini.removed["beautymap"])


def test_labels_match_the_public_program_except_on_borders(golden):
    ours, theirs = golden.run(BeautyMap), golden.removed["beautymap"]
    assert (ours != theirs).sum() <= 10
    assert golden.scores(ours) == pytest.approx(golden.scores(theirs), abs=0.01)
