"""Draw ``docs/before_after.webp``: a street as it was scanned, and as ``dynaviz clean`` leaves it.

python docs/before_after.py
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

import dynaviz as dv
from dynaviz.arrays import F64, Bool

SEQUENCE = "simulate:street_hdl64_real?frames=30"
# pixels of a half, twice the size that is shown
WIDTH = 1600
HEIGHT = 620
DOWN = np.radians(38.0)  # the view
# metres about the middle of the way, and heights
AROUND = 34.0
LEAST = -2.5
MOST = 7.0


def picture(xyz: F64, removed: Bool) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) uint8 BGR: an oblique view, shaded by height; removed points are red."""
    side = xyz[:, 1]
    along = xyz[:, 0]
    up = xyz[:, 2]
    scale = WIDTH / (2 * AROUND)
    column = np.round(WIDTH / 2 + scale * along).astype(int)
    row = np.round(HEIGHT * 0.55 - scale * (side * np.sin(DOWN) + up * np.cos(DOWN))).astype(int)
    near = np.argsort(side * np.cos(DOWN) - up * np.sin(DOWN))[::-1]  # far points first
    inside = near[((column >= 0) & (column < WIDTH - 1) & (row >= 0) & (row < HEIGHT - 1))[near]]
    level = np.clip((up - LEAST) / (MOST - LEAST), 0, 1)
    shades = cv2.applyColorMap((60 + 150 * level).astype(np.uint8)[:, None], cv2.COLORMAP_BONE)[
        :, 0
    ]
    colours = np.where(removed[:, None], np.array([40, 40, 235], np.uint8), shades)
    drawn = np.full((HEIGHT, WIDTH, 3), 20, np.uint8)
    for chosen in (inside[~removed[inside]], inside[removed[inside]]):
        for step in ((0, 0), (1, 0), (0, 1), (1, 1)):
            drawn[row[chosen] + step[0], column[chosen] + step[1]] = colours[chosen]
    return drawn


def main() -> None:
    """Simulate, clean and draw."""
    sequence = dv.open(SEQUENCE)
    labels = dv.run("seethrough", sequence, record="none").labels
    scans = [sequence[k] for k in range(len(sequence))]
    middle = scans[len(scans) // 2].T_world_sensor
    points = np.concatenate([scan.points for scan in scans]).astype(np.float64)
    removed = np.concatenate(list(labels))
    xyz = (points - middle[:3, 3]) @ middle[:3, :3]
    shown = (np.abs(xyz[:, 0]) < AROUND) & (xyz[:, 2] > LEAST) & (xyz[:, 2] < MOST)
    xyz = xyz[shown]
    removed = removed[shown]
    halves = [
        picture(xyz, removed),
        picture(xyz[~removed], np.zeros(int((~removed).sum()), np.bool_)),
    ]
    line = np.full((8, WIDTH, 3), 255, np.uint8)
    small = cv2.resize(
        np.vstack([halves[0], line, halves[1]]),
        None,
        fx=0.5625,
        fy=0.5625,
        interpolation=cv2.INTER_AREA,
    )
    cv2.imwrite(
        str(Path(__file__).with_name("before_after.webp")), small, [cv2.IMWRITE_WEBP_QUALITY, 55]
    )
    print(f"removed {removed.sum():,} of {len(removed):,} points")


if __name__ == "__main__":
    main()
