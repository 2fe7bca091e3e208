"""Reads the plan of a bench from a TOML file or from flags, and reports every mistake before
anything runs.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_args

from dynaviz.benchmarking.plan import BenchPlan, ParameterSet, SearchSpec, SequenceSpec, variant
from dynaviz.contracts import params, registry
from dynaviz.contracts.options import Record, options_of
from dynaviz.contracts.registry import suggest
from dynaviz.errors import UsageError
from dynaviz.sources.datasets import is_sequence
from dynaviz.sources.opening import absolute
from dynaviz.sources.options import SequenceOptions

RECORDS = get_args(Record)
_OPENING: dict[str, Any] = {each.name: each.plain for each in options_of(SequenceOptions)}
KEYS: dict[str, dict[str, Any]] = {
    "bench": {
        "methods": list,
        "sequences": list,
        "variants": list,
        "grid": dict,
        "search": dict,
        "holdout": list,
        "seeds": list,
        "record": str,
        "workers": int,
        "timing": bool,
        "review": str,
        "opening": dict,
    },
    "opening": _OPENING,
    "sequences": {
        "path": str,
        "simulate": str,
        "name": str,
        "seed": int,
        **_OPENING,
        "frames": (str, int),
    },
    "variants": {
        "method": str,
        "name": str,
        "preset": str,
        "config": str,
        "set": dict,
        "online": bool,
        "seed": int,
    },
    "search": {"kind": str, "trials": int, "seed": int, "ranges": dict},
}
"""The keys of a bench file and of its tables, with the types of their values."""


def plan_of(table: Mapping[str, Any], place: str = "bench") -> BenchPlan:
    """Build the plan from a table, as returned by ``read``.

    Args:
        table: keys and values as in the file.
        place: origin of the table, for errors.

    Raises:
        UsageError: for an unknown key, a wrong type, or an unknown method, parameter, scene or
            sensor.
    """
    table = checked(table, "bench", place)
    search = _search(table["search"], f"{place} [search]") if table.get("search") else None
    opening = checked(table.get("opening", {}), "opening", f"{place} [opening]")
    sources = [
        _opened_with(_source(entry, f"{place} [[sequences]] {n}"), opening)
        for n, entry in _numbered(table, "sequences")
    ]
    seeds = _seeds(table.get("seeds", []), place)
    sources = [each for source in sources for each in source.seeded(seeds)]
    held = [_held(entry, sources) for entry in table.get("holdout", [])]
    sources += [source for source in held if source not in sources]
    record = table.get("record")
    workers = table.get("workers", 1)
    timing = table.get("timing", False)
    plan = BenchPlan(
        tuple(each for one in _sets(table, search, place) for each in one.seeded(seeds)),
        tuple(sources),
        frozenset(source.name for source in held),
        search,
        record or ("none" if timing else "errors"),
        workers,
        timing,
        seeds,
        os.path.abspath(table["review"]) if table.get("review") else "",
    )
    _check(plan, place)
    return plan


def read(path: Path) -> dict[str, Any]:
    """Read a bench file; its paths are relative to its folder.

    Raises:
        DataError: if it cannot be read or is not valid TOML.
        UsageError: for an unknown key.
    """
    table = checked(params.read_toml(path), "bench", os.fspath(path))
    base = path.parent

    def here(entry: Any, key: str) -> Any:
        if isinstance(entry, str):
            return absolute(entry, base)
        if isinstance(entry, dict) and isinstance(entry.get(key), str):
            return {**entry, key: absolute(entry[key], base)}
        return entry

    table["sequences"] = [here(entry, "path") for entry in table.get("sequences", [])]
    for entry in table["sequences"]:
        if (
            isinstance(entry, dict)
            and isinstance(entry.get("poses"), str)
            and (base / entry["poses"]).is_file()
        ):
            # otherwise a topic or frame of a bag
            entry["poses"] = os.path.abspath(base / entry["poses"])
    table["variants"] = [here(entry, "config") for entry in table.get("variants", [])]
    if table.get("review"):
        table["review"] = os.path.abspath(base / table["review"])
    return table


def checked(table: Mapping[str, Any], kind: str, place: str) -> dict[str, Any]:
    """A copy of the table, after checking its keys and the types of its values.

    Raises:
        UsageError: for an unknown key, with the nearest known one, or a wrong type.
    """
    for key, value in table.items():
        if key not in KEYS[kind]:
            raise UsageError(f"{place}: unknown key '{key}'. {suggest(key, KEYS[kind])}")
        types = KEYS[kind][key]
        if not isinstance(value, types) or (isinstance(value, bool) and types is not bool):
            names = " or ".join(
                kind.__name__ for kind in (types if isinstance(types, tuple) else (types,))
            )
            raise UsageError(f"{place}: {key} = {value!r}: give a value of type {names}")
    return dict(table)


def assignment(text: str, flag: str) -> tuple[str, str, str]:
    """Split ``METHOD.PARAM=VALUES``."""
    match = re.fullmatch(r"\s*([\w]+)\.(\w+)\s*=(.+)", text)
    if not match:
        values = "0.1,0.2" if flag == "--grid" else "0.05:0.4"
        raise UsageError(
            f"{flag} {text}: write METHOD.PARAM=VALUES, such as {flag} octomap.resolution={values}"
        )
    return match[1], match[2], match[3]


def values_of(text: str) -> list[Any]:
    """Comma-separated values as in TOML; if they are not valid TOML, all are strings."""
    try:
        parsed: list[Any] = tomllib.loads(f"values = [{text}]")["values"]
    except tomllib.TOMLDecodeError:
        return [part.strip() for part in text.split(",")]
    return parsed


def _numbered(table: Mapping[str, Any], key: str) -> Iterable[tuple[int, Any]]:
    return enumerate(table.get(key, []), 1)


def _source(entry: Any, place: str) -> SequenceSpec:
    """A sequence from a string ([NAME=]PATH, FORMAT:PATH or simulate:SCENE[:FRAMES[:SEED]]) or from
    a table.
    """
    if isinstance(entry, str):
        if (named := re.fullmatch(r"([\w.-]+)=(.+)", entry)) and not Path(entry).exists():
            return replace(_source(named[2], place), name=named[1])
        prefix, *rest = entry.split(":")
        if (
            prefix != "simulate" or "?" in entry
        ):  # with options: simulated when read, as by dynaviz run
            return _source({"path": absolute(entry, Path())}, place)
        try:
            scene, frames, seed = [*rest, None, None][:3]
            numbers = {
                key: int(text)
                for key, text in (("frames", frames), ("seed", seed))
                if text is not None
            }
        except ValueError:
            raise UsageError(
                f"{entry}: write simulate:SCENE[:FRAMES[:SEED]], such as simulate:demo:20"
            ) from None
        return _source({"simulate": scene, **numbers}, entry)
    if not isinstance(entry, dict):
        raise UsageError(
            f"{place}: invalid sequence {entry!r}. Give a path, or a table with path or simulate"
        )
    entry = checked(entry, "sequences", place)
    if ("path" in entry) == ("simulate" in entry):
        raise UsageError(f"{place}: give either path or simulate")
    source = _simulated(entry, place) if "simulate" in entry else _recorded(entry, place)
    if source.name != re.sub(r"[/\\:\s]", "", source.name) or source.name in (
        "",
        ".",
        "..",
        "sequences",
    ):
        raise UsageError(
            f"{place}: name = {source.name!r} is not a valid folder name. Give another name"
        )
    if source.options.sensor:
        from dynaviz.contracts.sensors import load_sensor

        load_sensor(source.options.sensor)
    return source


def _opened_with(source: SequenceSpec, opening: Mapping[str, Any]) -> SequenceSpec:
    """A sequence with options of all sequences in place of those that it does not set."""
    unset = {
        each.name
        for each in fields(SequenceOptions)
        if getattr(source.options, each.name) == each.default
    }
    options = {name: value for name, value in opening.items() if name in unset}
    return replace(source, options=replace(source.options, **options))


def _simulated(entry: Mapping[str, Any], place: str) -> SequenceSpec:
    from dynaviz.synthetic.simulate.presets import PRESETS

    scene = entry["simulate"]
    frames = entry.get("frames")
    seed = entry.get("seed", 0)
    if scene not in PRESETS:
        raise UsageError(f"{place}: unknown scene '{scene}'. {suggest(scene, PRESETS)}")
    if invalid := {"poses", "points_in", "deskew", "extrinsic"} & entry.keys():
        raise UsageError(
            f"{place}: {min(invalid)} applies to a sequence with a path, not to a simulated scene"
        )
    if isinstance(frames, str):
        raise UsageError(
            f"{place}: frames = {frames!r}: give the number of frames of a simulated scene"
        )
    name = entry.get("name") or scene + (f"-{frames}" if frames else "") + (
        f"-seed{seed}" if seed else ""
    )
    return SequenceSpec(name, "", _options(entry), scene, frames, seed)


def _recorded(entry: Mapping[str, Any], place: str) -> SequenceSpec:
    if "seed" in entry:
        raise UsageError(f"{place}: seed applies to a simulated scene only")
    path, _, query = entry["path"].partition("?")  # implant:SEQUENCE?cars=6&seed=3
    short = "-".join(filter(None, (Path(path.rpartition(":")[2]).name, query)))
    name = entry.get("name") or re.sub("[&=:]", "-", short)
    frames = f":{entry['frames']}" if isinstance(entry.get("frames"), int) else entry.get("frames")
    return SequenceSpec(name, entry["path"], replace(_options(entry), frames=frames))


def _options(entry: Mapping[str, Any]) -> SequenceOptions:
    """How to open a sequence, without its frames, which count sweeps for a simulated scene."""
    names = {each.name for each in fields(SequenceOptions)} - {"frames"}
    return SequenceOptions(**{name: value for name, value in entry.items() if name in names})


def _held(entry: Any, sources: list[SequenceSpec]) -> SequenceSpec:
    """A held-out sequence: one of the bench by its name or path, or an additional one."""
    if named := next((source for source in sources if source.name == entry), None):
        return named
    other = _source(entry, "holdout")
    if other in sources:
        return other
    if other.path and not is_sequence(
        other.path
    ):  # not opened: held-out data are not read before the end
        names = ", ".join(source.name for source in sources)
        raise UsageError(
            f"holdout: {entry} is neither a sequence nor the name of one in this bench: {names}"
        )
    return other


def _sets(
    table: Mapping[str, Any], search: SearchSpec | None, place: str
) -> Iterable[ParameterSet]:
    """The defaults of every method, then the variants, then the grids."""
    grids = table.get("grid", {})
    variants = [
        checked(entry, "variants", f"{place} [[variants]] {n}") if isinstance(entry, dict) else {}
        for n, entry in _numbered(table, "variants")
    ]
    named = [
        *grids,
        *(entry.get("method", "") for entry in variants),
        *(search.ranges if search else ()),
    ]
    methods = (
        table.get("methods") or list(dict.fromkeys(named)) or list(registry.loadable("methods"))
    )
    base = {method: ParameterSet.of(str(method)) for method in dict.fromkeys(methods)}
    yield from base.values()
    for n, entry in enumerate(variants, 1):
        with _located(f"{place} [[variants]] {n}"):
            yield _variant(entry)
    for method, axes in grids.items():
        with _located(f"{place} [grid.{method}]"):
            yield from _grid(ParameterSet.of(method), axes)


def _variant(entry: Mapping[str, Any]) -> ParameterSet:
    rest = {key: entry.get(key) for key in ("preset", "config", "online", "seed")}
    if "method" not in entry or not any(key in entry for key in ("set", *rest)):
        raise UsageError("give a method and at least one of preset, config, set, online and seed")
    values = entry.get("set", {})
    parts = [
        entry.get("preset"),
        variant(values) if values else "",
        "online" if entry.get("online") else "",
    ]
    name = entry.get("name") or "-".join(filter(None, parts))
    if not re.fullmatch(r"[\w.=,+\[\]-]+", name):
        raise UsageError("give the variant a name that consists of letters, digits and -_.=,+[]")
    return ParameterSet.of(entry["method"], name, values, **rest)


def _grid(base: ParameterSet, axes: Any) -> Iterable[ParameterSet]:
    if not isinstance(axes, dict) or not all(
        isinstance(values, list) and values for values in axes.values()
    ):
        raise UsageError("give each parameter a list of values")
    for values in itertools.product(*axes.values()):
        yield base.changed(dict(zip(axes, values, strict=True)))


@contextlib.contextmanager
def _located(place: str) -> Iterator[None]:
    """Add the table to the error of a wrong parameter."""
    try:
        yield
    except UsageError as error:
        raise UsageError(f"{place}: {str(error).removeprefix('settings: ')}") from None


def _seeds(given: list[Any], place: str) -> tuple[int, ...]:
    """The seeds of methods and simulated scenes."""
    for seed in given:
        if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < 2**32:
            raise UsageError(f"{place}: seeds = {given}: give whole numbers from 0 to 2^32 - 1")
    if len(set(given)) < len(given):
        raise UsageError(f"{place}: seeds = {given}: give each seed once")
    return tuple(given)


def _search(table: Mapping[str, Any], place: str) -> SearchSpec:
    table = checked(table, "search", place)
    kinds = ("random", "bayes")
    if table.get("kind") not in kinds:
        raise UsageError(
            f"{place}: kind = {table.get('kind')!r}. {suggest(str(table.get('kind')), kinds)}"
        )
    if table.get("trials", 0) < 1 or not table.get("ranges"):
        raise UsageError(
            f"{place}: give trials (at least 1) and ranges, such as --trials 30 --range "
            "octomap.resolution=0.05:0.4"
        )
    if not 0 <= table.get("seed", 0) < 2**32:
        raise UsageError(f"{place}: seed = {table['seed']}: give a seed from 0 to 2^32 - 1")
    if not all(isinstance(axes, dict) for axes in table["ranges"].values()):
        raise UsageError(f'{place}: give ranges as METHOD.PARAM = "LOW:HIGH"')
    ranges = {
        method: {name: str(text) for name, text in axes.items()}
        for method, axes in table["ranges"].items()
    }
    return SearchSpec(table["kind"], table["trials"], ranges, table.get("seed", 0))


def _check(plan: BenchPlan, place: str) -> None:
    learning = [source for source in plan.sources if source.name not in plan.holdout]
    if not learning:
        raise UsageError(
            f"{place}: give at least one sequence that is not held out, with -s SEQ or "
            "[[sequences]]"
        )
    if plan.record not in RECORDS:
        raise UsageError(f"{place}: record = {plan.record!r}. {suggest(plan.record, RECORDS)}")
    if plan.workers < 1:
        raise UsageError(f"{place}: workers = {plan.workers}: give at least 1")
    if plan.timing and (plan.workers > 1 or plan.record != "none"):
        raise UsageError(
            f"{place}: timing runs one cell at a time without a recording. Leave out workers and "
            "record"
        )
    if len(plan.seeds) > 1 and plan.search:
        raise UsageError(f"{place}: a search takes one seed. Leave out search, or give one seed")
    if plan.holdout and not plan.search:
        raise UsageError(f"{place}: holdout needs a search. Add --search bayes --trials N")
    for kind, names in (
        ("sequences", [source.name for source in plan.sources]),
        ("variants", ["-".join([known.method, known.variant]) for known in plan.sets]),
    ):
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise UsageError(f"{place}: two {kind} have the name '{twice.rstrip('-')}'. Rename one")
