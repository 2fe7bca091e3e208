"""Bodies of difficult movers: a dog, a trolley, a door leaf, someone who sits down."""

from __future__ import annotations

import numpy as np

from dynaviz.synthetic.simulate import objects
from dynaviz.synthetic.simulate.shapes import Mesh, box, boxes, ellipsoid, join, tube

DOOR = (0.95, 2.05)  # width and height of a door leaf, metres
SEAT = 0.6  # metres before the end of the way on which someone sits down


def dog(distance: float) -> Mesh:
    """A dog, 0.65 m high at the head, after ``distance`` metres: its legs swing."""
    swing = 0.5 * np.sin(2 * np.pi * distance / 0.9)
    parts = [ellipsoid(0.36, 0.12, 0.15, at=(0, 0, 0.43)), ellipsoid(0.13, 0.07, 0.08, at=(0.45, 0, 0.6), sides=8)]
    parts += [tube([(0.28, 0, 0.48), (0.42, 0, 0.58)], 0.07, 6), tube([(-0.34, 0, 0.48), (-0.6, 0, 0.62)], 0.025, 5)]
    for x, side, phase in ((0.25, 1, 1), (0.25, -1, -1), (-0.26, 1, -1), (-0.26, -1, 1)):
        foot = (x + 0.35 * np.sin(phase * swing), 0.08 * side, 0.36 * (1 - np.cos(swing)) + 0.01)
        parts.append(tube([(x, 0.08 * side, 0.38), foot], (0.05, 0.03), 6))
    return join(parts)


def trolley() -> Mesh:
    """A trolley with a wire basket; rays pass its bars."""
    bars = [(0.45 * a, y, 0.65) for a in np.linspace(-1, 1, 9) for y in (-0.28, 0.28)]
    ends = [(x, y, 0.65) for x in (-0.45, 0.45) for y in np.linspace(-0.22, 0.22, 5)]
    basket = boxes(bars + ends + [(0, 0, 0.46)], len(bars + ends) * [(0.02, 0.02, 0.4)] + [(0.9, 0.56, 0.03)])
    rails = boxes(
        [(0, y, 0.86) for y in (-0.28, 0.28)] + [(-0.55, 0, 0.98)], 2 * [(0.95, 0.03, 0.03)] + [(0.04, 0.6, 0.04)]
    )
    legs = boxes([(x, y, 0.24) for x in (-0.35, 0.35) for y in (-0.24, 0.24)], (0.05, 0.05, 0.48))
    load = box(0.4, 0.35, 0.25, at=(0.1, 0, 0.48))
    return join([basket, rails, legs, load])


def door(share: float) -> Mesh:
    """A door leaf with its hinge at the origin, closed along x (0) or opened towards y by 95 degrees (1)."""
    width, height = DOOR
    return box(width, 0.05, height, at=(width / 2, 0.03, 0.02)).moved(yaw=np.radians(95) * share)


def sitter(distance: float, end: float, height: float) -> Mesh:
    """Someone who walks up to the front of a bench and sits down at the end of the way, turned to the left by 90°."""
    share = float(np.clip((distance - end + SEAT) / SEAT, 0, 1))
    if not share:
        return objects.person(distance, height)
    drop, lean = 0.45 * share, share * np.pi / 2
    parts = [
        ellipsoid(0.14, 0.22, 0.33, at=(0, 0, 1.17 - drop)),
        ellipsoid(0.1, 0.09, 0.13, at=(0.02, 0, 1.62 - drop), sides=8),
        tube([(0, 0, 1.46 - drop), (0.01, 0, 1.55 - drop)], 0.06, 6),
    ]
    for side in (-0.1, 0.1):
        hip = np.array([0, side, 0.92 - drop])
        knee = hip + 0.46 * np.array([np.sin(lean), 0, -np.cos(lean)])
        shoulder, hand = np.array([0, 2.5 * side, 1.4 - drop]), knee + np.array([-0.05, 0, 0.1])
        parts += [tube(np.array([hip, knee, (knee[0], side, 0.03)]), (0.095, 0.07, 0.05), 6)]
        parts += [tube(np.array([shoulder, hand]), (0.06, 0.035), 6)]
    body = join(parts).scaled(height / 1.75, 1, height / 1.75)
    return body.moved(yaw=np.pi / 2 * share).moved(0, -0.5 * share)
