"""Open a sequence of any supported format.

Formats are plug-ins (entry point group ``dynaviz.datasets``).
"""

from __future__ import annotations

import contextlib
import inspect
import os
import re
from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self

from dynaviz.contracts import registry
from dynaviz.contracts.scan import Sequence
from dynaviz.contracts.sensors import load_sensor
from dynaviz.errors import DataError, PluginError, UsageError
from dynaviz.sources.datasets.lidars import Lidars, names_in
from dynaviz.sources.drive import Drive


class Dataset(Sequence, Protocol):
    """A sequence class that recognises and opens its format.

    Attributes:
        layout: the files of the format, in a few words, for messages.
        fallback: optional; True for a general format that is tried only if no other format matches.
        nested: optional; True for a format whose path names another sequence, with options; it is
            passed on as it is.
        exact: optional; True if poses and sensor are exact: they are neither estimated nor checked.
    """

    layout: ClassVar[str]

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Whether a path looks like this format, judged by file names only."""
        ...

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a sequence.

        The method may accept the keywords ``poses``, ``points_in`` and ``deskew`` of
        ``dynaviz.open``.

        Raises:
            DataError: if files that the format needs are missing or invalid.
        """
        ...


def open_sequence(text: str, sensor: str | None = None, **options: Any) -> Drive:
    """Open a sequence.

    Args:
        text: a path whose format is detected, or ``format:PATH``; with ``#A,B`` several lidars. Or
            the URL of a folder in the layout of the public benchmark.
        sensor: name of the sensor, if the data do not define it.
        options: keywords of the format's ``open``; None means the default.

    Raises:
        DataError: if the path does not exist or is not a recognised sequence.
        UsageError: for an unknown format or sensor, or an option that the format does not accept.
    """
    options = {name: value for name, value in options.items() if value is not None}
    if "://" in text and not Path(text).exists():
        if options:
            raise UsageError(
                f"{', '.join(options)}: not supported for URLs. Leave it out, or copy the data"
            )
        from dynaviz.sources.datasets.remote import RemoteSequence

        return _with_sensor(RemoteSequence(text), sensor)
    if names_in(text):
        return Drive.of(Lidars.open(text, partial(open_sequence, sensor=sensor), **options))
    try:
        dataset, path = _parse(text)
        if dataset is None:
            dataset = _detect(path, options)
        else:
            _check_options(dataset, options)
        sequence: Sequence = dataset.open(path, **options)
    except OSError as error:  # such as a name that is too long, or a folder that may not be listed
        problem = f"cannot be read ({error.strerror or error})"
        raise DataError(
            error.filename or text, problem, hint="Give the folder of a sequence"
        ) from None
    return _with_sensor(sequence, sensor)


def _with_sensor(sequence: Sequence, sensor: str | None) -> Drive:
    """A sequence with the sensor of a name, if one is given."""
    drive = Drive.of(sequence)
    return drive.with_sensor(load_sensor(sensor)) if sensor else drive


def is_sequence(text: str) -> bool:
    """Whether ``open_sequence`` recognises a path, judged by file names only; no file is read.

    Raises:
        UsageError: for an unknown format.
    """
    dataset, path = _parse(text)
    named = dataset is not None and (path.exists() or getattr(dataset, "nested", False))
    return named or any(each.matches(path) for each in _datasets())


def _parse(text: str) -> tuple[type[Dataset] | None, Path]:
    """The format named by a prefix, if any, and the path."""
    prefix, colon, rest = text.partition(":")
    if not colon or not prefix.isidentifier() or Path(text).exists():
        return None, Path(os.path.abspath(text))
    dataset = registry.load("datasets", prefix)
    if prefix == "simulate" and (counted := re.fullmatch(r"([^:?]+):(\d+)(?::(\d+))?", rest)):
        rest = f"{counted[1]}?frames={counted[2]}" + (f"&seed={counted[3]}" if counted[3] else "")
    return dataset, Path(rest if getattr(dataset, "nested", False) else os.path.abspath(rest))


def _accepts(dataset: type[Dataset], options: Mapping[str, Any]) -> bool:
    return options.keys() <= inspect.signature(dataset.open).parameters.keys()


def _check_options(dataset: type[Dataset], options: Mapping[str, Any]) -> None:
    """Raise UsageError if the format does not accept the options."""
    if not _accepts(dataset, options):
        flags = ", ".join("--" + name.replace("_", "-") for name in options)
        format = registry.name_of("datasets", dataset) or dataset.__name__
        raise UsageError(
            f"{flags}: not supported by the format {format}. Leave it out, or force another format "
            "(files:PATH)"
        )


def _datasets() -> list[type[Dataset]]:
    """All formats that can be loaded, with the fallbacks at the end."""
    datasets: list[type[Dataset]] = []
    for handle in registry.handles("datasets"):
        with contextlib.suppress(
            PluginError
        ):  # a broken plug-in is reported when it is requested by name
            datasets.append(handle.load())
    return sorted(datasets, key=lambda dataset: getattr(dataset, "fallback", False))


def _detect(path: Path, options: Mapping[str, Any]) -> type[Dataset]:
    """The first format that matches the path and accepts the options."""
    datasets = _datasets()
    for dataset in datasets:
        if _accepts(dataset, options) and dataset.matches(path):
            return dataset
    if options and (
        other := next((dataset for dataset in datasets if dataset.matches(path)), None)
    ):
        _check_options(other, options)
    if (
        not path.exists()
    ):  # checked last: KITTI tracking accepts training/0012, which is not a folder
        raise DataError(path, "does not exist", hint="Give the folder of a sequence")
    specific = [dataset for dataset in datasets if not getattr(dataset, "fallback", False)]
    near = next(
        (place for place in _nearby(path) if any(dataset.matches(place) for dataset in specific)),
        None,
    )
    hint = "List the supported layouts with 'dynaviz list datasets', or force one: benchmark:PATH"
    if near:
        hint = f"Did you mean {near}? {hint}"
    raise DataError(path, f"is not a recognised sequence; found {_description(path)}", hint=hint)


def _nearby(path: Path) -> list[Path]:
    """Paths that may be the intended sequence.

    The parents of a file, or the subfolders of a folder.
    """
    if path.is_file():
        return list(path.parents)[:2]
    with contextlib.suppress(OSError):
        return sorted(entry for entry in path.iterdir() if entry.is_dir())
    return []


def _description(path: Path) -> str:
    """What is at a path, for error messages."""
    if path.is_file():
        return f"a file of {path.stat().st_size} bytes"
    try:
        entries = list(path.iterdir())
    except OSError as error:
        return f"a folder that cannot be listed ({error.strerror})"
    counts = Counter(
        "folders" if entry.is_dir() else f"{entry.suffix or 'other'} files" for entry in entries
    )
    content = ", ".join(f"{kind}: {count}" for kind, count in counts.most_common(3))
    return f"a folder ({content})" if content else "an empty folder"
