"""Draw the picture of the explorer.

    dynaviz demo
    python docs/draw_explorer.py [FOLDER]    # the folder of the demo's runs

Writes docs/explorer.webp. Needs Chromium; without a graphics card it takes minutes.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from playwright.sync_api import sync_playwright

import dynaviz as dv

DOCS = Path(__file__).resolve().parent
SOFTWARE = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--no-sandbox"]
SIZE = {"width": 1440, "height": 810}  # pixels
MOST = 300_000  # ms; drawing in software
QUALITY = 80  # of WebP
DARK, DRAWN = 60, 0.03  # grey level of the background at most, and share of brighter pixels where points are drawn
PICTURES = {  # runs, where to go, and whether to show the ledger
    "explorer.webp": (("octomap",), "?case=4", True),  # a truck that the drive leaves too early
}


def main(arguments: list[str]) -> None:
    """Draw all pictures."""
    folder = Path(arguments[0] if arguments else "recordings/demo")
    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=shutil.which("chromium"), args=SOFTWARE)
        for name, (runs, place, ledger) in PICTURES.items():
            with dv.explore(*(folder / run for run in runs)) as explorer:
                png = picture(chromium, explorer.url + place, ledger)
            pixels = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
            assert pixels is not None
            cv2.imwrite(str(DOCS / name), pixels, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
            print(f"{name}: {(DOCS / name).stat().st_size / 1000:.0f} kB")


def picture(chromium: Any, url: str, ledger: bool) -> bytes:
    """A PNG of the page."""
    page = chromium.new_page(viewport=SIZE, color_scheme="dark")
    page.set_default_timeout(MOST)
    page.goto(url)
    page.wait_for_selector("body[data-ready=viewer]")
    wait(page)
    if ledger:
        page.click("#point .start")
        page.wait_for_selector("#point .ledger table")
        page.evaluate("document.querySelector('#why').scrollTo(0, 1e6)")
    page.wait_for_timeout(3000)  # for the rays
    png: bytes = page.screenshot()
    page.close()
    return png


def wait(page: Any) -> None:
    """Wait until the viewers show points instead of their layout for loading, and no longer change."""
    before = b""
    for _ in range(MOST // 1000):
        now = page.locator("#viewers").screenshot()
        pixels = cv2.imdecode(np.frombuffer(now, np.uint8), cv2.IMREAD_GRAYSCALE)
        if now == before and pixels is not None and (pixels > DARK).mean() > DRAWN:
            return
        before = now
        page.wait_for_timeout(1000)


if __name__ == "__main__":
    main(sys.argv[1:])
