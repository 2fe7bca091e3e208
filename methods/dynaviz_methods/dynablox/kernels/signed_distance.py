"""Projective TSDF: voxels compared with a range image.

``view`` describes an image: rows, columns, elevation of the first row (radians), rows per radian,
columns per radian. Rows run downwards from the highest elevation, columns from azimuth -pi; integer
coordinates are pixel centres.

Only voxels whose bit is set in ``needed`` (B, 8) have state; bit v of word w is voxel 64 w + v of a
block. The state of a block's voxels is consecutive from ``first[block]``, in the order of their
bits.
"""

import math

import numpy as np
from numba import njit, prange

# powers of two, from 1: numbers of columns over which the farthest range lets hidden blocks be
# skipped
WIDTHS = 6
_FULL = np.uint64(0xFFFFFFFFFFFFFFFF)
_ONE = np.uint64(1)
_TOP = np.uint64(56)
_LOWEST = np.uint64(0x0101010101010101)
_TO_BYTE = np.uint64(0x0102040810204080)
ERROR = 2e-6  # radians: of an angle in float32, at most
_F0 = np.float32(0)
_F1 = np.float32(1)
_HALF = np.float32(0.5)
_PI = np.float32(math.pi)
_HALF_PI = np.float32(math.pi / 2)
# arctan on [0, 1]: Abramowitz and Stegun 4.4.49, error below 2e-8
_A1, _A3, _A5, _A7, _A9, _A11, _A13, _A15 = (
    np.float32(a)
    for a in (
        -0.3333314528, 0.1999355085, -0.1420889944, 0.1065626393,
        -0.0752896400, 0.0429096138, -0.0161657367, 0.0028662257,
    )
)  # fmt: skip


@njit(cache=True, nogil=True, inline="always")
def _angle(y, x):
    """The polar angle of (x, y) in float32, without branches."""
    a = abs(x)
    b = abs(y)
    t = min(a, b) / max(max(a, b), np.float32(1e-30))
    s = t * t
    p = _A11 + s * (_A13 + s * _A15)
    p = _A5 + s * (_A7 + s * (_A9 + s * p))
    p = t * (_F1 + s * (_A1 + s * (_A3 + s * p)))
    p = _HALF_PI - p if b > a else p
    p = _PI - p if x < _F0 else p
    return -p if y < _F0 else p


@njit(cache=True, nogil=True, inline="always")
def _pixel(y, x, start, per_radian):
    """The row or column of the direction (x, y), counted from an angle; pixel borders are integers.

    The angle is computed in float32, and again in float64 where the error could change the pixel.
    """
    at = (_angle(np.float32(y), np.float32(x)) - start) * per_radian + 0.5
    if abs(at - math.floor(at + 0.5)) < ERROR * abs(per_radian):
        at = (math.atan2(y, x) - start) * per_radian + 0.5
    return at


@njit(cache=True, nogil=True, parallel=True)
def pixels(points, position, axes, nearest, farthest, view):
    """Pixels and ranges of points.

    Args:
        points: (N, 3) float32, metres, world frame.
        position: (3,) float64, metres, world frame: the sensor.
        axes: (3, 3) float64, rotation from world to sensor.
        nearest, farthest: range limits, metres.
        view: the image.

    Returns:
        pixels: (N,) int32, row * columns + column; -1 if not in view.
        ranges: (N,) float32, metres.
        inside: (N,) bool: whether the range is within the limits.
    """
    n = len(points)
    rows = int(view[0])
    columns = int(view[1])
    found = np.full(n, np.int32(-1))
    ranges = np.empty(n, np.float32)
    inside = np.zeros(n, np.bool_)
    for i in prange(n):
        dx = points[i, 0] - position[0]
        dy = points[i, 1] - position[1]
        dz = points[i, 2] - position[2]
        r = math.sqrt(dx * dx + dy * dy + dz * dz)
        ranges[i] = r
        if not (nearest <= r <= farthest and 0 < r < np.inf):
            continue
        inside[i] = True
        x = axes[0, 0] * dx + axes[0, 1] * dy + axes[0, 2] * dz
        y = axes[1, 0] * dx + axes[1, 1] * dy + axes[1, 2] * dz
        z = axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz
        row = _pixel(z, math.sqrt(x * x + y * y), view[2], -view[3])
        if 0 <= row < rows:
            found[i] = int(row) * columns + int(_pixel(y, x, -math.pi, view[4])) % columns
    return found, ranges, inside


