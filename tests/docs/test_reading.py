"""docs/reading.md leads to files that exist, and states what other packages may import."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from dynaviz.contracts.probe import State
from dynaviz.contracts.registry import handles

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/reading.md").read_text(encoding="utf-8")
FILES = re.findall(r"^\| \d+ \| \[`([^`]+)`\]\(\.\./([^)]+)\) \|", PAGE, re.M)
PUBLIC = re.findall(r"^dynaviz[\w. ]+$", PAGE, re.M)


def test_the_afternoon_has_twelve_files_of_the_stated_length() -> None:
    assert len(FILES) == 12
    lines = 0
    for shown, linked in FILES:
        assert shown == linked
        lines += len((ROOT / linked).read_text(encoding="utf-8").splitlines())
    stated = int(re.findall(r"about ([\d,]+) lines", PAGE)[0].replace(",", ""))
    assert abs(lines - stated) < 0.1 * stated


def test_every_file_that_is_named_exists() -> None:
    """Also those of the journeys; NAME stands for a name of your own."""
    places = [ROOT, ROOT / "dynaviz", ROOT / "dynaviz/sources/datasets", ROOT / "docs"]
    for path in re.findall(r"`((?:[\w.]+/)*[\w.]+(?:\.py|\.toml|\.md)|(?:[\w.]+/)+)`", PAGE):
        assert "NAME" in path or any((place / path).exists() for place in places), path


def test_names_in_the_page_are_names_of_the_code() -> None:
    for name, file in {
        "sentence": "eval/dynaviz_eval/attribution.py",
        "check_method": "dynaviz/testing/__init__.py",
        "DATASETS": "tests/helpers/readable_files.py",
    }.items():
        assert f"`{name}`" in PAGE or f"{name}`" in PAGE
        assert re.search(rf"\b{name}\b", (ROOT / file).read_text(encoding="utf-8"))
    kinds = (ROOT / "dynaviz/contracts/probe.py").read_text(encoding="utf-8")
    assert all(f"class {kind}" in kinds for kind in ("Voxels", "PointClasses", "Mask"))
    assert State.__module__ == "dynaviz.contracts.probe"
    assert {handle.kind for kind in ("methods", "datasets") for handle in handles(kind)}


def packages() -> list[Path]:
    return sorted(path.parent for path in (ROOT / "dynaviz").glob("*/__init__.py"))


def is_public(module: str) -> bool:
    """Whether the page lists a module, or a package that contains it."""
    listed = " ".join(PUBLIC).split()
    return module == "dynaviz" or any(
        module == name or module.startswith(f"{name}.") for name in listed if name != "dynaviz"
    )


@pytest.mark.parametrize("package", packages(), ids=lambda path: path.name)
def test_a_package_is_listed_as_public_or_says_that_it_is_private(package: Path) -> None:
    listed = any(
        name.split(".")[1] == package.name for name in " ".join(PUBLIC).split() if "." in name
    )
    tree = ast.parse((package / "__init__.py").read_text(encoding="utf-8"))
    assert listed != ("Private: " in (ast.get_docstring(tree) or ""))


@pytest.mark.parametrize("folder", ["examples", "methods", "eval"])
def test_packages_beside_the_core_import_public_modules_only(folder: str) -> None:
    private = {
        (str(path.relative_to(ROOT)), module)
        for path in sorted((ROOT / folder).rglob("*.py"))
        if ".venv" not in path.parts
        for module in imported(path)
        if module.split(".")[0] == "dynaviz" and not is_public(module)
    }
    assert not private


def imported(path: Path) -> Iterator[str]:
    """The modules that a file imports by name."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module
