"""Opening a sequence of any known format; one format per file, found through the entry points ``dynaviz.datasets``."""

from __future__ import annotations

import contextlib
import inspect
import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self

from dynaviz import registry
from dynaviz.errors import DataError, PluginError, UsageError
from dynaviz.scan import Sequence, select_frames
from dynaviz.sensors import load_sensor


class Dataset(Sequence, Protocol):
    """A sequence that can tell and open its own format.

    Attributes:
        layout: the files that make the format, in a few words, for messages.
        fallback: True for a format so general that it is guessed only where no other one matches; may be left out.
    """

    layout: ClassVar[str]

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path looks like this format. Looks at names only, never into files."""
        ...

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a sequence.

        Where it takes the keywords ``poses``, ``points_in`` or ``deskew``, those of ``dynaviz.open`` are handed on.

        Raises:
            DataError: where the path does not hold what the format needs.
        """
        ...


def open_sequence(text: str, sensor: str | None = None, **options: Any) -> Sequence:
    """Open a sequence.

    Args:
        text: a path whose format is guessed, or ``format:PATH``.
        sensor: name of the sensor, where the data do not tell it.
        options: what the format's ``open`` takes beside the path; None stands for its default.

    Raises:
        DataError: where nothing is at the path, or nothing known.
        UsageError: for a format or sensor that is not known, or an option that the format does not take.
    """
    given = {name: value for name, value in options.items() if value is not None}
    kind, path = _asked(text)
    sequence: Sequence = (kind or _guess(path, given)).open(path, **(_fitting(kind, given) if kind else given))
    return select_frames(sequence, sensor=load_sensor(sensor)) if sensor else sequence


def known(text: str) -> bool:
    """Whether ``open_sequence`` finds something at a path, by names alone: no file is read.

    Raises:
        UsageError: for a format that is not known.
    """
    kind, path = _asked(text)
    return (kind is not None and path.exists()) or any(each.matches(path) for each in _kinds())


def _asked(text: str) -> tuple[type[Dataset] | None, Path]:
    """The format that a prefix asks for, if any, and the path."""
    prefix, colon, rest = text.partition(":")
    if not colon or not prefix.isidentifier() or Path(text).exists():
        return None, Path(os.path.abspath(text))
    return registry.load("datasets", prefix), Path(os.path.abspath(rest))


def _takes(kind: type[Dataset], options: Mapping[str, Any]) -> bool:
    return options.keys() <= inspect.signature(kind.open).parameters.keys()


def _fitting(kind: type[Dataset], options: Mapping[str, Any]) -> Mapping[str, Any]:
    """The options, if the format takes them."""
    if not _takes(kind, options):
        flags = ", ".join("--" + name.replace("_", "-") for name in options)
        raise UsageError(
            f"{flags}: {kind.__name__} tells that itself. Leave it out, or force another format (files:PATH)"
        )
    return options


def _kinds() -> list[type[Dataset]]:
    """All formats that can be loaded, those so general that they are asked last at the end."""
    kinds: list[type[Dataset]] = []
    for handle in registry.handles("datasets"):
        with contextlib.suppress(PluginError):  # it breaks nobody else; asking for it by name tells what is wrong
            kinds.append(handle.load())
    return sorted(kinds, key=lambda kind: getattr(kind, "fallback", False))


def _guess(path: Path, options: Mapping[str, Any]) -> type[Dataset]:
    """The first format that matches; with options, of those that take them."""
    kinds = _kinds()
    for kind in kinds:
        if _takes(kind, options) and kind.matches(path):
            return kind
    if options and (other := next((kind for kind in kinds if kind.matches(path)), None)):
        _fitting(other, options)
    if not path.exists():  # asked last: KITTI tracking knows a sequence by training/0012, which is no folder
        raise DataError(path, "does not exist", hint="Give the folder of a sequence")
    sure = [kind for kind in kinds if not getattr(kind, "fallback", False)]
    near = next((place for place in _around(path) if any(kind.matches(place) for kind in sure)), None)
    known = "see the known layouts with 'dynaviz list datasets', or force one as in benchmark:PATH"
    hint = f"Did you mean {near}? Or {known}" if near else f"S{known[1:]}"
    raise DataError(path, f"is no sequence that is known, but {_description(path)}", hint=hint)


def _around(path: Path) -> list[Path]:
    """Where the sequence may be that somebody meant: the folders of a file, those in a folder."""
    if path.is_file():
        return list(path.parents)[:2]
    with contextlib.suppress(OSError):
        return sorted(entry for entry in path.iterdir() if entry.is_dir())
    return []


def _description(path: Path) -> str:
    """What is at a path, for somebody who expected something else there."""
    if path.is_file():
        return f"a file of {path.stat().st_size} bytes"
    try:
        entries = list(path.iterdir())
    except OSError as error:
        return f"a folder that cannot be listed ({error.strerror})"
    kinds = Counter("folders" if entry.is_dir() else f"{entry.suffix or 'other'} files" for entry in entries)
    inside = ", ".join(f"{kind}: {count}" for kind, count in kinds.most_common(3))
    return f"a folder ({inside})" if inside else "an empty folder"
