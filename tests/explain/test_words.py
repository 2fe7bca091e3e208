"""Numbers and comparisons in words."""

from __future__ import annotations

import math

import hypothesis.strategies as st
import pytest
from hypothesis import given

from dynaviz.contracts.evidence import TESTS
from dynaviz.explain.point_ledger import RuleValue, TermValue
from dynaviz.explain.words import number, rule_words, words

FINITE = st.floats(-1e7, 1e7, allow_nan=False).filter(lambda x: x == 0 or abs(x) > 1e-7)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (12.345, "12.3"),
        (0.281, "0.281"),
        (-0.40546, "-0.405"),
        (1234.567, "1,235"),
        (0.0000123, "0.0000123"),
        (27, "27"),
        (-3.0, "-3"),
        (0.0, "0"),
    ],
)
def test_numbers_have_three_digits(value: float, text: str) -> None:
    assert number(value) == text


@given(FINITE)
def test_a_number_is_close_to_its_text(value: float) -> None:
    read = float(number(value).replace(",", ""))
    assert read == pytest.approx(value, rel=0.0051)


@given(FINITE, st.floats(1e-4, 1e-2), st.booleans())
def test_two_numbers_side_by_side_differ_and_keep_their_order(
    value: float, share: float, more: bool
) -> None:
    other = value * (1 + share if more else 1 - share) + (value == 0)
    one, two = (
        float(text.replace(",", "")) for text in (number(value, other), number(other, value))
    )
    assert (one < two) == (value < other)
    assert (one > two) == (value > other)


def term(value: float | None, test: str, threshold: float, name: str = "sum") -> TermValue:
    holds = value is not None and bool(TESTS[test](value, threshold))
    return TermValue(name, value, test, threshold, "m", holds)


def test_a_comparison_says_on_which_side_it_is() -> None:
    assert words(term(3.5, "<", 0)) == "sum is 3.5, not below 0 m"
    assert words(term(0.19999, "<", 0.2)) == "sum is 0.19999, below 0.2 m"
    assert words(term(None, "<", 0)) == "sum is unknown"
    assert words(term(1.0, "<", math.nan)) == "sum has nothing to compare with"
    assert words(term(0.0, ">=", 1, "hit")) == "hit: no"


def test_a_rule_lists_its_terms() -> None:
    terms = term(2.0, "<", 3), term(0.0, ">=", 1, "hit")
    assert rule_words(RuleValue("void", terms, False, 8)) == (
        "void (frame 8): sum is 2, below 3 m; hit: no"
    )
    assert rule_words(RuleValue("void", (term(None, "<", 3),), False, None)) == (
        "void: does not apply"
    )
