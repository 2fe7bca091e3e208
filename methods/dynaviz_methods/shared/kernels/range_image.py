"""Range images: the nearest point of each pixel, and the points that scans see past.

Points are (3, M) float32, metres, world frame, so that the arithmetic is vectorised. Angles are
float32 first; points so close to the border of a pixel that rounding matters are projected again in
float64. The pixel is thus always that of float64.

Several images of the same view at different resolutions form one flat array; ``views`` has one row
for each: rows, columns, row at elevation 0, rows per radian, column at azimuth 0, columns per
radian, index of its first pixel.

``chunks`` (C, 2) int64 are the points to project, as [first, end), at most ``CHUNK`` each. Points
farther than ``reach``, metres, are ignored.
"""

import math

import numpy as np
from numba import njit, prange

CHUNK = 1024  # points projected at once
_STEEP = np.float32(0.1)  # azimuths need float64 below this sine of the angle to the vertical
_ANGLE_ERROR = 2e-6  # radians; at least twice the error of float32
_DOUBT = -2  # marks a pixel to compute in float64
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
    high = max(a, b)
    low = min(a, b)
    t = low / max(high, np.float32(1e-30))
    s = t * t
    p = _A13 + s * _A15
    p = _A11 + s * p
    p = _A9 + s * p
    p = _A7 + s * p
    p = _A5 + s * p
    p = _A3 + s * p
    p = _A1 + s * p
    p = t * (_F1 + s * p)
    p = _HALF_PI - p if b > a else p
    p = _PI - p if x < _F0 else p
    return -p if y < _F0 else p


@njit(cache=True, nogil=True)
def _exact_pixel(xyz, i, position, axes, view, clamp):
    """The pixel of one point, computed in float64; -1 if outside."""
    dx = xyz[0, i] - position[0]
    dy = xyz[1, i] - position[1]
    dz = xyz[2, i] - position[2]
    x = axes[0, 0] * dx + axes[0, 1] * dy + axes[0, 2] * dz
    y = axes[1, 0] * dx + axes[1, 1] * dy + axes[1, 2] * dz
    z = axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz
    row = math.floor(view[2] - math.atan2(z, math.hypot(x, y)) * view[3] + 0.5)
    column = math.floor(view[4] + math.atan2(y, x) * view[5] + 0.5)
    if not clamp and not (0 <= row <= view[0] and 0 <= column <= view[1]):
        return -1
    row = min(max(row, 0), view[0] - 1)
    column = min(max(column, 0), view[1] - 1)
    return np.int32(view[6] + row * view[1] + column)


