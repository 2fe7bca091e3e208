"""Registration of one scan to the surfaces of another one."""

from __future__ import annotations

import numpy as np

from dynaviz.arrays import F64
from dynaviz.sources.hypotheses.views import Surface
from dynaviz.spatial import geometry

# steps of registration whose distance limit shrinks; metres and radians of the last one
SHRINKS = 12
SETTLED = 1e-4


def register(surface: Surface, points: F64) -> F64:
    """T_a_b that aligns points with surfaces.

    Point-to-plane ICP with a shrinking distance limit.
    """
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    for step in range(30):
        moved = geometry.apply(T, points)
        heights, normals = surface.heights(moved)
        near = np.abs(heights) < max(1.0 - step / 15, 0.2)
        if near.sum() < 20:
            break
        middle = moved[near].mean(0)
        A = np.hstack([np.cross(moved[near] - middle, normals[near]), normals[near]])
        x = np.linalg.lstsq(A.T @ A + 1e-3 * np.eye(6), -A.T @ heights[near], rcond=None)[0]
        delta = np.eye(4)
        delta[:3, :3] = Rotation.from_rotvec(x[:3]).as_matrix()
        delta[:3, 3] = middle + x[3:] - delta[:3, :3] @ middle
        T = delta @ T
        if step >= SHRINKS and np.abs(x).max() < SETTLED:
            break
    return T