@njit(cache=True, nogil=True)
def image(pixels, ranges, rows, columns):
    """(rows * columns,) float32, metres: nearest range in each pixel, 0 if empty."""
    nearest = np.zeros(rows * columns, np.float32)
    for i in range(len(pixels)):
        p = pixels[i]
        if p >= 0 and (nearest[p] == _F0 or ranges[i] < nearest[p]):
            nearest[p] = ranges[i]
    return nearest


@njit(cache=True, nogil=True)
def farthest(image, rows, columns):
    """(WIDTHS, rows * columns) float32, metres.

    The farthest range in each pixel and its 2^k - 1 next ones, by k.
    """
    table = np.empty((WIDTHS, rows * columns), np.float32)
    table[0] = image
    for k in range(1, WIDTHS):
        shift = (1 << k - 1) % columns
        for row in range(rows):
            before = table[k - 1, row * columns : (row + 1) * columns]
            here = row * columns
            for column in range(columns - shift):
                table[k, here + column] = max(before[column], before[column + shift])
            for column in range(columns - shift, columns):
                table[k, here + column] = max(before[column], before[column + shift - columns])
    return table


@njit(cache=True, nogil=True, inline="always")
def _direction(y, x):
    """The polar angle of (x, y), from float32."""
    return float(_angle(np.float32(y), np.float32(x)))


@njit(cache=True, nogil=True, error_model="numpy")
def _shown(corner, edge, corners, axes, view, table, truncation):
    """Whether a pixel that shows a part of a block may have a range that updates it.

    The corners bound height and azimuth. The block's distance from the vertical axis is least on an
    edge, whose middle is nearer than its ends by at most what half its length adds.
    """
    rows = int(view[0])
    columns = int(view[1])
    x0 = axes[0, 0] * corner[0] + axes[0, 1] * corner[1] + axes[0, 2] * corner[2]
    y0 = axes[1, 0] * corner[0] + axes[1, 1] * corner[1] + axes[1, 2] * corner[2]
    z0 = axes[2, 0] * corner[0] + axes[2, 1] * corner[1] + axes[2, 2] * corner[2]
    cx = x0 + 0.5 * corners[0, 7]
    cy = y0 + 0.5 * corners[1, 7]
    inner = np.inf
    outer = 0.0
    low = np.inf
    high = -np.inf
    left = np.inf
    right = -np.inf
    squared = 0.0
    for n in range(8):
        x = x0 + corners[0, n]
        y = y0 + corners[1, n]
        z = z0 + corners[2, n]
        inner = min(inner, x * x + y * y)
        outer = max(outer, x * x + y * y)
        low = min(low, z)
        high = max(high, z)
        tangent = (cx * y - cy * x) / (cx * x + cy * y)  # of the azimuth from the centre's
        left = min(left, tangent)
        right = max(right, tangent)
    if inner <= edge * edge:  # too close for these bounds
        return True
    inner = math.sqrt(inner - 0.25 * edge * edge)
    outer = math.sqrt(outer)
    top = _direction(high, inner if high > 0 else outer)
    bottom = _direction(low, outer if low > 0 else inner)
    row_from = int((view[2] - top) * view[3]) - 1
    row_to = int((view[2] - bottom) * view[3]) + 2
    azimuth = _direction(cy, cx) + math.pi
    first = int((azimuth + _direction(left, 1.0)) * view[4]) - 1
    last = int((azimuth + _direction(right, 1.0)) * view[4]) + 2
    for axis in range(3):
        squared += max(corner[axis], -corner[axis] - edge, 0.0) ** 2
    least = np.float32(max(math.sqrt(squared) - truncation - 1e-3, 1e-9))
    k = 0
    while k < WIDTHS - 1 and 2 << k <= last - first + 1:
        k += 1
    for row in range(max(row_from, 0), min(row_to, rows - 1) + 1):
        column = first
        while column <= last:
            at = min(column, last + 1 - (1 << k))
            at = at - columns if at >= columns else (at + columns if at < 0 else at)
            if table[k, row * columns + at] >= least:
                return True
            column += 1 << k
    return False


