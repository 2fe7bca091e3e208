"""What a bench is made of: sequences x parameter sets = cells; read from a TOML file or from flags."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import itertools
import json
import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from dynaviz import params, registry
from dynaviz.errors import UsageError
from dynaviz.registry import suggest
from dynaviz.viz.paths import Mode

RECORDS = (*get_args(Mode), "none")
KEYS: dict[str, dict[str, Any]] = {
    "bench": {"methods": list, "sequences": list, "variants": list, "grid": dict, "search": dict, "holdout": list,
              "record": str, "workers": int, "timing": bool},
    "sequences": {"path": str, "simulate": str, "name": str, "frames": (str, int), "stride": int, "sensor": str,
                  "seed": int},
    "variants": {"method": str, "name": str, "preset": str, "config": str, "set": dict, "online": bool, "seed": int},
    "search": {"kind": str, "trials": int, "seed": int, "ranges": dict},
}  # fmt: skip
"""The keys of a bench's TOML file and of its tables, with the types of their values."""


@dataclass(frozen=True)
class Source:
    """A sequence of a bench.

    Attributes:
        name: of its folder and in tables.
        path: what ``dynaviz.open`` takes; empty for a simulated scene, which is written when the bench begins.
        frames: ``A:B``; for a simulated scene the number of sweeps.
        stride, sensor: as in ``dynaviz.open``.
        scene: a simulated scene's name, or empty.
        seed: of the simulated scene.
    """

    name: str
    path: str = ""
    frames: str | int | None = None
    stride: int = 1
    sensor: str | None = None
    scene: str = ""
    seed: int = 0


@dataclass(frozen=True)
class ParameterSet:
    """A method with all its parameters.

    Attributes:
        method: its name.
        variant: what tells this set from others of the method; empty for the defaults.
        parameters: every parameter of the method.
        online, seed: as in ``dynaviz.run``.
    """

    method: str
    variant: str
    parameters: Mapping[str, Any]
    online: bool = False
    seed: int = 0

    @classmethod
    def of(
        cls,
        method: str,
        variant: str = "",
        values: Mapping[str, Any] | None = None,
        *,
        preset: str | None = None,
        config: str | None = None,
        online: bool | None = None,
        seed: int | None = None,
    ) -> ParameterSet:
        """Resolve and check parameters.

        Raises:
            UsageError: for a method, preset, parameter or value that does not exist.
        """
        kind = registry.load("methods", method)
        resolved = params.resolve(kind, preset, config, settings(values or {}))
        return cls(
            method,
            variant,
            dataclasses.asdict(resolved.params),
            bool(online if online is not None else resolved.online),
            seed if seed is not None else resolved.seed or 0,
        )

    def changed(self, values: Mapping[str, Any]) -> ParameterSet:
        """This set with other values for some parameters, named after them."""
        other = ParameterSet.of(self.method, variant(values), {**self.parameters, **values})
        return dataclasses.replace(other, online=self.online, seed=self.seed)


@dataclass(frozen=True)
class Cell:
    """One run of a bench.

    Attributes:
        source, what: the sequence, and the method with its parameters.
        digest: of the sequence's content; empty where it could not be read.
        record: how much its recording holds.
        timing: whether its runtime must be comparable: nothing recorded, all cores.
    """

    source: Source
    what: ParameterSet
    digest: str
    record: str
    timing: bool = False

    @property
    def path(self) -> Path:
        """Its folder below the bench's."""
        return Path(self.source.name, "-".join(filter(None, [self.what.method, self.what.variant])))


@dataclass(frozen=True)
class Search:
    """A search for the best parameters.

    Attributes:
        kind: ``random`` or ``bayes``.
        trials: how many sets to try, of each method.
        ranges: by method and parameter: ``LOW:HIGH`` or ``log:LOW:HIGH``.
        seed: for the choice of trials.
    """

    kind: str
    trials: int
    ranges: Mapping[str, Mapping[str, str]]
    seed: int = 0


