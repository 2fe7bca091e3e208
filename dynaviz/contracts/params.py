"""Parameters of a method, in layers: defaults < preset < file < ``--set``.

Each value keeps the layer that set it.
"""

from __future__ import annotations

import dataclasses
import inspect
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints

from dynaviz.contracts.registry import preset_files, suggest
from dynaviz.errors import DataError, UsageError


@dataclass(frozen=True)
class Resolved:
    """Parameters, and the layer that set each value.

    Attributes:
        params: an instance of the method's ``Params``.
        source: by parameter: ``default``, ``preset NAME``, a file's path, or ``--set``.
        online, seed: settings of the run from ``[run]`` in the file, or None.
    """

    params: Any
    source: Mapping[str, str]
    online: bool | None = None
    seed: int | None = None


def resolve(
    method: Any,
    preset: str | None = None,
    config: str | os.PathLike[str] | None = None,
    settings: Iterable[str] | Mapping[str, Any] = (),
) -> Resolved:
    """Combine the layers of parameters.

    Args:
        method: the class of a method.
        preset: name of a preset. Its files have one table per method; this method need not be among
            them.
        config: a TOML file with the parameters in a table named after the method, or at the top
            level.
        settings: ``KEY=VALUE`` or ``METHOD.KEY=VALUE``, with values as in TOML; or a dictionary of
            values.

    Raises:
        UsageError: for an unknown preset or parameter, or an invalid value; the message names the
            layer.
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
    if isinstance(settings, Mapping):
        layers.append(
            ("settings", {key.removeprefix(f"{name}."): value for key, value in settings.items()})
        )
    elif isinstance(settings, str):
        raise UsageError(f"settings = {settings!r}: give a list of KEY=VALUE, or a dictionary")
    else:
        layers.append(("--set", dict(_setting(text, name) for text in settings)))
    kinds = get_type_hints(method.Params)
    for layer, table in layers:
        for key, value in table.items():
            if key not in source:
                raise UsageError(
                    f"{layer}: {name} has no parameter '{key}'. {suggest(key, source)}"
                )
            values[key] = _coerce(value, kinds[key], f"{layer}: {name}.{key}")
            source[key] = layer
    try:
        params = method.Params(**values)
    except ValueError as error:
        raise UsageError(f"{name}: {error}") from None
    return Resolved(params, source, run.get("online"), run.get("seed"))


def require(params: Any, names: str, fits: Callable[[Any], Any], what: str) -> None:
    """Check parameters, in ``__post_init__``: ``require(self, "near far", lambda x.

    X > 0, "metres above 0")``.

    Args:
        params: the parameters of a method.
        names: those that are checked, separated by spaces.
        fits: whether a value is valid.
        what: the valid values in words, such as ``metres above 0``; also shown where parameters are
            described.

    Raises:
        ValueError: for the first one whose value is not valid.
    """
    for name in names.split():
        if not fits(value := getattr(params, name)):
            raise ValueError(f"{name} = {value}: give {what}")


@dataclass(frozen=True)
class Described:
    """A parameter in words: its meaning with the unit, and the values that it may have.

    Empty where unknown.
    """

    meaning: str
    range: str


def describe(kind: type[Any]) -> dict[str, Described]:
    """What the parameters of a method mean, from the docstring of its ``Params`` and the values
    that it rejects.
    """
    meanings = _attributes(kind.__doc__ or "")
    ranges = _ranges(kind)
    names = [field.name for field in dataclasses.fields(kind)]
    return {name: Described(meanings.get(name, ""), ranges.get(name, "")) for name in names}


def _attributes(docstring: str) -> dict[str, str]:
    """The entries of the section ``Attributes``; several names may share one."""
    _, _, section = inspect.cleandoc(docstring).partition("Attributes:\n")
    entries: dict[str, str] = {}
    names: list[str] = []
    for line in section.partition("\n\n")[0].splitlines():
        if match := re.match(r"    ([\w, ]+): (.*)", line):
            names = [name.strip() for name in match[1].split(",")]
            entries |= dict.fromkeys(names, match[2])
        elif names:
            entries |= {name: f"{entries[name]} {line.strip()}" for name in names}
    return entries


def _ranges(kind: type[Any]) -> dict[str, str]:
    """By parameter, the values that its error names, such as ``a share from 0 to less than 1``."""
    found: dict[str, str] = {}
    for name, type_ in get_type_hints(kind).items():
        for value in (-(10**9), float("nan"), 10**9) if type_ in (int, float) else ():
            try:
                kind(**{name: value if type_ is float or isinstance(value, int) else 0})
            except ValueError as error:
                asked = re.match(rf"{name} = [^:]*: give (?:a |an )?(.+)", str(error))
                if asked:
                    found.setdefault(name, asked[1])
            except Exception:  # a method that does not check its parameters
                break
    return found


def to_toml(name: str, params: Any, run: Mapping[str, Any]) -> bytes:
    """The content of ``config.toml``. Running with it (``--config``) gives the same labels."""
    import tomli_w

    return tomli_w.dumps({"run": dict(run), name: dataclasses.asdict(params)}).encode()


def read_toml(
    path: Path, hint: str = "For the parameter names run 'dynaviz list METHOD'"
) -> dict[str, Any]:
    """Read a TOML file; ``hint`` says what to give instead.

    Raises:
        DataError: if it cannot be read or is not valid TOML; the message has the line.
    """
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except OSError as error:
        raise DataError(path, error.strerror or "cannot be read", hint=hint) from None
    except (
        ValueError,
        RecursionError,
    ) as error:  # also invalid UTF-8, too long integers, too deep nesting
        raise DataError(path, f"not valid TOML: {error}", hint=hint) from None


def preset_description(files: Iterable[Path]) -> str:
    """What a preset is for: ``description`` in the table ``[preset]`` of its files, or empty.

    Raises:
        DataError: for a file that cannot be read or is not valid TOML.
    """
    tables = (read_toml(path).get("preset") for path in files)
    texts = (table.get("description") for table in tables if isinstance(table, dict))
    return next((text for text in texts if isinstance(text, str)), "")


def _preset(preset: str, name: str) -> dict[str, Any]:
    known = preset_files()
    if preset not in known:
        raise UsageError(f"unknown preset '{preset}'. {suggest(preset, known)}")
    return {
        key: value for path in known[preset] for key, value in read_toml(path).get(name, {}).items()
    }


def _config(path: Path, name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    content = read_toml(path)
    run = content.pop("run", {})
    table = content.get(
        name, {key: value for key, value in content.items() if not isinstance(value, dict)}
    )
    for title, value in (("run", run), (name, table)):
        if not isinstance(value, dict):
            raise DataError(
                path, f"{title} = {value!r} is not a table", hint=f"Write a table: [{title}]"
            )
    for key, kind in (("online", bool), ("seed", int)):
        if key in run and (type(run[key]) is not kind or run[key] < 0):
            raise DataError(
                path,
                f"invalid {key} = {run[key]!r} in [run]",
                hint="Write online = true or false, and seed = 0 or more",
            )
    return table, run


def _setting(text: str, name: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals:
        raise UsageError(f"--set {text}: write KEY=VALUE, such as --set resolution=0.2")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value
    return key.strip().removeprefix(f"{name}."), parsed


def _coerce(value: Any, kind: Any, place: str) -> Any:
    """Convert a TOML value to the type of a parameter: int to float, list to tuple."""
    if (
        kind is float
        and isinstance(value, int)
        and not isinstance(value, bool)
        and abs(value) < 1 << 1000
    ):
        return float(value)
    origin = getattr(kind, "__origin__", kind)
    if origin is tuple and isinstance(value, list):
        return tuple(value)
    if isinstance(value, origin) and not (origin is int and isinstance(value, bool)):
        return value
    raise UsageError(f"{place} = {value!r}: give a value of type {getattr(kind, '__name__', kind)}")
