"""Options that follow a path or a scene: ``cars=6&seed=3``."""

from __future__ import annotations

from collections.abc import Iterable
from urllib.parse import unquote

from dynaviz.contracts.registry import suggest
from dynaviz.errors import UsageError


def options_of(place: str, query: str, known: Iterable[str]) -> dict[str, str]:
    """The values of a query by name.

    Raises:
        UsageError: for an unknown option, or one that is given twice; the message starts with
            ``place``.
    """
    values: dict[str, str] = {}
    for part in filter(None, query.split("&")):
        key, equals, value = part.partition("=")
        if key not in known or not equals:
            raise UsageError(f"{place}: unknown option '{part}'. {suggest(key, known)}")
        if key in values:
            raise UsageError(f"{place}: {key} is given twice. Remove one")
        values[key] = unquote(value)
    return values


def whole(place: str, key: str, text: str) -> int:
    """A whole number; UsageError for any other text."""
    try:
        return int(text)
    except ValueError:
        raise UsageError(f"{place}: {key} = {text!r}: give a whole number") from None
