"""Draw the picture of the explorer, docs/explorer.webp.

In Chromium, minutes without a graphics card.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import dynaviz as dv

DOCS = Path(__file__).resolve().parent
SOFTWARE = [
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--no-sandbox",
]
SIZE = {"width": 1440, "height": 810}  # pixels
MOST = 300_000  # ms; drawing in software
QUALITY = 80  # of WebP
CASE = 3  # a truck that the drive leaves too early


def draw(run: Path) -> None:
    """Draw a run of OctoMap on the demo."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver, dv.explore(run) as explorer:
        chromium = driver.chromium.launch(executable_path=shutil.which("chromium"), args=SOFTWARE)
        png = picture(chromium, f"{explorer.url}?case={CASE}")
    pixels = np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR), np.uint8)
    cv2.imwrite(str(DOCS / "explorer.webp"), pixels, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])


def picture(chromium: Any, url: str) -> bytes:
    """A PNG of the page, when the viewer shows the case and no longer changes."""
    page = chromium.new_page(viewport=SIZE, color_scheme="dark")
    page.set_default_timeout(MOST)
    page.goto(url)
    page.wait_for_selector("body[data-ready=viewer]")
    page.wait_for_selector("#point .strip")
    before = b""
    now = b"-"
    while before != now:
        page.wait_for_timeout(2000)
        before = now
        now = page.screenshot()
    page.close()
    return bytes(now)
