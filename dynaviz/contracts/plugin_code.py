"""Which code a plug-in runs: its package and version, and a digest of its source files."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import re
import threading
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from msgspec import Struct

from dynaviz.contracts import registry

SHARED = ("dynaviz.kernels", "dynaviz.blocks", "dynaviz.spatial")
"""Packages of dynaviz whose code may decide labels."""
# threads that parse at once share a counter in Python 3.11, which then raises SystemError
_parsing = threading.Lock()


class Plugin(Struct, frozen=True):
    """The code of a plug-in.

    Attributes:
        target: ``module:Class``.
        package, version: the distribution that provides it.
        sha256: digest of its module and of the modules that this imports from its own package, from
            ``kernels``, ``blocks`` and ``spatial``; empty if they have no source files.
    """

    target: str = ""
    package: str = ""
    version: str = ""
    sha256: str = ""


@cache
def plugin(kind: str, name: str) -> Plugin | None:
    """The code of a plug-in; None if none of this kind has the name."""
    handle = next((handle for handle in registry.handles(kind) if handle.name == name), None)
    if handle is None:
        return None
    digest = hashlib.sha256()
    for module, file in sorted(_closure(handle.target.partition(":")[0]).items()):
        digest.update(module.encode() + b"\0" + file.read_bytes())
    return Plugin(handle.target, handle.distribution, handle.version, digest.hexdigest())


def _closure(module: str) -> dict[str, Path]:
    """The source files of a module and of the modules that it imports, by name."""
    found: dict[str, Path] = {}
    own = module.partition(".")[0]
    left = [module]
    while left:
        name = left.pop()
        if name in found or not (
            name == own or name.startswith((f"{own}.", *(f"{each}." for each in SHARED)))
        ):
            continue
        if (file := _file(name)) is not None:
            found[name] = file
            left += _imports(name, file)
    return found


def _file(module: str) -> Path | None:
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, ValueError):
        return None
    return Path(spec.origin) if spec and spec.origin and spec.origin.endswith(".py") else None


def _imports(module: str, file: Path) -> Iterator[str]:
    """Names of modules that a file may import; of ``from a import b``, both a and a.b."""
    text = file.read_text(encoding="utf-8")
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    with _parsing:
        tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = (
                ".".join(package.split(".")[: len(package.split(".")) - node.level + 1])
                if node.level
                else ""
            )
            parent = ".".join(filter(None, [base, node.module]))
            yield from (parent, *(f"{parent}.{alias.name}" for alias in node.names))
    yield from (f"dynaviz.kernels.{name}" for name in re.findall(r"\bkernels\.(\w+)", text))
