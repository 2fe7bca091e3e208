"""Meshes of the objects in a scene, each standing on z = 0 at the origin and facing along x."""

from __future__ import annotations

from functools import cache

import numpy as np

from dynaviz.arrays import F64
from dynaviz.synthetic.simulate.shapes import (
    Mesh,
    box,
    boxes,
    ellipsoid,
    join,
    layers,
    leaves,
    quads,
    tube,
)

Face = list[tuple[float, float, float]]
"""Corners of a flat face, metres."""

STRIDE = 1.4
"""Length of a left and a right step of a person, metres."""


# Movable objects.


def car(rng: np.random.Generator) -> Mesh:
    """A car of one of four models, 3.7 to 4.9 m long."""
    length, height, boot = (
        (3.7, 1.5, 0.1),
        (4.3, 1.45, 0.25),
        (4.7, 1.42, 0.8),
        (4.9, 1.75, 0.15),
    )[rng.integers(4)]
    half = 0.88
    rear = -length / 2
    front = length / 2
    bonnet = front - 0.24 * length
    profile = [
        (0.22, rear + 0.15, front - 0.15, half - 0.06),
        (0.45, rear, front, half),
        (0.7, rear, front, half),
    ]
    profile += [
        (0.88, rear + 0.05, front - 0.1, half - 0.03),
        (0.9, rear + boot, bonnet, half - 0.08),
    ]
    profile += [
        (height - 0.04, rear + boot + 0.35, bonnet - 0.75, 0.64),
        (height, rear + boot + 0.6, bonnet - 1, 0.55),
    ]
    return join([layers(profile), _wheels((0.3 * length, -0.3 * length), half - 0.1, 0.32)])


def truck(rng: np.random.Generator) -> Mesh:
    """A lorry, 3.6 to 4 m high: cab, gap, box."""
    length = rng.uniform(6.5, 9.0)
    height = rng.uniform(3.6, 4.0)
    front = length / 2
    rear = -length / 2
    cab = [
        (0.5, front - 1.9, front, 1.15),
        (1.6, front - 1.9, front, 1.2),
        (2.5, front - 1.9, front - 0.2, 1.15),
    ]
    load = box(length - 2.2, 2.5, height - 0.95, at=(-1.1, 0, 0.95))
    chassis = box(length - 1.0, 0.9, 0.45, at=(-0.4, 0, 0.5))
    return join(
        [
            layers([*cab, (2.75, front - 1.9, front - 0.5, 1.0)]),
            load,
            chassis,
            _wheels((front - 1, rear + 1.5), 1.1, 0.48),
        ]
    )


def forklift(_: np.random.Generator) -> Mesh:
    """A forklift with mast and empty fork."""
    mast = boxes(
        [(1.05, 0.3, 1.1), (1.05, -0.3, 1.1), (1.05, 0, 2.1)],
        [(0.1, 0.1, 2.2), (0.1, 0.1, 2.2), (0.1, 0.7, 0.1)],
    )
    roof = boxes(
        [(0, 0, 2.05)] + [(x, y, 1.5) for x in (-0.6, 0.6) for y in (-0.4, 0.4)],
        [(1.4, 0.95, 0.05)] + 4 * [(0.06, 0.06, 1.1)],
    )
    fork = boxes([(1.6, 0.25, 0.15), (1.6, -0.25, 0.15)], (1.1, 0.12, 0.05))
    hull = layers([(0.15, -1.0, 1.0, 0.5), (0.95, -1.0, 0.9, 0.5), (1.0, -0.9, 0.1, 0.45)])
    return join(
        [
            hull,
            mast,
            roof,
            fork,
            box(0.3, 0.45, 0.8, at=(-0.3, 0, 1.0)),
            _wheels((0.6, -0.7), 0.45, 0.25),
        ]
    )


def _wheels(axles: tuple[float, float], half: float, radius: float) -> Mesh:
    return join(
        tube([(x, y - 0.1, radius), (x, y + 0.1, radius)], radius, 12)
        for x in axles
        for y in (-half, half)
    )