@njit(cache=True, nogil=True, parallel=True)
def in_view(blocks, chosen, edge, position, axes, view, table, truncation):
    """(K,) bool: whether a block may contain voxels that the image updates; conservative.

    Args:
        blocks: (B, 3) int64, indices of the blocks from the world's origin.
        chosen: (K,) int32, rows of ``blocks``.
        edge: edge of a block, metres.
        position, axes, view: as for ``pixels``.
        table: as from ``farthest``.
        truncation: voxels up to this far behind a surface are updated, metres.
    """
    radius = 0.8661 * edge
    highest = table[0].max()
    seen = np.zeros(len(chosen), np.bool_)
    corners = np.empty((3, 8))  # metres, sensor axes: from the first corner of a block
    for n in range(8):
        for axis in range(3):
            sides = (
                axes[axis, 0] * (n >> 2) + axes[axis, 1] * (n >> 1 & 1) + axes[axis, 2] * (n & 1)
            )
            corners[axis, n] = sides * edge
    for n in prange(len(chosen)):
        b = chosen[n]
        corner = (
            blocks[b, 0] * edge - position[0],
            blocks[b, 1] * edge - position[1],
            blocks[b, 2] * edge - position[2],
        )
        x = corner[0] + 0.5 * edge
        y = corner[1] + 0.5 * edge
        z = corner[2] + 0.5 * edge
        if math.sqrt(x * x + y * y + z * z) <= radius + highest + truncation:
            seen[n] = _shown(corner, edge, corners, axes, view, table, truncation)
    return seen


@njit(cache=True, nogil=True, inline="always")
def _places(needed, places):
    """Write the voxels of a block that have state to ``places``, in order; return their number."""
    n = np.int64(0)
    for w in range(8):
        if needed[w] == _FULL:
            for v in range(64):
                places[n + v] = 64 * w + v
            n += 64
        elif needed[w]:
            for v in range(64):
                if needed[w] >> np.uint64(v) & _ONE:
                    places[n] = 64 * w + v
                    n += 1
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def _project(corner, offsets, n, view, ranges, pixel):
    """Ranges and pixels (-1 if not in view) of n positions.

    Float32 without branches, so that it is vectorised.
    """
    x0 = np.float32(corner[0])
    y0 = np.float32(corner[1])
    z0 = np.float32(corner[2])
    rows = np.float32(view[0])
    columns = np.float32(view[1])
    top = np.float32(view[2])
    per_row = np.float32(view[3])
    per_column = np.float32(view[4])
    for i in range(n):
        x = x0 + offsets[0, i]
        y = y0 + offsets[1, i]
        z = z0 + offsets[2, i]
        flat = np.sqrt(x * x + y * y)
        ranges[i] = np.sqrt(x * x + y * y + z * z)
        row = np.floor((top - _angle(z, flat)) * per_row + _HALF)
        column = np.floor((_angle(y, x) + _PI) * per_column + _HALF)
        column = column - columns if column >= columns else column
        p = row * columns + column
        p = p if row >= _F0 else -_F1
        p = p if row < rows else -_F1
        pixel[i] = np.int32(p)


