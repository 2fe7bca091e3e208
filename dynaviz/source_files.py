"""The source files that a module consists of: its own, and those of the modules that it imports."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path

IMPORT = re.compile(
    r"^[ \t]*((?:from[ \t]+[.\w]+[ \t]+)?import[ \t]+(?:\([^)]*\)|(?:[^\n\\]|\\\n)*))", re.MULTILINE
)
"""Import statements; parsing whole files would take ten times as long."""
# threads that parse at once share a counter in Python 3.11, which then raises SystemError
_parsing = threading.Lock()


def closure(module: str, follows: Callable[[str], bool]) -> dict[str, Path]:
    """The source files of a module and of the modules that it imports, by name.

    Args:
        module: its importable name.
        follows: whether a module counts, by its name; the imports of others are not followed.
    """
    found: dict[str, Path] = {}
    left = [module]
    while left:
        name = left.pop()
        if name in found or not follows(name):
            continue
        if (file := file_of(name)) is not None:
            found[name] = file
            left += _imports(name, file)
    return found


def digest(files: Mapping[str, Path]) -> str:
    """The SHA-256 of the names of modules and the contents of their files."""
    value = hashlib.sha256()
    for module, file in sorted(files.items()):
        value.update(module.encode() + b"\0" + file.read_bytes())
    return value.hexdigest()


def is_within(name: str, *packages: str) -> bool:
    """Whether a module is one of the packages, or in one."""
    return any(name == package or name.startswith(f"{package}.") for package in packages)


def folders(package: str) -> list[Path]:
    """The folders of a package; none for a module that is one file, and if it does not exist.

    Nothing is imported.
    """
    top, *rest = package.split(".")
    return [path for folder in _top(top)[1] if (path := folder.joinpath(*rest)).is_dir()]


def file_of(module: str) -> Path | None:
    """The source file of a module; None if it has none, or does not exist.

    Nothing is imported.
    """
    top, *rest = module.split(".")
    if not rest:
        return _top(top)[0]
    for folder in _top(top)[1]:
        path = folder.joinpath(*rest)
        for file in (path / "__init__.py", path.with_name(f"{path.name}.py")):
            if file.is_file():
                return file
    return None


@cache
def _top(name: str) -> tuple[Path | None, tuple[Path, ...]]:
    """The source file and the folders of a top-level module."""
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        spec = None
    if spec is None:
        return None, ()
    file = Path(spec.origin) if spec.origin and spec.origin.endswith(".py") else None
    return file, tuple(Path(folder) for folder in spec.submodule_search_locations or ())


@cache
def _imports(module: str, file: Path) -> tuple[str, ...]:
    """Names of modules that a file may import; of ``from a import b``, both a and a.b."""
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    text = file.read_text(encoding="utf-8")
    found = [name for match in IMPORT.finditer(text) for name in _imported(match[1], package)]
    found += (f"dynaviz.kernels.{name}" for name in re.findall(r"\bkernels\.(\w+)", text))
    for name in re.findall(r"\bkernels\.load\(\s*[\"']([\w.]+)", text):
        found += (f"{name}.{each.stem}" for folder in folders(name) for each in folder.glob("*.py"))
    return tuple(found)


def _imported(statement: str, package: str) -> Iterator[str]:
    """Names of an import statement in a package; none if it is text that looks like one."""
    try:
        with _parsing:
            (node,) = ast.parse(statement).body
    except (SyntaxError, ValueError):
        return
    match node:
        case ast.Import(names=names):
            yield from (alias.name for alias in names)
        case ast.ImportFrom(level=level, names=names):
            steps = package.split(".")
            base = ".".join(steps[: len(steps) - level + 1]) if level else ""
            parent = ".".join(filter(None, [base, node.module]))
            yield from (parent, *(f"{parent}.{alias.name}" for alias in names))
