"""Class ids: outcome and reason in one number."""

from __future__ import annotations

import numpy as np

from dynaviz import colours
from dynaviz.contracts.method import Reason
from dynaviz.contracts.scan import Outcome
from dynaviz.views import classes

REASONS = (Reason("never_crossed", "no ray"), Reason("crossed", "rays"))


def test_ids_contain_outcome_and_reason_and_each_has_a_label() -> None:
    outcome = np.repeat(np.arange(6, dtype=np.uint8), 2)
    reasons = np.tile(np.array([0, 1], np.uint8), 6)
    ids = classes.encode(outcome, reasons, len(REASONS))
    assert ids.dtype == np.uint16
    np.testing.assert_array_equal(classes.outcomes(ids), outcome)
    legend = {
        number: (label, colour)
        for number, label, colour in classes.legend(REASONS, has_labels=True)
    }
    assert set(ids.tolist()) < set(legend)
    ghost = int(classes.encode(np.array([Outcome.FALSE_NEGATIVE]), np.array([0]), 2)[0])
    assert legend[ghost] == ("ghost: never crossed", colours.BRIGHT[Outcome.FALSE_NEGATIVE])
    words = {label for _, label, _ in classes.legend(REASONS, has_labels=False)}
    assert "appeared" in {
        label
        for _, label, _ in classes.legend(
            (Reason("appeared", "x"),), has_labels=False, compares=True
        )
    }
    assert {"kept: crossed", "removed: crossed"} < words
    assert not any("unlabelled" in word for word in words)


def test_earlier_recordings_and_unnamed_codes_have_the_outcome_alone() -> None:
    plain = np.arange(6, dtype=np.uint16)
    np.testing.assert_array_equal(classes.outcomes(plain), plain)
    unnamed = classes.encode(plain.astype(np.uint8), np.full(6, 200, np.uint8), len(REASONS))
    np.testing.assert_array_equal(unnamed, plain)
