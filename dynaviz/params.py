"""Parameters of a method: defaults < preset < file < ``--set``; every value knows which layer set it."""

from __future__ import annotations

import dataclasses
import os
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints

from dynaviz.errors import DataError, UsageError
from dynaviz.registry import preset_files, suggest


@dataclass(frozen=True)
class Resolved:
    """Parameters, and where each value came from.

    Attributes:
        params: an instance of the method's ``Params``.
        source: by field: ``default``, ``preset NAME``, a file's path, or ``--set``.
        online, seed: the run's own settings where a layer holds them under ``[run]``.
    """

    params: Any
    source: Mapping[str, str]
    online: bool | None = None
    seed: int | None = None


def resolve(
    method: Any,
    preset: str | None = None,
    config: str | os.PathLike[str] | None = None,
    settings: Iterable[str] = (),
) -> Resolved:
    """Lay the layers over each other.

    Args:
        method: a method's class.
        preset: name of a preset; its files hold one table per method, and need not know this one.
        config: a TOML file with the parameters in a table of the method's name, or at the top.
        settings: ``KEY=VALUE``, or ``METHOD.KEY=VALUE``, values as in TOML.

    Raises:
        UsageError: for an unknown preset, parameter or value, telling which layer holds it.
        DataError: for a file that cannot be read.
    """
    name = method.info.name
    values: dict[str, Any] = {}
    source = {field.name: "default" for field in dataclasses.fields(method.Params)}
    layers = [(f"preset {preset}", _preset(preset, name))] if preset else []
    run: Mapping[str, Any] = {}
    if config:
        table, run = _config(Path(config), name)
        layers.append((os.fspath(config), table))
    layers.append(("--set", dict(_setting(text, name) for text in settings)))
    kinds = get_type_hints(method.Params)
    for layer, table in layers:
        for key, value in table.items():
            if key not in source:
                raise UsageError(f"{layer}: {name} has no parameter '{key}'. {suggest(key, source)}")
            values[key] = _coerce(value, kinds[key], f"{layer}: {name}.{key}")
            source[key] = layer
    try:
        params = method.Params(**values)
    except ValueError as error:
        raise UsageError(f"{name}: {error}") from None
    return Resolved(params, source, run.get("online"), run.get("seed"))


def to_toml(name: str, params: Any, run: Mapping[str, Any]) -> bytes:
    """``config.toml``: feeding it back with ``--config`` gives the same labels."""
    import tomli_w

    return tomli_w.dumps({"run": dict(run), name: dataclasses.asdict(params)}).encode()


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        DataError: where it cannot be read or is not TOML; the message has the line.
    """
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except OSError as error:
        raise DataError(path, error.strerror or "cannot be read", hint="Give a TOML file") from None
    except (ValueError, RecursionError) as error:  # bad TOML, bad UTF-8, numbers without end
        raise DataError(path, f"is not TOML: {error}", hint="See 'dynaviz config METHOD' for the names") from None


def _preset(preset: str, name: str) -> dict[str, Any]:
    known = preset_files()
    if preset not in known:
        raise UsageError(f"no preset '{preset}'. {suggest(preset, known)}")
    return {key: value for path in known[preset] for key, value in read_toml(path).get(name, {}).items()}


def _config(path: Path, name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    content = read_toml(path)
    run = content.pop("run", {})
    table = content.get(name, {key: value for key, value in content.items() if not isinstance(value, dict)})
    for title, found in (("run", run), (name, table)):
        if not isinstance(found, dict):
            raise DataError(path, f"has {title} = {found!r}", hint=f"Give a table: [{title}]")
    for key, kind in (("online", bool), ("seed", int)):
        if key in run and (type(run[key]) is not kind or run[key] < 0):
            raise DataError(path, f"has {key} = {run[key]!r} in [run]", hint="Give online = true, or seed = 0 or more")
    return table, run


def _setting(text: str, name: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals:
        raise UsageError(f"--set {text}: write KEY=VALUE, for example --set resolution=0.2")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value
    return key.strip().removeprefix(f"{name}."), parsed


def _coerce(value: Any, kind: Any, place: str) -> Any:
    """Accept what a field's type can hold: an int where a float is meant, a list where a tuple is."""
    if kind is float and isinstance(value, int) and not isinstance(value, bool) and abs(value) < 1 << 1000:
        return float(value)
    origin = getattr(kind, "__origin__", kind)
    if origin is tuple and isinstance(value, list):
        return tuple(value)
    if isinstance(value, origin) and not (origin is int and isinstance(value, bool)):
        return value
    raise UsageError(f"{place} = {value!r}: give a value of type {getattr(kind, '__name__', kind)}")
