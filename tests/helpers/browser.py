"""What a page looks like in Chromium, without a driver.

The page is measured inside a frame of the wanted size.
"""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

CHROMIUM = (
    shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")

_MEASURE = """<!DOCTYPE html><body><pre id="found"></pre><script>
const frame = document.createElement("iframe");
frame.style = "width: WIDTHpx; height: 800px; border: 0";
frame.src = SOURCE;
frame.onload = () => {
  const page = frame.contentDocument, wide = page.documentElement.clientWidth, cut = [];
  const text = e => (e.textContent || "").trim().slice(0, 40);
  const name = e => e.tagName + " " + (e.getAttribute("class") || "") + " " + text(e);
  if (page.documentElement.scrollWidth > wide) cut.push("the page");
  for (const e of page.querySelectorAll("body *")) {
    const box = e.getBoundingClientRect(), inner = e.parentElement.closest(".wide");
    if (box.width && !inner && (box.right > wide + 1 || box.left < -1)) cut.push(name(e));
  }
  for (const e of page.querySelectorAll("svg text")) {
    const box = e.getBoundingClientRect(), svg = e.closest("svg").getBoundingClientRect();
    const outside = box.right > wide || box.left < svg.left - 4 || box.bottom > svg.bottom + 4;
    if (box.width && outside) cut.push(name(e));
  }
  const images = [...page.images].map(image => image.naturalWidth);
  document.getElementById("found").textContent = JSON.stringify({cut, images});
};
document.body.append(frame);
</script></body>"""


def measured(page: Path, width: int) -> dict[str, list]:
    """What is cut off in a frame of a width in pixels (``cut``), and the widths of the decoded
    ``images``.
    """
    wrapper = page.with_name(f"{page.stem}-{width}.frame.html")
    wrapper.write_text(
        _MEASURE.replace("WIDTH", str(width)).replace("SOURCE", json.dumps(page.name))
    )
    assert CHROMIUM
    done = subprocess.run(
        [
            CHROMIUM,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--allow-file-access-from-files",
            "--dump-dom",
            f"--user-data-dir={page.parent / 'profile'}",
            "--virtual-time-budget=4000",
            wrapper.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    found = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found, done.stderr
    measured: dict[str, list] = json.loads(html.unescape(found[1]))
    return measured
