"""Sensor effects as scans show them: ``python benchmarks/calibrate.py SEQUENCE [SEQUENCE ...]``.

Measures on real or simulated scans what the effects of the simulator imitate. A regular scan
pattern is needed.

range noise   Standard deviation around a parabola through seven consecutive returns of a ring, by
range and incidence. drop-outs     Share of rays without a return between two returns of the same
surface, by range and incidence. mixed pixels  Share of depth edges of a ring with returns between
the two surfaces, by depth of the step. below ground  Share of returns that lie more than half a
metre below the ground around them.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator

import numpy as np

import dynaviz
from dynaviz.arrays import F64, Bool
from dynaviz.contracts.scan import Sequence
from dynaviz.synthetic.implants.lidar_model import LidarModel, _by_mount
from dynaviz.synthetic.implants.pattern import Rings

SCANS = 6
# returns in a window, order of the polynomial
WINDOW = 7
ORDER = 2
RANGES = (2, 8, 15, 25, 40, 70)  # metres
ANGLES = (0, 30, 50, 65, 75, 82, 86, 90)  # degrees between ray and surface normal
FLAT = 0.004  # relative difference of neighbouring ranges on the surfaces beside an edge
STEPS = (0.3, 0.6, 1, 2, 4, 8, 30)  # metres between the two surfaces of an edge


def rings_of(sequence: Sequence) -> Iterator[tuple[Rings, F64]]:
    """The rings of each lidar in some scans, and the height of their points in the lidar frame,
    metres.
    """
    model = LidarModel.measure(sequence)
    for position in np.unique(np.linspace(0, len(sequence) - 1, SCANS).astype(int)):
        scan = sequence[int(position)]
        for mount, (_, local) in zip(model.mounts, _by_mount(scan, model.mounts), strict=True):
            rings = mount.pattern.rings(local) if mount.pattern else None
            if rings is not None and rings.regular:
                yield rings, local[rings.rows, 2]


def windows(values: F64, size: int = WINDOW) -> F64:
    """(N - size + 1, size): consecutive values."""
    return np.lib.stride_tricks.sliding_window_view(values, size)


def smooth(rings: Rings, size: int = WINDOW) -> Bool:
    """Windows of one ring without missing rays, on one surface.

    Neighbours differ by less than 4 % in range.
    """
    whole = (windows(rings.gap)[:, :-1] < 1.5 * rings.step).all(1) & (
        windows(rings.ring)[:, 0] == rings.ring[size - 1 :]
    )
    return whole & (np.abs(np.diff(windows(np.log(rings.range)), axis=1)) < 0.04).all(1)


def incidence(rings: Rings, z: F64) -> tuple[F64, Bool]:
    """Angle of incidence per window, degrees, if the surface is level ground (low points) or an
    upright wall.
    """
    steps = np.arange(WINDOW) - WINDOW // 2
    slope = (windows(rings.range) * steps).sum(1) / (steps**2).sum() / np.radians(rings.step)
    middle = slice(WINDOW // 2, -(WINDOW // 2))
    distance = rings.range[middle]
    elevation = np.radians(rings.elevation[middle])
    ground = np.abs(z[middle] - np.median(z[z < -1])) < 0.35
    level = np.degrees(np.arccos(np.clip(-np.sin(elevation), 0, 1)))
    wall = np.degrees(np.arccos(np.cos(elevation) * np.cos(np.arctan2(np.abs(slope), distance))))
    return np.where(ground, level, wall), ground


def noise(rings: Rings, z: F64) -> tuple[F64, F64, F64]:
    """Range, incidence and standard deviation per window, metres and degrees."""
    basis, _ = np.linalg.qr(np.vander(np.arange(WINDOW) - 3.0, ORDER + 1))
    ranges = windows(rings.range)
    rest = ranges - (ranges @ basis) @ basis.T
    deviation = np.sqrt((rest**2).sum(1) / (WINDOW - ORDER - 1))
    angle, _ = incidence(rings, z)
    chosen = smooth(rings)
    return ranges[chosen, WINDOW // 2], angle[chosen], deviation[chosen]


def drop_outs(rings: Rings, z: F64) -> tuple[F64, F64, F64]:
    """Range, incidence and lost rays (0 to 3) behind the middle of each window that lies on one
    surface.
    """
    middle = slice(WINDOW // 2, -(WINDOW // 2))
    lost = np.maximum(np.rint(rings.gap / rings.step)[middle] - 1, 0)
    near = np.abs(np.diff(windows(np.log(rings.range)), axis=1)).max(1) < 0.04
    chosen = near & (lost <= 3) & (windows(rings.ring)[:, 0] == rings.ring[WINDOW - 1 :])
    angle, _ = incidence(rings, z)
    return rings.range[middle][chosen], angle[chosen], lost[chosen]


def mixed(rings: Rings) -> tuple[F64, F64]:
    """Depth of each edge of a ring, metres, and whether a return lies between its two surfaces (0
    or 1).

    An edge: three returns on one surface, none to two in between, three on another one that is more
    than 0.3 m away.
    """
    steps = []
    found = []
    logs = np.log(rings.range)
    whole = rings.gap < 1.5 * rings.step
    for between in (0, 1, 2):
        size = 6 + between
        ranges = windows(rings.range, size)
        same = np.abs(np.diff(windows(logs, size), axis=1)) < FLAT
        whole_window = windows(whole, size)[:, :-1].all(1) & (
            windows(rings.ring, size)[:, 0] == rings.ring[size - 1 :]
        )
        left = ranges[:, 2]
        right = ranges[:, 3 + between]
        low = np.minimum(left, right)
        high = np.maximum(left, right)
        edge = (
            whole_window
            & same[:, :2].all(1)
            & same[:, -2:].all(1)
            & (high - low > 0.3)
            & (high < 40)
        )
        inner = ranges[:, 3 : 3 + between]
        margin = np.maximum(0.15 * (high - low), 0.1)[:, None]
        flank = np.maximum(np.abs(np.diff(ranges, axis=1))[:, [0, 1, -2, -1]].max(1), 0.02)
        edge &= high - low > 8 * flank
        edge &= ((inner > low[:, None] + margin) & (inner < high[:, None] - margin)).all(1)
        steps.append((high - low)[edge])
        found.append(np.full(edge.sum(), float(between > 0)))
    return np.concatenate(steps), np.concatenate(found)


def below(rings: Rings, z: F64) -> float:
    """Share of returns more than half a metre below the median height of low returns in their
    sector of 10 degrees.
    """
    near = (rings.range < 25) & (z < -1)
    sector = (rings.azimuth // 10).astype(int)
    chosen = [z[near & (sector == s)] for s in range(-18, 18)]
    level = np.array([np.median(low) if len(low) else -9.0 for low in chosen])
    return float(((z < level[np.clip(sector + 18, 0, 35)] - 0.5) & (rings.range < 30)).mean())


def grid(rows: F64, columns: F64, values: F64, summary: str, scale: float) -> str:
    """A table by range (rows) and angle (columns); cells with fewer than 100 windows stay empty."""
    lines = [
        "| range | " + " | ".join(f"{a} to {b}°" for a, b in itertools.pairwise(ANGLES)) + " |"
    ]
    lines.append("|---|" + "---|" * (len(ANGLES) - 1))
    for a, b in itertools.pairwise(RANGES):
        cells = []
        for c, d in itertools.pairwise(ANGLES):
            chosen = values[(rows >= a) & (rows < b) & (columns >= c) & (columns < d)]
            if len(chosen) < 100:
                cells.append("")
                continue
            value = (
                np.median(chosen)
                if summary == "median"
                else chosen.sum() / (len(chosen) + chosen.sum())
            )
            cells.append(f"{scale * value:.1f}")
        lines.append(f"| {a} to {b} m | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main(paths: list[str]) -> None:
    """Print the tables of each sequence."""
    for path in paths:
        sequence = dynaviz.open(path)
        scans = list(rings_of(sequence))
        print(f"## {sequence.name}\n")
        if not scans:
            print("The scan pattern is not regular.\n")
            continue
        noises = [
            np.concatenate(parts) for parts in zip(*(noise(*scan) for scan in scans), strict=True)
        ]
        lost = [
            np.concatenate(parts)
            for parts in zip(*(drop_outs(*scan) for scan in scans), strict=True)
        ]
        steps, found = (
            np.concatenate(parts)
            for parts in zip(*(mixed(rings) for rings, _ in scans), strict=True)
        )
        print(
            "Range noise, mm, by range and angle of incidence:\n\n"
            + grid(*noises, "median", 1000)
            + "\n"
        )
        print("Drop-outs, percent:\n\n" + grid(*lost, "share", 100) + "\n")
        cells = []
        for a, b in itertools.pairwise(STEPS):
            chosen = found[(steps >= a) & (steps < b)]
            cells.append(
                f"{a} to {b} m: {100 * chosen.mean():.1f} % of {len(chosen)}" if len(chosen) else ""
            )
        print("Depth edges with mixed pixels: " + "; ".join(cells))
        print(f"All edges: {100 * found.mean():.1f} % of {len(found)}")
        print(
            f"Below the ground: {1e4 * np.mean([below(*scan) for scan in scans]):.2f} of 10,000 "
            "returns\n"
        )


if __name__ == "__main__":
    main(sys.argv[1:])
