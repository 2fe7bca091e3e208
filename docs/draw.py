"""Draw the pictures of the pages, and measure the numbers on the methods' pages.

    python docs/draw.py                      # everything, some minutes
    python docs/draw.py dufomap              # the page of one method
    python docs/draw.py demo                 # the README, the tutorial and the pages on recordings;
                                             # needs Chromium
    python docs/draw.py --numbers [METHOD]   # the numbers without the pictures

Simulates its scenes into a temporary folder. Writes the pictures in docs/ and docs/pictures/, and
docs/methods/measured.json. docs/pictures/drawn.json keeps what the pictures of the demo are drawn
from: a test fails when that has changed since. Then updates the pages as ``docs/generate.py`` does.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import before_after
import cv2
import draw_explorer
import drawn_from
import generate
import numpy as np

import dynaviz as dv
from dynaviz.arrays import U8
from dynaviz.contracts import registry
from dynaviz.synthetic.simulate import simulate
from dynaviz.views.layout import WRONG
from dynaviz.views.read.shot import shot

DOCS = Path(__file__).resolve().parent
MEASURED = DOCS / "methods/measured.json"
SCENE = "street_hdl64"
FRAMES = 40
FRAME = 24
STATES = {  # the state in a method's picture, and its frame: 24 unless another shows more
    "removert": ("accused", 24),
    "erasor": ("status", 23),  # every fourth scan is compared
    "dynablox": ("clusters", 24),
    "octomap_g": ("ground_plane", 24),
    "octomap_gf": ("noise", 24),
    "dufomap": ("void", 24),
    "hmm_mos": ("window_score", 24),
    "freedom": ("levels", 24),
    "beautymap": ("removed", 24),
}
HALF = (760, 620)  # pixels of each half of a method's picture
CASE = (760, 480)  # pixels of the picture of a case
GAP = 8  # white pixels between the halves
TILE = (480, 330)  # pixels of a method in the overview of all states
TILES = 3  # in a row

WINDOW = (1400, 800)
WIDE = (1600, 864)  # shows the full titles of a comparison
LIST = 612  # pixels of the list of failures; the viewer's time panel covers the rows below
JPEG = [
    *(cv2.IMWRITE_JPEG_QUALITY, 74),
    *(cv2.IMWRITE_JPEG_OPTIMIZE, 1),
    *(cv2.IMWRITE_JPEG_PROGRESSIVE, 1),  # smaller by 6 %
]


def main(arguments: list[str]) -> None:
    """Draw and measure the named pages, or all of them."""
    names = [word for word in arguments if word != "--numbers"]
    drawn = "--numbers" not in arguments
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        known = json.loads(MEASURED.read_text()) if MEASURED.exists() else {"methods": {}}
        known |= {"scene": SCENE, "frames": FRAMES}
        names = names or [*generate.methods(), "demo"]
        if "demo" in names and drawn:
            of_demo(folder)
        if methods := [name for name in names if name != "demo"]:
            sequence = simulate(SCENE, folder / SCENE, frames=FRAMES)
            for name in methods:
                known["methods"][name] = of_method(name, sequence, folder, drawn)
            if drawn:
                overview(known["methods"])
        known["methods"] = dict(sorted(known["methods"].items()))
        MEASURED.write_text(json.dumps(known, indent=1) + "\n")
    generate.main([])


def of_method(name: str, sequence: Path, folder: Path, drawn: bool) -> dict[str, Any]:
    """Run a method and return the numbers for its page; draw its map and a state if asked to."""
    recording = folder / f"{name}.rrd"
    result = dv.run(name, sequence, record=recording)
    emits = registry.load("methods", name).info.emits
    state, frame = STATES.get(name, (emits[0].name, FRAME))
    if drawn:
        left, right = (picture(recording, folder, frame, view, HALF) for view in ("map", state))
        both = np.full(
            (max(len(left), len(right)), left.shape[1] + GAP + right.shape[1], 3), 255, np.uint8
        )
        both[: len(left), : left.shape[1]] = left
        both[: len(right), -right.shape[1] :] = right
        save(both, f"pictures/{name}.jpg")
    counts = result.counts
    found = result.sections.plain()["failures"]
    return {
        "metrics": {key: result.metrics[key] for key in ("SA", "DA", "AA")},
        "static": counts["static_kept"] + counts["static_removed"],
        "dynamic": counts["dynamic_removed"] + counts["dynamic_kept"],
        "causes": found["causes"],
        "state": state,
        "frame": frame,
    }


def of_demo(folder: Path) -> None:
    """Draw the demo, for the README, the tutorial and the pages on recordings."""
    street = simulate("demo", folder / "demo/street")
    runs = {
        name: folder / f"demo-{name}.rrd" for name in ("octomap", "dufomap", "beautymap", "erasor")
    }
    for name, recording in runs.items():
        dv.run(name, street, record=recording)
    octomap = runs["octomap"]
    save(picture(octomap, folder, 41, None, WINDOW, case=2), "pictures/window.jpg")
    for name, recording in runs.items():
        save(picture(recording, folder, 41, "case", CASE, case=1), f"pictures/case_{name}.jpg")
    save(picture(octomap, folder, 41, "frame", (1100, 640)), "pictures/frame.jpg")
    save(picture(octomap, folder, 41, "failures", (520, 740))[:LIST], "pictures/failures.jpg")
    save(picture(octomap, folder, 41, WRONG, (900, 400)), "pictures/wrong.jpg")
    save(picture(octomap, folder, 41, "FN: distance [m]", (900, 400)), "pictures/distance.jpg")
    save(picture(octomap, folder, 41, "hit", (1100, 640)), "pictures/hit.jpg")
    draw_explorer.draw(octomap)
    before_after.main()
    drawn_from.keep()
    two = folder / "compare.rrd"
    dv.compare(octomap, runs["dufomap"], out=two)
    save(picture(two, folder, 35, None, WIDE, case=1), "pictures/compared.jpg")


def overview(measured: dict[str, Any]) -> None:
    """Collect the states from the pictures of all methods in docs/states.jpg, for
    docs/methods/index.md.
    """
    tiles = []
    for name in generate.methods():
        both = np.asarray(cv2.imread(str(DOCS / f"pictures/{name}.jpg")), np.uint8)
        right = both[:, (both.shape[1] + GAP) // 2 :]
        tile = np.asarray(cv2.resize(right, TILE, interpolation=cv2.INTER_AREA), np.uint8)
        label = f"{name}: {measured[name]['state']}"
        cv2.putText(
            tile, label, (12, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.65, (255, 255, 255), 1, cv2.LINE_AA
        )
        tiles.append(tile)
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % TILES)
    save(
        np.vstack(
            [np.hstack(tiles[start : start + TILES]) for start in range(0, len(tiles), TILES)]
        ),
        "states.jpg",
    )


def picture(
    recording: Path,
    folder: Path,
    frame: int,
    view: str | None,
    size: tuple[int, int],
    case: int | None = None,
) -> U8:
    """One view of a recording, or the whole window if ``view`` is None.

    (rows, columns, 3) uint8, BGR.

    Shows a case instead of the frame if its number is given.
    """
    path = shot(recording, folder / "shot.png", (frame,) if case is None else (), view, size, case)[
        0
    ]
    return np.asarray(cv2.imread(str(path)), np.uint8)


def save(image: U8, name: str) -> None:
    """Write a picture (BGR) to a JPEG file in docs."""
    cv2.imwrite(str(DOCS / name), image, JPEG)


if __name__ == "__main__":
    main(sys.argv[1:])
