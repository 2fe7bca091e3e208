"""Numbers, terms and rules in words: the only place that words them.

Sentences, tables, recordings and the page of the explorer read the same texts.
"""

from __future__ import annotations

import math

from dynaviz.explain.point_ledger import RuleValue, TermValue

BOUNDS = {"<": "below", "<=": "at most", ">": "above", ">=": "at least"}
DIGITS = 3  # significant
MOST_DIGITS = 8  # to tell two numbers apart that are equal with fewer


def number(value: float, beside: float | None = None) -> str:
    """A number with three significant digits, and with all digits of its whole part.

    Args:
        value: to write.
        beside: another number that is written next to it; if the two differ, their texts do.
    """
    for digits in range(DIGITS, MOST_DIGITS + 1):
        text = _rounded(value, digits)
        if beside is None or beside == value or text != _rounded(beside, digits):
            return text
    return text


def words(term: TermValue) -> str:
    """A comparison in words, such as ``log-odds is 3.5, not below 0``."""
    if yes_or_no(term):
        return f"{term.name}: {'yes' if term.value else 'no'}"
    if term.value is None or not math.isfinite(term.value):
        return f"{term.name} is unknown"
    if math.isnan(term.threshold):
        return f"{term.name} has nothing to compare with"
    unit = f" {term.unit}" if term.unit else ""
    threshold = number(term.threshold, term.value)
    bound = f"{'' if term.holds else 'not '}{BOUNDS[term.test]} {threshold}{unit}"
    return f"{term.name} is {number(term.value, term.threshold)}, {bound}{_set_by(term)}"


def needed(term: TermValue, best: bool = False) -> str:
    """What a number is and what it would have to be to remove the point.

    Such as ``scan points in its bin 3, needed at least 6, `min_points```.

    Args:
        term: to word.
        best: whether the number is the closest one of several scans.
    """
    if yes_or_no(term) or term.value is None or math.isnan(term.threshold):
        return words(term)
    unit = f" {term.unit}" if term.unit else ""
    value = number(term.value, term.threshold)
    threshold = number(term.threshold, term.value)
    shown = f"{term.name} {value}{' at best' if best else ''}"
    return f"{shown}, needed {BOUNDS[term.test]} {threshold}{unit}{_set_by(term)}"


def failed(term: TermValue) -> str:
    """How a term failed, as short as a cell of a table: ``scan points in its bin 3 of 6``."""
    if yes_or_no(term) or term.value is None or math.isnan(term.threshold):
        return words(term)
    value = number(term.value, term.threshold)
    threshold = number(term.threshold, term.value)
    if term.test == ">=" and term.value.is_integer() and term.threshold.is_integer():
        return f"{term.name} {value} of {threshold}"
    return f"{term.name} {value}, not {term.test} {threshold}{f' {term.unit}' if term.unit else ''}"


def rule_words(rule: RuleValue) -> str:
    """A rule with its terms, such as ``free: log-odds is 3.5, not below 0``."""
    if all(term.value is None for term in rule.terms):
        return f"{rule.name}: does not apply"
    scan = "" if rule.frame is None else f" (frame {rule.frame})"
    return f"{rule.name}{scan}: {'; '.join(map(words, rule.terms))}"


def yes_or_no(term: TermValue) -> bool:
    """Whether the number of a term is a truth value."""
    return term.threshold == 1 and term.test in ("<", ">=") and term.value in (0, 1)


def _set_by(term: TermValue) -> str:
    """The parameter that sets the threshold."""
    return f", `{term.parameter}`" if term.parameter else ""


def _rounded(value: float, digits: int) -> str:
    if not math.isfinite(value):
        return str(value)
    if value == int(value):
        return f"{value:,.0f}"
    whole = math.floor(math.log10(abs(value))) + 1
    decimals = max(digits - whole, 0 if digits == DIGITS else digits - DIGITS)
    text = f"{value:,.{decimals}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
