"""Tiny runs to explore, and the page in a browser."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.browser import CHROMIUM
from helpers.worlds import room

import dynaviz as dv
from dynaviz.sources.datasets.convert import convert

pytest.importorskip("starlette", reason="the extra explore is not installed")
pytest.importorskip("rerun_notebook", reason="the extra explore is not installed")

RAYS, FRAMES = 700, 6
SOFTWARE = [
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--no-sandbox",
]


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folders of a fine and a coarse run on the little room, of one with scores alone, and of one
    without truth.
    """
    folder = tmp_path_factory.mktemp("explored")
    convert(room(FRAMES, RAYS), folder / "room")
    convert(room(FRAMES, RAYS, labelled=False), folder / "unknown")
    made = {
        "fine": ("room", "resolution=0.3", "errors"),
        "coarse": ("room", "resolution=0.9", "errors"),
        "scores": ("room", "resolution=0.3", "scores"),
        "unknown": ("unknown", "resolution=0.3", "errors"),
    }
    for name, (sequence, setting, record) in made.items():
        dv.run("octomap", folder / sequence, out=folder / name, record=record, settings=(setting,))
    return {name: folder / name for name in made}


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium, without a graphics card."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed")
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        yield chromium
        chromium.close()
