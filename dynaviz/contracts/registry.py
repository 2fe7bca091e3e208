"""Find methods, datasets, metrics and reports through entry points, built-in ones and plug-ins
alike.
"""

from __future__ import annotations

import difflib
import importlib
import sys
import warnings
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from dynaviz import source_files
from dynaviz.errors import PluginError, UsageError

BEST = "seethrough"
"""The method if a user names none: the one with the best mean rank (``docs/methods``)."""


@dataclass(frozen=True)
class PluginHandle:
    """An installed plug-in that may not be loaded yet.

    Attributes:
        kind: ``methods``, ``datasets``, ``metrics`` or ``reports``.
        name: name on the command line.
        target: ``module:Class``, for reports ``module:function``.
        distribution, version: the package that provides it.
    """

    kind: str
    name: str
    target: str
    distribution: str
    version: str

    def load(self) -> Any:
        """Import the class or function.

        Raises:
            PluginError: if its code cannot be imported.
        """
        module, _, attribute = self.target.partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)
        except Exception as error:
            raise PluginError(
                f"{self.kind.removesuffix('s')} '{self.name}' of {self.distribution} "
                f"{self.version} cannot be loaded: "
                f"{type(error).__name__}: {error}. Reinstall that package or report it to its "
                "authors."
            ) from error

    @property
    def package(self) -> str:
        """The importable top-level package of the target."""
        return self.target.partition(":")[0].partition(".")[0]


def handles(kind: str) -> list[PluginHandle]:
    """All plug-ins of a kind, sorted by name.

    If two have the same name, the first one found is used.
    """
    return list(_handles(kind, tuple(sys.path)))


@cache  # the files of all installed packages are read once, and again for another path
def _handles(kind: str, path: tuple[str, ...]) -> list[PluginHandle]:
    found: dict[str, PluginHandle] = {}
    for point in metadata.entry_points(group=f"dynaviz.{kind}"):
        name, version = (point.dist.name, point.dist.version) if point.dist else ("?", "?")
        found.setdefault(point.name, PluginHandle(kind, point.name, point.value, name, version))
    return [found[name] for name in sorted(found)]


def load(kind: str, name: str) -> Any:
    """Load a plug-in by its name.

    Raises:
        UsageError: for an unknown name; the message suggests a similar one.
        PluginError: if its code cannot be imported.
    """
    known = {handle.name: handle for handle in handles(kind)}
    if name not in known:
        raise UsageError(f"unknown {kind.removesuffix('s')} '{name}'. {suggest(name, known)}")
    return known[name].load()


def name_of(kind: str, value: type) -> str | None:
    """The name of a class on the command line; None if it is not a plug-in of that kind."""
    target = f"{value.__module__}:{value.__qualname__}"
    return next((handle.name for handle in handles(kind) if handle.target == target), None)


def loadable(kind: str) -> dict[str, Any]:
    """All plug-ins of a kind by name, loaded.

    A plug-in that cannot be loaded raises a warning and is left out.
    """
    found = {}
    for handle in handles(kind):
        try:
            found[handle.name] = handle.load()
        except PluginError as error:
            warnings.warn(str(error), stacklevel=2)
    return found


def suggest(name: str, known: Any) -> str:
    """A sentence that suggests a known name similar to ``name``, or lists all known names."""
    near = difflib.get_close_matches(name, list(known), 1)
    return f"Did you mean '{near[0]}'?" if near else f"Known: {', '.join(sorted(known)) or 'none'}."


def files_of_methods(pattern: str) -> list[Path]:
    """Files that packages bring for their methods, such as ``sampling.json``.

    They lie in the folder of a method's module, or in one above it, within its package. No package
    is imported.
    """
    found: dict[Path, None] = {}
    for handle in handles("methods"):
        steps = handle.target.partition(":")[0].split(".")
        for depth in range(1, len(steps) + 1):
            for folder in source_files.folders(".".join(steps[:depth])):
                found |= dict.fromkeys(sorted(folder.glob(pattern)))
    return list(found)


def preset_files() -> dict[str, list[Path]]:
    """Files of each preset by name: ``presets/*.toml`` beside each method, and in its package."""
    presets: dict[str, list[Path]] = {}
    for file in files_of_methods("presets/*.toml"):
        presets.setdefault(file.stem, []).append(file)
    return presets