def person(distance: float, height: float = 1.75) -> Mesh:
    """A walking person after ``distance`` metres: arms and legs swing."""
    swing = 0.55 * np.sin(2 * np.pi * distance / STRIDE)
    parts = [_torso()]
    for side in (-1, 1):
        parts.append(
            _limb(
                (0, 0.1 * side, 0.92), side * swing, (0.46, 0.46), (0.095, 0.07, 0.05), knee=-0.35
            )
        )
        parts.append(
            _limb(
                (0, 0.25 * side, 1.4),
                -0.8 * side * swing,
                (0.3, 0.28),
                (0.06, 0.045, 0.035),
                knee=0.3,
            )
        )
    return join(parts).scaled(height / 1.75, 1, height / 1.75)


@cache
def _torso() -> Mesh:
    """Trunk, head and neck of a person."""
    trunk = ellipsoid(0.14, 0.22, 0.33, at=(0, 0, 1.17))
    head = ellipsoid(0.1, 0.09, 0.13, at=(0.02, 0, 1.62), sides=8)
    return join([trunk, head, tube([(0, 0, 1.46), (0.01, 0, 1.55)], 0.06, 6)])


def _limb(
    top: tuple[float, float, float],
    angle: float,
    lengths: tuple[float, float],
    radii: tuple[float, ...],
    knee: float,
) -> Mesh:
    """An upper and a lower segment, hanging from ``top`` and swung forward by an angle (radians).

    The knee bends.
    """
    points = [np.array(top)]
    for length, lean in zip(lengths, (angle, angle + knee * (1 - np.cos(angle))), strict=True):
        points.append(points[-1] + length * np.array([np.sin(lean), 0, -np.cos(lean)]))
    return tube(points, radii, 6)


def cyclist(distance: float) -> Mesh:
    """A cyclist after ``distance`` metres: the legs turn the pedals."""
    turn = 2 * np.pi * distance / 5.0
    parts = [
        bicycle(),
        ellipsoid(0.17, 0.2, 0.34, at=(-0.05, 0, 1.22)),
        ellipsoid(0.11, 0.09, 0.13, at=(0.12, 0, 1.66), sides=8),
    ]
    for side in (-1, 1):
        pedal = np.array(
            [0.05 + 0.17 * side * np.cos(turn), 0.1 * side, 0.3 - 0.17 * side * np.sin(turn)]
        )
        knee = (np.array([-0.15, 0.1 * side, 0.95]) + pedal) / 2 + (0.28, 0, 0.1)
        parts.append(tube([(-0.15, 0.1 * side, 0.95), knee, pedal], (0.09, 0.07, 0.05), 6))
        parts.append(
            tube(
                [(0.05, 0.2 * side, 1.42), (0.3, 0.25 * side, 1.2), (0.45, 0.22 * side, 1.08)],
                0.045,
                6,
            )
        )
    return join(parts)


@cache
def bicycle() -> Mesh:
    """A bicycle without a rider; rays pass through its wheels."""
    around = np.linspace(0, 2 * np.pi, 17)
    rim = np.column_stack([0.34 * np.cos(around), np.zeros(17), 0.34 + 0.34 * np.sin(around)])
    bars = [
        ((-0.52, 0, 0.34), (-0.15, 0, 0.9)),
        ((-0.52, 0, 0.34), (0.05, 0, 0.3)),
        ((0.05, 0, 0.3), (0.4, 0, 0.85)),
    ]
    bars += [((-0.15, 0, 0.8), (0.4, 0, 0.85)), ((0.52, 0, 0.34), (0.4, 0, 1.05))]
    frame = [tube(ends, 0.02, 5) for ends in bars] + [
        tube([(0.42, -0.25, 1.05), (0.42, 0.25, 1.05)], 0.02, 5)
    ]
    wheels = [tube(np.add(rim, (x, 0, 0)), 0.025, 5) for x in (-0.52, 0.52)]
    return join([*wheels, *frame, box(0.25, 0.12, 0.06, at=(-0.17, 0, 0.92))])


# Static objects.


def trunk(rng: np.random.Generator, height: float) -> Mesh:
    """A bent trunk with three branches."""
    bend = rng.uniform(-0.25, 0.25, 2)
    stem = [(0, 0, -0.5), (0, 0, 0.1), (*(bend / 2), height * 0.35), (*bend, height * 0.75)]
    branches = [
        _branch(np.array([*(bend / 2), height * 0.35]), a, height)
        for a in rng.uniform(0, 2 * np.pi, 3)
    ]
    return join([tube(stem, (0.24, 0.2, 0.15, 0.06)), *branches])


def _branch(start: F64, azimuth: float, height: float) -> Mesh:
    end = start + height * np.array([0.17 * np.cos(azimuth), 0.17 * np.sin(azimuth), 0.25])
    return tube([start, end], (0.08, 0.03), 5)


