"""Draw the pictures of the pages, and measure what the pages of methods tell.

    python docs/draw.py                # everything, some minutes
    python docs/draw.py dufomap        # the page of one method
    python docs/draw.py tutorial       # the tutorial and the pages on recordings

Simulates what it needs into a temporary folder; writes docs/pictures/*.jpg and docs/methods/measured.json.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image

import dynaviz as dv
from dynaviz import registry
from dynaviz.simulate import simulate
from dynaviz.viz.shot import shot

DOCS = Path(__file__).parent
MEASURED = DOCS / "methods/measured.json"
SCENE, FRAMES, FRAME = "street_hdl64", 40, 24
STATES = {  # which state a method's picture shows, and where frame 24 does not tell enough, another
    "removert": ("accused", 24),
    "erasor": ("status", 23),  # every fourth scan is compared
    "dynablox": ("clusters", 24),
    "octomap_g": ("ground_plane", 24),
    "octomap_gf": ("noise", 24),
    "dufomap": ("void", 24),
    "beautymap": ("removed", 24),
}
HALF = (760, 620)  # pixels of each half of a method's picture


BAR = 36  # pixels of the viewer's own bar, above the window
WINDOW = (1400, 800 + BAR)


def main(names: list[str]) -> None:
    """Draw what is named, or everything."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        known = json.loads(MEASURED.read_text()) if MEASURED.exists() else {"methods": {}}
        known |= {"scene": SCENE, "frames": FRAMES}
        built_in = [handle.name for handle in registry.handles("methods") if handle.package == "dynaviz_methods"]
        names = names or [*built_in, "tutorial"]
        if "tutorial" in names:
            of_tutorial(folder)
        if methods := [name for name in names if name != "tutorial"]:
            sequence = simulate(SCENE, folder / SCENE, frames=FRAMES)
            for name in methods:
                known["methods"][name] = of_method(name, sequence, folder)
        known["methods"] = dict(sorted(known["methods"].items()))
        MEASURED.write_text(json.dumps(known, indent=1) + "\n")


def of_method(name: str, sequence: Path, folder: Path) -> dict[str, Any]:
    """Run a method, draw its map and a state, and give the numbers for its page."""
    recording = folder / f"{name}.rrd"
    result = dv.run(name, sequence, record=recording)
    emits = registry.load("methods", name).info.emits
    state, frame = STATES.get(name, (emits[0].name, FRAME))
    left, right = (picture(recording, folder, frame, view, HALF) for view in ("map", state))
    both = Image.new("RGB", (left.width + right.width + 8, max(left.height, right.height)), "white")
    both.paste(left, (0, 0))
    both.paste(right, (left.width + 8, 0))
    save(both, name)
    counts, found = result.counts, result.sections["failures"]
    return {
        "metrics": {key: result.metrics[key] for key in ("SA", "DA", "AA")},
        "static": counts["static_kept"] + counts["static_removed"],
        "dynamic": counts["dynamic_removed"] + counts["dynamic_kept"],
        "causes": found["causes"],
        "cases": [{key: case[key] for key in ("kind", "cost", "sentence")} for case in found["cases"][:4]],
        "state": state,
        "frame": frame,
    }


def of_tutorial(folder: Path) -> None:
    """The pictures of the tutorial and of the pages on recordings: the demo."""
    street = simulate("demo", folder / "demo/street")
    runs = {name: folder / f"demo-{name}.rrd" for name in ("octomap", "dufomap")}
    for name, recording in runs.items():
        dv.run(name, street, record=recording)
    save(picture(runs["octomap"], folder, 41, None, WINDOW), "window")
    save(picture(runs["octomap"], folder, 41, "frame", (1100, 640)), "frame")
    save(picture(runs["octomap"], folder, 41, "failures", (520, 560)), "failures")
    save(picture(runs["octomap"], folder, 41, "wrong points per frame", (900, 400)), "wrong")
    save(picture(runs["octomap"], folder, 41, "kept: error distance [m]", (900, 400)), "distance")
    save(picture(runs["octomap"], folder, 41, "hit", (1100, 640)), "hit")
    dv.compare(runs["octomap"], runs["dufomap"], out=folder / "compare.rrd")
    save(picture(folder / "compare.rrd", folder, 35, None, WINDOW), "compared")


def picture(recording: Path, folder: Path, frame: int, view: str | None, size: tuple[int, int]) -> Image.Image:
    """A view of a recording, or the whole window."""
    image = Image.open(shot(recording, folder / "shot.png", (frame,), view, size)[0]).convert("RGB")
    return image if view else image.crop((0, BAR, *image.size))


def save(image: Image.Image, name: str) -> None:
    """Write a picture of the pages."""
    image.save(DOCS / f"pictures/{name}.jpg", quality=82, optimize=True)


if __name__ == "__main__":
    main(sys.argv[1:])