@dataclass(frozen=True)
class Plan:
    """A bench, checked.

    Attributes:
        sets, sources: what runs on what.
        holdout: names of the sequences that a search never looks at.
        search: None without one.
        record, workers, timing: as the keys of the file.
    """

    sets: tuple[ParameterSet, ...]
    sources: tuple[Source, ...]
    holdout: frozenset[str] = frozenset()
    search: Search | None = None
    record: str = "errors"
    workers: int = 1
    timing: bool = False

    @classmethod
    def of(cls, table: Mapping[str, Any], place: str = "bench") -> Plan:
        """Check a table as ``read`` gives it.

        Args:
            table: keys and values as in the file.
            place: where it comes from, for errors.

        Raises:
            UsageError: for an unknown key, a wrong type, or a method, parameter, scene or sensor that does not exist.
        """
        table = checked(table, "bench", place)
        search = _search(table["search"], f"{place} [search]") if table.get("search") else None
        sources = [_source(entry, f"{place} [[sequences]] {n}") for n, entry in _numbered(table, "sequences")]
        held = [_held(entry, sources) for entry in table.get("holdout", [])]
        sources += [source for source in held if source not in sources]
        record, workers, timing = table.get("record"), table.get("workers", 1), table.get("timing", False)
        plan = cls(
            tuple(_sets(table, search, place)),
            tuple(sources),
            frozenset(source.name for source in held),
            search,
            record or ("none" if timing else "errors"),
            workers,
            timing,
        )
        plan._check(place)
        return plan

    def _check(self, place: str) -> None:
        learning = [source for source in self.sources if source.name not in self.holdout]
        if not learning:
            raise UsageError(f"{place}: give at least one sequence that is not held out: -s SEQ or [[sequences]]")
        if self.record not in RECORDS:
            raise UsageError(f"{place}: record = {self.record!r}. {suggest(self.record, RECORDS)}")
        if self.workers < 1:
            raise UsageError(f"{place}: workers = {self.workers}: give at least 1")
        if self.timing and (self.workers > 1 or self.record != "none"):
            raise UsageError(
                f"{place}: timing runs one cell at a time and records nothing: leave out workers and record"
            )
        if self.holdout and not self.search:
            raise UsageError(f"{place}: holdout keeps sequences from a search: add --search bayes --trials N")
        for kind, names in (
            ("sequences", [source.name for source in self.sources]),
            ("variants", ["-".join([what.method, what.variant]) for what in self.sets]),
        ):
            if twice := next((name for name in names if names.count(name) > 1), None):
                raise UsageError(f"{place}: two {kind} are called '{twice.rstrip('-')}': give one another name")


def read(path: Path) -> dict[str, Any]:
    """Read a bench's TOML file; paths in it are relative to its folder.

    Raises:
        DataError: where it cannot be read or is not TOML.
        UsageError: for an unknown key.
    """
    table, base = checked(params.read_toml(path), "bench", os.fspath(path)), path.parent

    def here(entry: Any, key: str) -> Any:
        if isinstance(entry, str):
            return anchored(entry, base)
        if isinstance(entry, dict) and isinstance(entry.get(key), str):
            return {**entry, key: anchored(entry[key], base)}
        return entry

    table["sequences"] = [here(entry, "path") for entry in table.get("sequences", [])]
    table["variants"] = [here(entry, "config") for entry in table.get("variants", [])]
    return table


def anchored(text: str, base: Path) -> str:
    """A sequence's path made absolute; a ``FORMAT:`` before it stays, a scene to simulate is none."""
    prefix, colon, rest = text.partition(":")
    if not colon or not prefix.isidentifier() or (base / text).exists():
        return os.path.abspath(base / text)
    return text if prefix == "simulate" else f"{prefix}:{os.path.abspath(base / rest)}"