def crown(rng: np.random.Generator, height: float, count: int = 1600) -> Mesh:
    """Leaves in five loose clusters, above head height."""
    radius = 0.22 * height
    aside = np.clip(rng.normal(0, 0.55 * radius, (5, 2)), -0.8 * radius, 0.8 * radius)
    balls = np.column_stack([aside, rng.uniform(0.6 * height, 0.85 * height, 5)])
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    shell = radius * rng.uniform(0.3, 1, (count, 1)) ** 0.5
    return leaves(balls[rng.integers(5, size=count)] + shell * directions, 0.2, rng)


def bush(rng: np.random.Generator, x: float, y: float, z: float) -> Mesh:
    """A hedge or bush of this size, metres."""
    count = int(300 * x * z) + 60
    return leaves(rng.uniform((-x / 2, -y / 2, 0), (x / 2, y / 2, z), (count, 3)), 0.15, rng)


def lamp(height: float = 6.0, arm: float = 1.5) -> Mesh:
    """A lamp post whose arm points along x."""
    post = tube([(0, 0, -0.3), (0, 0, 1.0), (0, 0, height)], (0.11, 0.09, 0.05))
    return join(
        [
            post,
            tube([(0, 0, height), (arm, 0, height + 0.2)], 0.04, 6),
            box(0.6, 0.25, 0.12, at=(arm, 0, height + 0.12)),
        ]
    )


def sign(height: float = 2.4) -> Mesh:
    """A traffic sign on its pole."""
    return join(
        [
            tube([(0, 0, -0.3), (0, 0, height)], 0.035, 6),
            tube([(0.04, 0, height), (0.07, 0, height)], 0.32, 12),
        ]
    )


def bench(length: float = 1.8) -> Mesh:
    """A bench with a backrest of two planks."""
    planks = [(0, 0, 0.45), (-0.22, 0, 0.65), (-0.25, 0, 0.82)]
    feet = [(0, y, 0.21) for y in (-0.4 * length, 0.4 * length)]
    return boxes(
        planks + feet,
        [(0.45, length, 0.05), (0.04, length, 0.1), (0.04, length, 0.1)] + 2 * [(0.35, 0.08, 0.42)],
    )


def table() -> Mesh:
    """A table and four chairs."""
    legs = [(x, y, 0.36) for x in (-0.65, 0.65) for y in (-0.35, 0.35)]
    desk = boxes([(0, 0, 0.74), *legs], [(1.5, 0.85, 0.04)] + 4 * [(0.05, 0.05, 0.72)])
    return join(
        [desk]
        + [
            _chair().moved(x, y, yaw=np.sign(y) * np.pi / 2)
            for x in (-0.4, 0.4)
            for y in (-0.75, 0.75)
        ]
    )