@njit(cache=True, nogil=True, error_model="numpy")
def _average(depths, ranges, n, trunc, below, most, distance, weight, flags):
    """Update n voxels; flags.

    Bit 0 is set if the image updates it, bit 1 if its distance is then under ``below``.
    """
    any_updated = False
    for i in range(n):
        depth = depths[i]
        old = distance[i]
        mass = np.float32(weight[i])
        behind = depth - ranges[i]
        seen = (depth > _F0) & (behind >= -trunc)
        mean = (old * mass + min(behind, trunc)) / (mass + _F1)
        distance[i] = mean if seen else old
        weight[i] += np.uint16(seen & (weight[i] < most))
        flags[i] = np.uint8(seen) | np.uint8(seen & (mean < below)) << np.uint8(1)
        any_updated |= seen
    return any_updated


@njit(cache=True, nogil=True, inline="always")
def _remember(flags, updated, near, observed):
    """Set and clear the bits of a block's voxels (8,) by flags (512,) as from ``_average``."""
    eights = flags.view(np.uint64)
    for w in range(8):
        seen = np.uint64(0)
        close = np.uint64(0)
        for v in range(8):  # the product moves the lowest bits of eight flags to the highest byte
            eight = eights[w << 3 | v]
            shift = np.uint64(v << 3)
            seen |= (eight & _LOWEST) * _TO_BYTE >> _TOP << shift
            close |= (eight >> _ONE & _LOWEST) * _TO_BYTE >> _TOP << shift
        updated[w] |= seen
        observed[w] |= seen
        near[w] = near[w] & ~seen | close


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def integrate(
    active, blocks, size, position, axes, offsets, view, image, truncation, near_below, most,
    needed, first, distance, weight, observed, near, updated, lanes,
):  # fmt: skip
    """Update the voxels of the active blocks with the distances from the image.

    Sets the bits of voxels ``observed`` so far, ``near`` (distance below ``near_below``) and
    ``updated`` in this frame.

    Args:
        active: (A,) int32, rows of ``blocks``.
        blocks: (B, 3) int64, indices of the blocks from the world's origin.
        size: edge of a voxel, metres.
        position, axes, view, image: as above.
        offsets: (3, 512) float32, metres, sensor axes: from a block's corner to the centres of its
            voxels.
        truncation, near_below: metres.
        most: maximum weight, observations.
        needed, first: voxels with state, as above.
        distance: float32, metres; weight: uint16, observations; both of all voxels with state.
            Modified.
    """
    trunc = np.float32(truncation)
    below = np.float32(near_below)
    heaviest = np.uint16(most)
    for lane in prange(lanes):
        places = np.empty(512, np.int32)
        pixel = np.empty(512, np.int32)
        flags = np.empty(512, np.uint8)
        marks = np.empty(512, np.uint8)
        ranges = np.empty(512, np.float32)
        depths = np.empty(512, np.float32)
        some = np.empty((3, 512), np.float32)
        corner = np.empty(3, np.float64)
        for a in range(lane, len(active), lanes):
            b = active[a]
            dx = blocks[b, 0] * 8 * size - position[0]
            dy = blocks[b, 1] * 8 * size - position[1]
            dz = blocks[b, 2] * 8 * size - position[2]
            for axis in range(3):
                corner[axis] = axes[axis, 0] * dx + axes[axis, 1] * dy + axes[axis, 2] * dz
            n = _places(needed[b], places)
            start = first[b]
            if n == 512:
                _project(corner, offsets, n, view, ranges, pixel)
            else:
                for i in range(n):
                    for axis in range(3):
                        some[axis, i] = offsets[axis, places[i]]
                _project(corner, some, n, view, ranges, pixel)
            for i in range(n):
                depths[i] = image[pixel[i]] if pixel[i] >= 0 else _F0
            own = distance[start : start + n]
            heavy = weight[start : start + n]
            if not _average(depths, ranges, n, trunc, below, heaviest, own, heavy, flags):
                continue
            if n < 512:
                marks[:] = 0
                for i in range(n):
                    marks[places[i]] = flags[i]
            _remember(flags if n == 512 else marks, updated[b], near[b], observed[b])
