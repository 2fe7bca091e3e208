"""Differences in settings and runtime between two results, and short names that tell runs apart."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dynaviz.scores.result import Result

NAMED = 2  # settings in the name of a run, at most
CODE = 8  # digits of the digest of a method's code that are shown


@dataclass(frozen=True, slots=True)
class SettingChange:
    """A setting that differs; ``first`` or ``second`` is None if that run does not have it."""

    name: str
    first: Any
    second: Any


@dataclass(frozen=True, slots=True)
class RuntimeRatio:
    """Runtimes of two runs.

    Attributes:
        ratio: seconds per frame of the second run over the first's; None if they are not
            comparable.
        first_s, second_s: mean seconds per frame; None if not measured.
        notes: why there is no ratio, or what to keep in mind about it.
    """

    ratio: float | None
    first_s: float | None
    second_s: float | None
    notes: tuple[str, ...]


def names(results: Sequence[Result], paths: Sequence[Path]) -> list[str]:
    """Short names of runs: the method, and the settings that distinguish it from other runs of the
    same method.
    """
    found = []
    for result, path in zip(results, paths, strict=True):
        own = _settings_of(result)
        same = [other for other in results if other.method == result.method]
        differing = [
            name
            for name, value in own.items()
            if any(_settings_of(o).get(name) != value for o in same)
        ]
        words = [f"{name}={text(own[name])}" for name in differing[:NAMED]]
        if not differing and len(same) > 1:
            words = [_folder(path, [p for r, p in zip(results, paths, strict=True) if r in same])]
        found.append(" ".join([result.method, *filter(None, words)]))
    return found


def _folder(path: Path, paths: Sequence[Path]) -> str:
    """The last part of a path in which it differs from the other paths."""
    parts = [_parts(each) for each in paths]
    own = _parts(path)
    for k, part in enumerate(own):
        if sum(k < len(each) and each[k] == part for each in parts) < len(parts):
            return part
    return own[0] if own else ""


def _parts(path: Path) -> list[str]:
    """The parts of a path, last first; the usual name of a recording is left out."""
    parts = list(reversed(path.with_suffix("").parts))
    return parts[1:] if parts[:1] == ["run"] else parts


def text(value: Any) -> str:
    """A setting's value as shown in tables and names."""
    if value is None:
        return "-"
    return value if isinstance(value, str) else json.dumps(value)


def setting_changes(first: Result, second: Result) -> tuple[SettingChange, ...]:
    """All settings that differ between two runs."""
    a = _settings_of(first)
    b = _settings_of(second)
    differing = [name for name in dict.fromkeys([*a, *b]) if a.get(name) != b.get(name)]
    return tuple(SettingChange(name, a.get(name), b.get(name)) for name in differing)


def _settings_of(result: Result) -> dict[str, Any]:
    chosen = {"method": result.method, "scoring": result.scoring, "preset": result.preset}
    settings = {**chosen, "online": result.online, "seed": result.seed, **result.parameters}
    if result.plugin is not None and result.plugin.sha256:
        settings["code"] = result.plugin.sha256[:CODE]
        settings["version"] = result.plugin.version
    return settings


def runtime_ratio(first: Result, second: Result) -> RuntimeRatio:
    """Compare the runtimes of two runs."""
    a = first.runtime.mean_s
    b = second.runtime.mean_s
    sources = [result.method for result in (first, second) if result.sections.source]
    notes = [
        f"no runtime ratio: the labels of {method} were read from a file" for method in sources
    ]
    if not notes and (a is None or b is None):
        notes.append("no runtime ratio: one runtime was not measured")
    if not notes and first.instrumented != second.instrumented:
        recorded = (first if first.instrumented else second).method
        notes.append(f"no runtime ratio: only {recorded} ran with its states recorded")
    ratio = b / a if a and b is not None and not notes else None
    if ratio is not None and first.instrumented:
        notes.append("both ran with their states recorded")
    threads = first.runtime.threads, second.runtime.threads
    if threads[0] != threads[1]:
        notes.append(f"threads differ: {threads[0]}, {threads[1]}")
    machines = first.environment.machine, second.environment.machine
    if machines[0] != machines[1]:
        notes.append(f"machines differ: {machines[0]}, {machines[1]}")
    return RuntimeRatio(ratio, a, b, tuple(notes))