def _chair() -> Mesh:
    legs = [(x, y, 0.22) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    return boxes(
        [(0, 0, 0.45), (0.22, 0, 0.7), *legs],
        [(0.45, 0.45, 0.04), (0.03, 0.45, 0.45)] + 4 * [(0.04, 0.04, 0.44)],
    )


def shelf(rng: np.random.Generator, length: float = 4.0, height: float = 2.6) -> Mesh:
    """A rack with four boards and crates on them; rays pass between."""
    boards = [(0, 0, z) for z in np.linspace(0.1, height, 4)]
    posts = [
        (x, y, height / 2) for x in np.linspace(-length / 2, length / 2, 3) for y in (-0.4, 0.4)
    ]
    rack = boxes(boards + posts, 4 * [(length, 0.9, 0.05)] + 6 * [(0.08, 0.08, height)])
    places = [
        (x, 0, z)
        for x in np.arange(-length / 2 + 0.4, length / 2 - 0.3, 0.8)
        for z in np.linspace(0.1, height, 4)[:3]
    ]
    crates = [
        box(*rng.uniform((0.4, 0.4, 0.3), (0.75, 0.8, 0.65)), at=p)
        for p in places
        if rng.random() < 0.65
    ]
    return join([rack, *crates])


def fence(length: float, height: float = 1.3) -> Mesh:
    """A fence along x with posts, two rails and pickets; rays pass between."""
    pickets = np.arange(-length / 2, length / 2, 0.16)
    posts = np.arange(-length / 2, length / 2 + 0.1, 2.4)
    stakes = (
        [(x, 0, height / 2) for x in pickets]
        + [(x, 0.05, height / 2) for x in posts]
        + [(0, 0.03, 0.3), (0, 0.03, height - 0.25)]
    )
    sizes = (
        len(pickets) * [(0.07, 0.02, height)]
        + len(posts) * [(0.1, 0.1, height + 0.1)]
        + 2 * [(length, 0.04, 0.08)]
    )
    return boxes(stakes, sizes)


# Houses. The front is at y = 0 and faces along y; the house extends to negative y.


def house(rng: np.random.Generator, width: float, depth: float, storeys: int) -> tuple[Mesh, Mesh]:
    """Two meshes: walls, roof, balconies and rooms behind open windows.

    And the panes of the closed windows.
    """
    height = 3.2 * storeys + 0.6
    front, panes = _front(rng, width, height, storeys)
    w = width / 2
    d = -depth
    sides: list[Face] = [
        [(-w, d, -1), (-w, 0, -1), (-w, 0, height), (-w, d, height)],
        [(w, 0, -1), (w, d, -1), (w, d, height), (w, 0, height)],
    ]
    back: Face = [(w, d, -1), (-w, d, -1), (-w, d, height), (w, d, height)]
    ridge = height + 0.35 * depth
    roof: list[Face] = [
        [(-w, 0.4, height), (w, 0.4, height), (w, d / 2, ridge), (-w, d / 2, ridge)]
    ]
    roof += [[(w, d - 0.4, height), (-w, d - 0.4, height), (-w, d / 2, ridge), (w, d / 2, ridge)]]
    rooms: list[Face] = [[(-w, -4, 0), (w, -4, 0), (w, -4, height), (-w, -4, height)]]
    rooms += [
        [(-w, -4, z), (w, -4, z), (w, 0, z), (-w, 0, z)] for z in 0.5 + 3.2 * np.arange(storeys)
    ]
    cornice = box(width, 0.3, 0.25, at=(0, 0.15, height - 0.35))
    return join(
        [front, quads([*sides, back, *roof, *rooms]), cornice, *_balconies(rng, width, storeys)]
    ), panes


def _front(
    rng: np.random.Generator, width: float, height: float, storeys: int
) -> tuple[Mesh, Mesh]:
    """A wall with a grid of recessed windows, a fifth of them open.

    And the panes of the closed ones.
    """
    columns = max(2, int(width / 2.6))
    middles = (np.arange(columns) + 0.5) * width / columns - width / 2
    x = np.concatenate([[-width / 2], (middles[:, None] + (-0.6, 0.6)).ravel(), [width / 2]])
    z = np.concatenate(
        [[-1], (1.4 + 3.2 * np.arange(storeys)[:, None] + (0, 1.5)).ravel(), [height]]
    )
    fields = [(i, j) for i in range(len(x) - 1) for j in range(len(z) - 1)]
    windows = [(x[i], x[i + 1], z[j], z[j + 1]) for i, j in fields if i % 2 and j % 2]
    wall = [_upright(x[i], x[i + 1], z[j], z[j + 1], 0) for i, j in fields if not (i % 2 and j % 2)]
    wall += [face for window in windows for face in _reveal(*window, 0.22)]
    closed = rng.random(len(windows)) < 0.8
    panes = [w for w, c in zip(windows, closed, strict=True) if c or w is windows[0]]
    return quads(wall), quads([_upright(*w, -0.22) for w in panes])


def _upright(x0: float, x1: float, z0: float, z1: float, y: float) -> Face:
    return [(x1, y, z0), (x0, y, z0), (x0, y, z1), (x1, y, z1)]


def _reveal(x0: float, x1: float, z0: float, z1: float, deep: float) -> list[Face]:
    """The four faces between a wall and a window set back in it."""
    ring = [(x0, z0), (x1, z0), (x1, z1), (x0, z1)]
    return [
        [(a, 0, b), (c, 0, d), (c, -deep, d), (a, -deep, b)]
        for (a, b), (c, d) in zip(ring, ring[1:] + ring[:1], strict=True)
    ]


def _balconies(rng: np.random.Generator, width: float, storeys: int) -> list[Mesh]:
    x = rng.uniform(-width / 3, width / 3)
    return [_balcony().moved(x, 0, 0.5 + 3.2 * k) for k in range(1, storeys) if rng.random() < 0.5]


def _balcony() -> Mesh:
    bars = [(x, 1.05, 0.55) for x in np.arange(-1.2, 1.21, 0.15)]
    return boxes(
        [(0, 0.55, 0), (0, 1.05, 1.1), *bars],
        [(2.5, 1.1, 0.15), (2.5, 0.05, 0.05)] + len(bars) * [(0.02, 0.02, 1.1)],
    )


DOOR = (0.95, 2.05)  # width and height of a door leaf, metres
SEAT = 0.6  # metres before the end of the way on which someone sits down


def dog(distance: float) -> Mesh:
    """A dog, 0.65 m high at the head, after ``distance`` metres: its legs swing."""
    swing = 0.5 * np.sin(2 * np.pi * distance / 0.9)
    parts = [
        ellipsoid(0.36, 0.12, 0.15, at=(0, 0, 0.43)),
        ellipsoid(0.13, 0.07, 0.08, at=(0.45, 0, 0.6), sides=8),
    ]
    parts += [
        tube([(0.28, 0, 0.48), (0.42, 0, 0.58)], 0.07, 6),
        tube([(-0.34, 0, 0.48), (-0.6, 0, 0.62)], 0.025, 5),
    ]
    for x, side, phase in ((0.25, 1, 1), (0.25, -1, -1), (-0.26, 1, -1), (-0.26, -1, 1)):
        foot = (x + 0.35 * np.sin(phase * swing), 0.08 * side, 0.36 * (1 - np.cos(swing)) + 0.01)
        parts.append(tube([(x, 0.08 * side, 0.38), foot], (0.05, 0.03), 6))
    return join(parts)


def trolley() -> Mesh:
    """A trolley with a wire basket; rays pass its bars."""
    bars = [(0.45 * a, y, 0.65) for a in np.linspace(-1, 1, 9) for y in (-0.28, 0.28)]
    ends = [(x, y, 0.65) for x in (-0.45, 0.45) for y in np.linspace(-0.22, 0.22, 5)]
    basket = boxes(
        bars + ends + [(0, 0, 0.46)], len(bars + ends) * [(0.02, 0.02, 0.4)] + [(0.9, 0.56, 0.03)]
    )
    rails = boxes(
        [(0, y, 0.86) for y in (-0.28, 0.28)] + [(-0.55, 0, 0.98)],
        2 * [(0.95, 0.03, 0.03)] + [(0.04, 0.6, 0.04)],
    )
    legs = boxes([(x, y, 0.24) for x in (-0.35, 0.35) for y in (-0.24, 0.24)], (0.05, 0.05, 0.48))
    load = box(0.4, 0.35, 0.25, at=(0.1, 0, 0.48))
    return join([basket, rails, legs, load])


def door(share: float) -> Mesh:
    """A door leaf with its hinge at the origin, closed along x (0) or opened towards y by 95
    degrees (1).
    """
    width, height = DOOR
    return box(width, 0.05, height, at=(width / 2, 0.03, 0.02)).moved(yaw=np.radians(95) * share)


def sitter(distance: float, end: float, height: float) -> Mesh:
    """Someone who walks up to the front of a bench and sits down at the end of the way, turned to
    the left by 90°.
    """
    share = float(np.clip((distance - end + SEAT) / SEAT, 0, 1))
    if not share:
        return person(distance, height)
    drop = 0.45 * share
    lean = share * np.pi / 2
    parts = [
        ellipsoid(0.14, 0.22, 0.33, at=(0, 0, 1.17 - drop)),
        ellipsoid(0.1, 0.09, 0.13, at=(0.02, 0, 1.62 - drop), sides=8),
        tube([(0, 0, 1.46 - drop), (0.01, 0, 1.55 - drop)], 0.06, 6),
    ]
    for side in (-0.1, 0.1):
        hip = np.array([0, side, 0.92 - drop])
        knee = hip + 0.46 * np.array([np.sin(lean), 0, -np.cos(lean)])
        shoulder = np.array([0, 2.5 * side, 1.4 - drop])
        hand = knee + np.array([-0.05, 0, 0.1])
        parts += [tube(np.array([hip, knee, (knee[0], side, 0.03)]), (0.095, 0.07, 0.05), 6)]
        parts += [tube(np.array([shoulder, hand]), (0.06, 0.035), 6)]
    body = join(parts).scaled(height / 1.75, 1, height / 1.75)
    return body.moved(yaw=np.pi / 2 * share).moved(0, -0.5 * share)
