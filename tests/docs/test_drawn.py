"""The pictures of the pages show the present program."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_pictures_are_drawn_from_the_present_colours_layouts_and_page(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(DOCS))
    sys.modules.pop("drawn_from", None)
    import drawn_from

    found, kept = drawn_from.digests(), json.loads(drawn_from.KEPT.read_text())
    assert found == kept, "draw the pictures again with: python docs/draw.py demo"