def checked(table: Mapping[str, Any], kind: str, place: str) -> dict[str, Any]:
    """A table all whose keys are known, with values of the right types.

    Raises:
        UsageError: for any other, naming the nearest known key.
    """
    for key, value in table.items():
        if key not in KEYS[kind]:
            raise UsageError(f"{place}: unknown key '{key}'. {suggest(key, KEYS[kind])}")
        wanted = KEYS[kind][key]
        if not isinstance(value, wanted) or (isinstance(value, bool) and wanted is not bool):
            names = " or ".join(kind.__name__ for kind in (wanted if isinstance(wanted, tuple) else (wanted,)))
            raise UsageError(f"{place}: {key} = {value!r}: give a value of type {names}")
    return dict(table)


def settings(values: Mapping[str, Any]) -> tuple[str, ...]:
    """Values as ``--set`` takes them."""
    import tomli_w

    return tuple(tomli_w.dumps({key: value}).strip() for key, value in values.items())


def variant(values: Mapping[str, Any]) -> str:
    """A short name for a choice of values, fit for a folder: the same values, the same name."""
    plain = ",".join(f"{key}={json.dumps(value, separators=(',', ':'))}" for key, value in sorted(values.items()))
    name = re.sub(r"[^\w.=,+\[\]-]", "", plain)
    return name if len(name) <= 48 else "set-" + hashlib.sha256(plain.encode()).hexdigest()[:8]


def assignment(text: str, flag: str) -> tuple[str, str, str]:
    """Split ``METHOD.PARAM=VALUES``."""
    found = re.fullmatch(r"\s*([\w]+)\.(\w+)\s*=(.+)", text)
    if not found:
        raise UsageError(f"{flag} {text}: write METHOD.PARAM=VALUES, for example {flag} octomap.resolution="
                         + ("0.1,0.2" if flag == "--grid" else "0.05:0.4"))  # fmt: skip
    return found[1], found[2], found[3]


def values_of(text: str) -> list[Any]:
    """Values between commas, as in TOML; what is none is a string."""
    try:
        parsed: list[Any] = tomllib.loads(f"values = [{text}]")["values"]
    except tomllib.TOMLDecodeError:
        return [part.strip() for part in text.split(",")]
    return parsed


def _numbered(table: Mapping[str, Any], key: str) -> Iterable[tuple[int, Any]]:
    return enumerate(table.get(key, []), 1)


def _source(entry: Any, place: str) -> Source:
    """A sequence from a string (PATH, FORMAT:PATH or simulate:SCENE[:FRAMES[:SEED]]) or from a table."""
    if isinstance(entry, str):
        prefix, *rest = entry.split(":")
        if prefix != "simulate":
            return _source({"path": anchored(entry, Path())}, place)
        try:
            scene, frames, seed = [*rest, None, None][:3]
            numbers = {key: int(text) for key, text in (("frames", frames), ("seed", seed)) if text is not None}
        except ValueError:
            raise UsageError(f"{entry}: write simulate:SCENE[:FRAMES[:SEED]], as simulate:demo:20") from None
        return _source({"simulate": scene, **numbers}, entry)
    if not isinstance(entry, dict):
        raise UsageError(f"{place}: {entry!r}: give a path, or a table with a path or a scene to simulate")
    entry = checked(entry, "sequences", place)
    if ("path" in entry) == ("simulate" in entry):
        raise UsageError(f"{place}: give either path or simulate")
    source = _simulated(entry, place) if "simulate" in entry else _recorded(entry, place)
    if source.name != re.sub(r"[/\\:\s]", "", source.name) or source.name in ("", ".", "..", "sequences"):
        raise UsageError(f"{place}: name = {source.name!r} names no folder: give another")
    if source.sensor:
        from dynaviz.sensors import load_sensor

        load_sensor(source.sensor)
    return source


def _simulated(entry: Mapping[str, Any], place: str) -> Source:
    from dynaviz.simulate.presets import PRESETS

    scene, frames, seed = entry["simulate"], entry.get("frames"), entry.get("seed", 0)
    if scene not in PRESETS:
        raise UsageError(f"{place}: no scene '{scene}'. {suggest(scene, PRESETS)}")
    if isinstance(frames, str):
        raise UsageError(f"{place}: frames = {frames!r}: a simulated scene takes a number of frames")
    name = entry.get("name") or scene + (f"-{frames}" if frames else "") + (f"-seed{seed}" if seed else "")
    return Source(name, "", frames, entry.get("stride", 1), entry.get("sensor"), scene, seed)


