"""Triangle meshes of simple shapes. Metres; x forward, y left, z up.

Triangles counter-clockwise seen from outside.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from dynaviz.arrays import F64, I64
from dynaviz.spatial import geometry

Index = I64


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: (V, 3) float64, metres.
        triangles: (T, 3) int64, rows of ``vertices``.
    """

    vertices: F64
    triangles: Index

    def moved(self, x: float = 0, y: float = 0, z: float = 0, *, yaw: float = 0) -> Mesh:
        """The mesh rotated about z (radians) and then shifted (metres)."""
        T = np.eye(4)
        T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
        T[:3, 3] = x, y, z
        return self.transformed(T)

    def transformed(self, T: F64) -> Mesh:
        """The mesh under a (4, 4) rigid transform."""
        return Mesh(geometry.apply(T, self.vertices), self.triangles)

    def scaled(self, x: float, y: float, z: float) -> Mesh:
        """The mesh scaled along the axes by positive factors."""
        return Mesh(self.vertices * (x, y, z), self.triangles)

    @property
    def bounds(self) -> F64:
        """(2, 3) float64, metres: lowest and highest corner."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])


def join(meshes: Iterable[Mesh]) -> Mesh:
    """Combine several meshes into one."""
    meshes = list(meshes)
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    triangles = [m.triangles + start for m, start in zip(meshes, starts, strict=False)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(triangles))


def quads(corners: ArrayLike) -> Mesh:
    """Flat quadrilaterals.

    Args:
        corners: (N, 4, 3) metres, counter-clockwise seen from the front.
    """
    vertices = np.asarray(corners, np.float64).reshape(-1, 3)
    first = 4 * np.arange(len(vertices) // 4)[:, None]
    return Mesh(
        vertices, np.concatenate([first + np.array(three) for three in ((0, 1, 2), (0, 2, 3))])
    )


def grid(points: F64) -> Mesh:
    """A surface through (R, C, 3) points; it faces up if rows are along x and columns along y."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a = index[:-1, :-1]
    b = index[1:, :-1]
    c = index[1:, 1:]
    d = index[:-1, 1:]
    triangles = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return Mesh(points.reshape(-1, 3), triangles)


def loft(rings: ArrayLike) -> Mesh:
    """A closed body through rings.

    Args:
        rings: (R, K, 3) metres; each ring convex, and counter-clockwise seen from beyond the last
            ring.
    """
    points = np.asarray(rings, np.float64)
    return Mesh(points.reshape(-1, 3), _closed(*points.shape[:2]))


@cache
def _closed(count: int, sides: int) -> Index:
    """The triangles of a loft."""
    index = np.arange(count * sides).reshape(count, sides)
    a = index[:-1]
    b = np.roll(index[:-1], -1, axis=1)
    d = index[1:]
    c = np.roll(index[1:], -1, axis=1)
    side = [np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    fan = np.stack(
        [np.zeros(sides - 2, np.int64), np.arange(1, sides - 1), np.arange(2, sides)], axis=1
    )
    caps = [index[0][fan[:, ::-1]], index[-1][fan]]
    return np.concatenate(side + caps)


def boxes(centres: ArrayLike, sizes: ArrayLike) -> Mesh:
    """Axis-aligned boxes with (N, 3) centres and (N, 3) or (3,) sizes in metres."""
    centres = np.asarray(centres, np.float64)
    half = np.broadcast_to(np.asarray(sizes, np.float64) / 2, centres.shape)
    square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    unit = loft(np.stack([np.column_stack([square, np.full(4, z)]) for z in (-1, 1)]))
    vertices = (centres[:, None] + half[:, None] * unit.vertices).reshape(-1, 3)
    triangles = (8 * np.arange(len(centres))[:, None, None] + unit.triangles).reshape(-1, 3)
    return Mesh(vertices, triangles)


def box(x: float, y: float, z: float, *, at: tuple[float, float, float] = (0, 0, 0)) -> Mesh:
    """One box of this size; the centre of its bottom is at ``at``."""
    return boxes([(at[0], at[1], at[2] + z / 2)], (x, y, z))


def ellipsoid(
    x: float, y: float, z: float, *, at: tuple[float, float, float] = (0, 0, 0), sides: int = 10
) -> Mesh:
    """An ellipsoid with these semi-axes and centre ``at``."""
    polar = np.linspace(-0.98, 0.98, 7) * np.pi / 2
    around = 2 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(around), np.sin(around), np.ones(sides)])
    return loft([ring * (x * np.cos(p), y * np.cos(p), z * np.sin(p)) + at for p in polar])


def tube(points: ArrayLike, radii: ArrayLike, sides: int = 8) -> Mesh:
    """A round bar along (P, 3) points, with one radius or one per point.

    Poles, trunks, limbs, rims.
    """
    points = np.asarray(points, np.float64)
    tangents = np.concatenate(
        [points[1:2] - points[:1], (points[2:] - points[:-2]) / 2, points[-1:] - points[-2:-1]]
    )
    tangents /= np.sqrt((tangents * tangents).sum(1, keepdims=True))
    helper = np.where(np.abs(tangents[:, 2:]) < 0.9, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    u = _cross(helper, tangents)
    u /= np.sqrt((u * u).sum(1, keepdims=True))
    v = _cross(tangents, u)
    around = 2 * np.pi * np.arange(sides)[:, None] / sides
    circle = np.cos(around) * u[:, None] + np.sin(around) * v[:, None]
    return loft(points[:, None] + circle * np.broadcast_to(radii, len(points))[:, None, None])


def _cross(a: F64, b: F64) -> F64:
    """The cross product of (P, 3) vectors.

    For few vectors much faster than numpy's, with the same bits.
    """
    (ax, ay, az) = a.T
    (bx, by, bz) = b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def layers(profile: Iterable[tuple[float, float, float, float]]) -> Mesh:
    """A body of stacked rectangles with cut corners.

    (z, rear x, front x, half width), from bottom to top.
    """
    return loft([_rounded(rear, front, half, z) for z, rear, front, half in profile])


def _rounded(rear: float, front: float, half: float, z: float) -> F64:
    cut = 0.25 * half
    corners = [(rear, -half + cut), (rear + cut, -half), (front - cut, -half), (front, -half + cut)]
    return np.array([(x, y, z) for x, y in corners] + [(x, -y, z) for x, y in reversed(corners)])


def leaves(centres: F64, size: float, rng: np.random.Generator) -> Mesh:
    """Single randomly oriented triangles of about this size (metres) at (N, 3) centres.

    Rays pass between them.
    """
    corners = centres[:, None] + rng.normal(0, size / 2, (len(centres), 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(3 * len(centres)).reshape(-1, 3))
