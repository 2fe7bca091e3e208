"""The generated parts of the pages are up to date with the code."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def generate() -> ModuleType:
    """docs/generate.py as a module."""
    pytest.importorskip("griffe", reason="needs the tools for pages: pip install -e '.[docs]'")
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs/generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["generate"] = module
    sys.path.insert(0, str(ROOT / "docs"))  # where it finds the module of the tables
    spec.loader.exec_module(module)
    return module


def test_generated_parts_are_up_to_date(generate: ModuleType) -> None:
    changed = [str(path.relative_to(ROOT)) for path in generate.stale()]
    assert not changed, f"out of date: {', '.join(changed)}. Run: {generate.COMMAND}"


def test_each_method_has_every_section_in_the_repository(generate: ModuleType) -> None:
    for name, kind in generate.methods().items():
        text = generate.page(name).read_text(encoding="utf-8")
        assert [
            each
            for each in generate.SECTIONS
            if not re.search(rf"<!-- generated: {each}(:\w+)? -->", text)
        ] == []
        names = [*kind.Params.__dataclass_fields__, *(reason.name for reason in kind.info.reasons)]
        assert [name for name in names if f"`{name}`" not in text] == []


def test_a_method_without_a_page_gets_a_whole_one(generate: ModuleType) -> None:
    kind = generate.methods()["dufomap"]
    text = generate.new_page(kind)
    assert text.startswith(f"# {kind.info.title}\n")
    assert "| `hit_margin` | `0.2` |" in text
    assert "`beside_unknown`" in text
    assert generate.filled(text, generate.page("dufomap")) == text


def test_text_outside_the_markers_is_kept(generate: ModuleType) -> None:
    page = "Before\n\n<!-- generated: protocols -->\nold\n<!-- end -->\nAfter\n"
    text = generate.filled(page, ROOT / "docs/page.md")
    assert text.startswith("Before\n\n<!-- generated: protocols -->\n\n| protocol |")
    assert text.endswith(" |\n\n<!-- end -->\nAfter\n")
    assert "`semantickitti_mos`" in text
    assert "old\n" not in text


def test_an_unknown_part_is_an_error(generate: ModuleType) -> None:
    with pytest.raises(ValueError, match=r"docs/page.md: cannot generate 'parameter'"):
        generate.filled("<!-- generated: parameter -->\n<!-- end -->\n", ROOT / "docs/page.md")
