"""Rigid transforms and quaternions.

Elementwise float64, so results are bit-identical on every machine.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynaviz.arrays import F32, F64


def inverse(T_a_b: ArrayLike) -> F64:
    """The inverse transform T_b_a.

    Args:
        T_a_b: (..., 4, 4) float64, rigid.
    """
    T = np.asarray(T_a_b, np.float64)
    out = np.zeros_like(T)
    R = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = R
    out[..., :3, 3] = -(R * T[..., None, :3, 3]).sum(-1)
    out[..., 3, 3] = 1.0
    return out


def compose(T_a_b: ArrayLike, T_b_c: ArrayLike) -> F64:
    """The product T_a_c, (..., 4, 4) float64; elementwise, as in ``apply``."""
    A = np.asarray(T_a_b, np.float64)
    B = np.asarray(T_b_c, np.float64)
    T: F64 = (A[..., :, :, None] * B[..., None, :, :]).sum(-2)
    return T


def apply(T_a_b: ArrayLike, points: NDArray[np.floating[Any]]) -> F64:
    """Transform points to another frame.

    Computed one coordinate at a time, because the bits of a matrix product depend on machine and
    threads.

    Args:
        T_a_b: (4, 4) or (3, 4) float64, metres.
        points: (N, 3) float, metres, frame b.

    Returns:
        (N, 3) float64, metres, frame a.
    """
    T = np.asarray(T_a_b, np.float64)
    out = np.empty((len(points), 3))
    with np.errstate(over="ignore", invalid="ignore"):  # non-finite values stay non-finite
        x, y, z = (points[:, axis].astype(np.float64) for axis in range(3))
        for axis in range(3):
            out[:, axis] = T[axis, 0] * x + T[axis, 1] * y + T[axis, 2] * z + T[axis, 3]
    return out


def transform(T_a_b: ArrayLike, points: NDArray[np.floating[Any]]) -> F32:
    """Transform points as ``apply`` does, and round the result to float32."""
    with np.errstate(over="ignore", invalid="ignore"):  # overflow gives infinity
        return apply(T_a_b, points).astype(np.float32)


def pose(position: ArrayLike, quaternion: ArrayLike) -> F64:
    """T_a_b, (4, 4) float64, from the position of b in a, (3,) metres, and its orientation (qw, qx,
    qy, qz).

    Raises:
        ValueError: as ``matrix``, and if the position is not finite.
    """
    T = np.eye(4)
    T[:3, :3] = matrix(quaternion)
    T[:3, 3] = position
    if not np.isfinite(T[:3, 3]).all():
        raise ValueError(f"position {T[:3, 3].tolist()} is not finite")
    return T


def matrix(quaternion: ArrayLike) -> F64:
    """Rotation matrix of a quaternion.

    Args:
        quaternion: (4,) float64, (qw, qx, qy, qz); need not have unit length.

    Returns:
        (3, 3) float64.

    Raises:
        ValueError: if the largest component is not between 1e-6 and 1e6, or a component is not
            finite.
    """
    q = np.asarray(quaternion, np.float64)
    if not 1e-6 < np.abs(q).max() < 1e6:  # also false for non-finite values
        raise ValueError(f"invalid quaternion {q.tolist()}")
    w, x, y, z = q / np.sqrt((q * q).sum())
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotation_problem(R: ArrayLike) -> str | None:
    """Why (3, 3) is not a rotation, in words; None if it is one, within 2 %."""
    R = np.asarray(R, np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        gram = compose(R, R.T)
        if bool(np.abs(gram - np.eye(3)).max() <= 0.02):
            return "the matrix mirrors (its determinant is -1)" if np.linalg.det(R) < 0 else None
        scales = np.sqrt(np.diag(gram))
        uniform = np.ptp(scales) < 0.02 * scales.max()
        if uniform and np.abs(gram - gram[0, 0] * np.eye(3)).max() <= 0.02 * gram[0, 0]:
            return f"the rotation is scaled by {scales.mean():.3g}"
    return "the matrix is not a rotation"


def quaternion(R: ArrayLike) -> F64:
    """(4,) float64 unit quaternion (qw, qx, qy, qz), qw >= 0, of a rotation matrix (3, 3).

    The largest component is computed first and divides the others, which avoids cancellation
    (Shepperd 1978).
    """
    R = np.asarray(R, np.float64)
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    four = 1 + np.array([trace, *(2 * np.diag(R) - trace)])  # 4 w^2, 4 x^2, 4 y^2, 4 z^2
    products = np.array(  # 4 q_i q_j off the diagonal
        [
            [0.0, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
            [0.0, 0.0, R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]],
            [0.0, 0.0, 0.0, R[1, 2] + R[2, 1]],
            [0.0, 0.0, 0.0, 0.0],
        ]
    )
    products += products.T + np.diag(four)
    largest = int(np.argmax(four))
    q: F64 = products[largest] / np.sqrt((products[largest] ** 2).sum())
    return q if q[0] >= 0 else -q