@njit(cache=True, nogil=True)
def _buffers(images):
    """Buffers for the pixels, ranges and angles of a chunk."""
    return (
        np.empty((images, CHUNK), np.int32),
        np.empty(CHUNK, np.float32),
        np.empty((3, CHUNK), np.float32),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _project(xyz, first, last, position, axes, views, clamp, pixels, ranges, polar):
    """Write the ranges and pixels of points first ... last - 1 to the buffers.

    A pixel is -1 if the point is out of view, not finite, or at the sensor's position. With
    ``clamp``, points out of view go to the border instead. The long loops have no branches, so that
    the compiler can vectorise them.
    """
    n = last - first
    px = position[0]
    py = position[1]
    pz = position[2]
    r00 = np.float32(axes[0, 0])
    r01 = np.float32(axes[0, 1])
    r02 = np.float32(axes[0, 2])
    r10 = np.float32(axes[1, 0])
    r11 = np.float32(axes[1, 1])
    r12 = np.float32(axes[1, 2])
    r20 = np.float32(axes[2, 0])
    r21 = np.float32(axes[2, 1])
    r22 = np.float32(axes[2, 2])
    for i in range(n):
        dx = np.float32(xyz[0, first + i] - px)
        dy = np.float32(xyz[1, first + i] - py)
        dz = np.float32(xyz[2, first + i] - pz)
        x = r00 * dx + r01 * dy + r02 * dz
        y = r10 * dx + r11 * dy + r12 * dz
        z = r20 * dx + r21 * dy + r22 * dz
        flat = np.sqrt(x * x + y * y)
        r = np.sqrt(dx * dx + dy * dy + dz * dz)
        ranges[i] = r
        polar[0, i] = _angle(y, x)
        polar[1, i] = _angle(z, flat)
        # Below 0 if the azimuth is uncertain, or if an error would lead to the other end of the
        # image.
        polar[2, i] = min(flat - _STEEP * r, _PI - np.float32(_ANGLE_ERROR) - abs(polar[0, i]))
    for k in range(len(views)):
        rows = np.float32(views[k, 0])
        columns = np.float32(views[k, 1])
        row0 = np.float32(views[k, 2])
        per_row = np.float32(views[k, 3])
        column0 = np.float32(views[k, 4])
        per_column = np.float32(views[k, 5])
        doubt = np.float32(
            _ANGLE_ERROR * max(views[k, 3], views[k, 5]) + 4e-7 * max(views[k, 0], views[k, 1])
        )
        start = np.int32(views[k, 6])
        width = np.int32(views[k, 1])
        for i in range(n):
            row = row0 - polar[1, i] * per_row + _HALF
            column = column0 + polar[0, i] * per_column + _HALF
            row_below = np.floor(row)
            column_below = np.floor(column)
            row_part = row - row_below
            column_part = column - column_below
            lowest = min(min(row_part, _F1 - row_part), min(column_part, _F1 - column_part))
            inside = (
                (row_below >= _F0)
                & (row_below <= rows)
                & (column_below >= _F0)
                & (column_below <= columns)
            )
            row_below = min(max(row_below, _F0), rows - _F1)
            column_below = min(max(column_below, _F0), columns - _F1)
            pixel = start + np.int32(row_below) * width + np.int32(column_below)
            pixel = pixel if inside | clamp else np.int32(-1)
            pixel = np.int32(_DOUBT) if (lowest < doubt) | (polar[2, i] < _F0) else pixel
            pixels[k, i] = (
                pixel if (ranges[i] > _F0) & (ranges[i] < np.float32(np.inf)) else np.int32(-1)
            )
        for i in range(n):
            if pixels[k, i] == _DOUBT:
                pixels[k, i] = _exact_pixel(xyz, first + i, position, axes, views[k], clamp)


@njit(cache=True, nogil=True, parallel=True)
def nearest(xyz, chunks, reach, position, axes, views, clamp, lanes, least):
    """The nearest point of each pixel: ranges (P,) float32, metres, infinite if empty.

    Indices (P,) int32, -1 if empty.

    Of points at the same range the first counts, for any number of lanes; none nearer than
    ``least``, metres.
    """
    m = len(chunks)
    last = len(views) - 1
    size = int(views[last, 6] + views[last, 0] * views[last, 1])
    ranges = np.full((lanes, size), np.float32(np.inf))
    indices = np.full((lanes, size), np.int32(-1))
    for lane in prange(lanes):
        pixels, near, polar = _buffers(len(views))
        for c in range(m * lane // lanes, m * (lane + 1) // lanes):
            first = chunks[c, 0]
            n = chunks[c, 1] - chunks[c, 0]
            _project(xyz, first, first + n, position, axes, views, clamp, pixels, near, polar)
            for k in range(len(views)):
                for i in range(n):
                    pixel = pixels[k, i]
                    if pixel >= 0 and least <= near[i] < ranges[lane, pixel] and near[i] <= reach:
                        ranges[lane, pixel] = near[i]
                        indices[lane, pixel] = first + i
    for lane in range(1, lanes):
        for pixel in range(size):
            if ranges[lane, pixel] < ranges[0, pixel]:
                ranges[0, pixel] = ranges[lane, pixel]
                indices[0, pixel] = indices[lane, pixel]
    return ranges[0], indices[0]


@njit(cache=True, nogil=True)
def pixels_of(xyz, position, axes, views, clamp):
    """The pixel of each point in each image (K, M) int32, -1 if none.

    Ranges (M,) float32, metres.
    """
    n = xyz.shape[1]
    found = np.empty((len(views), n), np.int32)
    ranges = np.empty(n, np.float32)
    pixels, near, polar = _buffers(len(views))
    for first in range(0, n, CHUNK):
        last = min(first + CHUNK, n)
        _project(xyz, first, last, position, axes, views, clamp, pixels, near, polar)
        for i in range(last - first):
            ranges[first + i] = near[i]
        for k in range(len(views)):
            for i in range(last - first):
                found[k, first + i] = pixels[k, i]
    return found, ranges


@njit(cache=True, nogil=True, parallel=True)
def judge(xyz, chunks, reach, position, axes, views, clamp, limits, spread, past, met):
    """Compare the map points with one scan, and set flags for each point.

    Args:
        limits: (P,) float32, metres: the scan sees past points closer than this; 0 in pixels
            without return. Points from limits to limits * spread are on the scan's surface.
        past: (M,) uint8: bit k is set if the scan sees past the point at resolution k. Modified.
        met: (M,) uint8, for the first resolution: bit 0 is set if the pixel has a return, bit 1 if
            the point is on the surface, bit 2 if it was on the surface of an earlier scan.
            Modified.
    """
    for c in prange(len(chunks)):
        pixels, near, polar = _buffers(len(views))
        first = chunks[c, 0]
        n = chunks[c, 1] - chunks[c, 0]
        _project(xyz, first, first + n, position, axes, views, clamp, pixels, near, polar)
        for k in range(len(views)):
            for i in range(n):
                limit = limits[pixels[k, i]] if pixels[k, i] >= 0 and near[i] <= reach else _F0
                if near[i] < limit:
                    past[first + i] |= np.uint8(1 << k)
                if k == 0 and limit > 0:
                    on_surface = limit <= near[i] <= limit * spread
                    met[first + i] |= np.uint8(
                        1 | (2 | (met[first + i] & 2) << 1 if on_surface else 0)
                    )