def _recorded(entry: Mapping[str, Any], place: str) -> Source:
    if "seed" in entry:
        raise UsageError(f"{place}: seed is for a scene to simulate")
    frames = f":{entry['frames']}" if isinstance(entry.get("frames"), int) else entry.get("frames")
    name = entry.get("name") or Path(entry["path"].rpartition(":")[2]).name
    return Source(name, entry["path"], frames, entry.get("stride", 1), entry.get("sensor"))


def _held(entry: Any, sources: Iterable[Source]) -> Source:
    """A sequence that is held out: by its name, or a further one."""
    if named := next((source for source in sources if source.name == entry), None):
        return named
    other = _source(entry, "holdout")
    return next((source for source in sources if source == other), other)


def _sets(table: Mapping[str, Any], search: Search | None, place: str) -> Iterable[ParameterSet]:
    """Every method with its defaults, then the variants, then the grids."""
    grids = table.get("grid", {})
    variants = [
        checked(entry, "variants", f"{place} [[variants]] {n}") if isinstance(entry, dict) else {}
        for n, entry in _numbered(table, "variants")
    ]
    named = [*grids, *(entry.get("method", "") for entry in variants), *(search.ranges if search else ())]
    methods = table.get("methods") or list(dict.fromkeys(named)) or [h.name for h in registry.handles("methods")]
    base = {method: ParameterSet.of(str(method)) for method in dict.fromkeys(methods)}
    yield from base.values()
    for n, entry in enumerate(variants, 1):
        with _told(f"{place} [[variants]] {n}"):
            yield _variant(entry)
    for method, axes in grids.items():
        with _told(f"{place} [grid.{method}]"):
            yield from _grid(ParameterSet.of(method), axes)


def _variant(entry: Mapping[str, Any]) -> ParameterSet:
    rest = {key: entry.get(key) for key in ("preset", "config", "online", "seed")}
    if "method" not in entry or not any(key in entry for key in ("set", *rest)):
        raise UsageError("give a method, and what is special: preset, config, set, online or seed")
    values = entry.get("set", {})
    name = entry.get("name") or "-".join(
        filter(None, [entry.get("preset"), variant(values), "online" if entry.get("online") else ""])
    )
    if not re.fullmatch(r"[\w.=,+\[\]-]+", name):
        raise UsageError("give the variant a name of letters, digits and -_.=,+")
    return ParameterSet.of(entry["method"], name, values, **rest)


def _grid(base: ParameterSet, axes: Any) -> Iterable[ParameterSet]:
    if not isinstance(axes, dict) or not all(isinstance(values, list) and values for values in axes.values()):
        raise UsageError("give each parameter a list of values")
    for values in itertools.product(*axes.values()):
        yield base.changed(dict(zip(axes, values, strict=True)))


@contextlib.contextmanager
def _told(place: str) -> Iterator[None]:
    """Say in which table a wrong parameter stands."""
    try:
        yield
    except UsageError as error:
        raise UsageError(f"{place}: {str(error).removeprefix('--set: ')}") from None


def _search(table: Mapping[str, Any], place: str) -> Search:
    table = checked(table, "search", place)
    kinds = ("random", "bayes")
    if table.get("kind") not in kinds:
        raise UsageError(f"{place}: kind = {table.get('kind')!r}. {suggest(str(table.get('kind')), kinds)}")
    if table.get("trials", 0) < 1 or not table.get("ranges"):
        raise UsageError(
            f"{place}: give trials, at least 1, and ranges, as --trials 30 --range octomap.resolution=0.05:0.4"
        )
    ranges = {method: dict(axes) for method, axes in table["ranges"].items()}
    return Search(table["kind"], table["trials"], ranges, table.get("seed", 0))
