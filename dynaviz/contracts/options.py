"""Options: each is declared once, as a field of a dataclass.

The command line, the tables of bench files, and the signatures and documentation of Python
functions are made from these fields.
"""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, Literal, TypeVar, get_args, get_type_hints

from dynaviz.contracts.registry import suggest

RecordMode = Literal["full", "errors", "scores"]
Record = Literal[RecordMode, "none"]

_KEY = "option"
_PLAIN = (bool, int, float, str)
F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class OptionText:
    """What a field says about its option besides its name, type and default.

    Attributes:
        help: a sentence or two, for the command line and Python.
        more: further sentences for Python.
        metavar: stands for the value in the help of commands.
        flags: on the command line, such as ``--map/--no-map``; empty for the name of the field.
        accepts: type of the keyword argument, as it is written; empty for that of the field.
        typed: type on the command line; None for that of the field.
        least: the smallest number.
    """

    help: str
    more: str = ""
    metavar: str | None = None
    flags: tuple[str, ...] = ()
    accepts: str = ""
    typed: Any = None
    least: int | None = None


def option(help: str, **more: Any) -> dict[str, OptionText]:
    """The metadata of a field that is an option.

    Args:
        help, more: as for ``OptionText``.
    """
    return {_KEY: OptionText(help, **more)}


@dataclass(frozen=True)
class Option:
    """An option, as the field of a dataclass declares it.

    Attributes:
        name: of the field and the keyword argument.
        annotation: type of the keyword argument, as it is written.
        kind: type of the field.
        default: if it is not given.
        text: what the field says about it.
    """

    name: str
    annotation: str
    kind: Any
    default: Any
    text: OptionText

    @property
    def plain(self) -> type:
        """The type of its value in a file: bool, int, float or str."""
        parts = get_args(self.kind) or (self.kind,)
        return next(each for each in _PLAIN if each in parts)

    @property
    def words(self) -> str:
        """What it does, in Python."""
        return " ".join(part for part in (self.text.help, self.text.more) if part)


def options_of(*kinds: type) -> Iterator[Option]:
    """The options that dataclasses declare."""
    for kind in kinds:
        hints = get_type_hints(kind)
        for each in fields(kind):
            yield Option(
                each.name,
                each.metadata[_KEY].accepts or str(each.type),
                hints[each.name],
                each.default,
                each.metadata[_KEY],
            )


def keywords_of(*kinds: type) -> Callable[[F], F]:
    """State the options of dataclasses in the signature and the documentation of a function, which
    receives them as further keyword arguments.
    """

    def decorate(function: F) -> F:
        own = inspect.signature(function)
        listed = [each for each in own.parameters.values() if each.kind != each.VAR_KEYWORD]
        options = list(options_of(*kinds))
        listed += [
            inspect.Parameter(
                each.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=each.default,
                annotation=each.annotation,
            )
            for each in options
        ]
        function.__signature__ = own.replace(parameters=listed)  # type: ignore[attr-defined]
        fill = partial(textwrap.fill, width=96, initial_indent=" " * 4, subsequent_indent=" " * 8)
        said = "\n".join(fill(f"{each.name}: {each.words}") for each in options)
        function.__doc__ = f"{inspect.getdoc(function)}\n\nOptions:\n{said}\n"
        return function

    return decorate


def check_keywords(function: Callable[..., Any], given: Mapping[str, Any]) -> None:
    """Raise TypeError for a keyword argument that a function with options does not have."""
    known = inspect.signature(function).parameters
    for name in given:
        if name not in known:
            problem = f"{function.__name__}() has no keyword argument '{name}'"
            raise TypeError(f"{problem}. {suggest(name, known)}")
