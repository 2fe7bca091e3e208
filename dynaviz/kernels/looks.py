"""What a scan saw at some places: tables of the directions and ranges of its returns.

A direction is stored as two numbers of 16 bits without trigonometry: the place on a square around
the vertical axis, which grows with the azimuth, and the sine of the elevation.
"""

import math

import numpy as np
from numba import njit

from dynaviz.arrays import F32, F64, U8, U16

HIT = 0
THROUGH = 1
GRAZING = 2  # through, at a small angle to the surface of the place
HIDDEN = 3
BETWEEN = 4
OUTSIDE = 5
KINDS = 6

QUARTER = 16384.0  # steps of the first number in a quarter of a turn
HALF = 32768.0  # steps of the second number between level and upright
FULL = 65536
NEAREST = 4  # returns around a direction that answer for it
COARSE = 8  # bits that the cells of "around" leave out
FEWEST = 6  # bits that the cells of directions leave out, which bounds their number
LEAST_RANGE = 0.05  # metres: nearer "returns" are none


@njit(cache=True, nogil=True, inline="always")
def _turn(x: float, y: float) -> float:
    """From 0 to 4, growing with the azimuth; 0 along a vertical."""
    sum_ = abs(x) + abs(y)
    if sum_ == 0.0:
        return 0.0
    if y >= 0.0:
        return y / sum_ if x >= 0.0 else 1.0 - x / sum_
    return 2.0 - y / sum_ if x < 0.0 else 3.0 + x / sum_


@njit(cache=True, nogil=True, inline="always")
def _way(turn: np.uint16, rise: np.uint16) -> tuple[float, float, float]:
    """The unit vector of a stored direction."""
    z = (float(rise) + 0.5) / HALF - 1.0
    p = (float(turn) + 0.5) / QUARTER
    quarter = int(p)
    f = p - quarter
    if quarter == 0:
        x = 1.0 - f
        y = f
    elif quarter == 1:
        x = -f
        y = 1.0 - f
    elif quarter == 2:
        x = f - 1.0
        y = -f
    else:
        x = f
        y = f - 1.0
    flat = math.sqrt(max(1.0 - z * z, 0.0) / (x * x + y * y))
    return x * flat, y * flat, z


@njit(cache=True, nogil=True)
def table(points: F32, origin: F64) -> tuple[U16, F32]:
    """Directions and ranges of the returns of a scan, seen from a place.

    Args:
        points: (N, 3) float32, metres; those that are not finite, or at the place, are left out.
        origin: (3,) float64, metres: the place.

    Returns:
        ways: (M, 2) uint16, directions.
        ranges: (M,) float32, metres.
    """
    ways = np.empty((len(points), 2), np.uint16)
    ranges = np.empty(len(points), np.float32)
    m = 0
    for i in range(len(points)):
        x = points[i, 0] - origin[0]
        y = points[i, 1] - origin[1]
        z = points[i, 2] - origin[2]
        r = math.sqrt(x * x + y * y + z * z)
        if not LEAST_RANGE <= r < 1e9:
            continue
        ways[m, 0] = np.uint16(int(_turn(x, y) * QUARTER) & (FULL - 1))
        ways[m, 1] = np.uint16(min(int((z / r + 1.0) * HALF), FULL - 1))
        ranges[m] = r
        m += 1
    return ways[:m].copy(), ranges[:m].copy()


@njit(cache=True, nogil=True)
def points_of(ways: U16, ranges: F32, origin: F64) -> F32:
    """(M, 3) float32, metres: the inverse of ``table``."""
    points = np.empty((len(ways), 3), np.float32)
    for i in range(len(ways)):
        x, y, z = _way(ways[i, 0], ways[i, 1])
        points[i, 0] = origin[0] + x * ranges[i]
        points[i, 1] = origin[1] + y * ranges[i]
        points[i, 2] = origin[2] + z * ranges[i]
    return points


@njit(cache=True, nogil=True)
def spacings(ways: U16, step: int) -> F64:
    """(K,) float64: from every ``step``-th direction to the third nearest other one.

    As chords of the unit sphere, in radians for small ones; infinite with fewer directions.
    """
    vectors = np.empty((len(ways), 3), np.float32)
    for i in range(len(ways)):
        x, y, z = _way(ways[i, 0], ways[i, 1])
        vectors[i, 0] = x
        vectors[i, 1] = y
        vectors[i, 2] = z
    found = np.empty((len(ways) + step - 1) // step)
    for k in range(len(found)):
        best = np.full(NEAREST, np.inf)
        mine = vectors[k * step]
        for i in range(len(ways)):
            dx = vectors[i, 0] - mine[0]
            dy = vectors[i, 1] - mine[1]
            dz = vectors[i, 2] - mine[2]
            gap = dx * dx + dy * dy + dz * dz
            if gap < best[NEAREST - 1]:
                n = NEAREST - 1
                while n > 0 and best[n - 1] > gap:
                    best[n] = best[n - 1]
                    n -= 1
                best[n] = gap
        found[k] = math.sqrt(best[NEAREST - 1])
    return found


@njit(cache=True, nogil=True, inline="always")
def _reach(z: float, angle: float) -> tuple[int, int]:
    """Half the sizes of the window of stored numbers around a direction, given its sine of the
    elevation.
    """
    flat = math.sqrt(max(1.0 - z * z, 0.0))
    rise = int(angle * HALF) + 2
    if 2.0 * angle >= flat:
        return FULL // 2, rise
    return min(int(1.05 * angle / flat * QUARTER) + 2, FULL // 2), rise


@njit(cache=True, nogil=True, inline="always")
def _bits(size: float) -> int:
    """The number of bits of the smallest power of two that is at least ``size``."""
    bits = 0
    while (1 << bits) < size:
        bits += 1
    return bits


@njit(cache=True, nogil=True)
def look(
    ways: U16,
    ranges: F32,
    origin: F64,
    asked: F32,
    normals: F32,
    cap: float,
    around: float,
    margin: float,
    steep: float,
    kinds: U8,
    beyond: F32,
) -> None:
    """What the returns of a scan say about places; the best of this and of earlier answers.

    The four nearest returns within ``cap`` of the direction to a place answer: one of them ends at
    the place (hit), ends beyond it (through), or all end before it (hidden). Without any, returns
    within ``around`` tell whether the place lies between rays or outside of the field of view.

    Args:
        ways, ranges, origin: of a scan, from ``table``.
        asked: (K, 3) float32, metres: the places.
        normals: (K, 3) float32: of the surface at each place; NaN if unknown.
        cap: largest angle between the direction to a place and a return that answers, radians.
        around: largest angle to a return that surrounds it, radians.
        margin: a return that ends so far before or behind a place ends at it, metres.
        steep: sine of the angle below which a ray that passes a surface is grazing.
        kinds: (K,) uint8, one of the kinds above; lower ones stay. Modified.
        beyond: (K,) float32, metres: how far behind the place the nearest passing ray ended.
            Modified.
    """
    high_bits = max(_bits(cap * HALF / 3), FEWEST)
    wide_bits = max(_bits(cap * QUARTER / 3), FEWEST)
    columns = FULL >> wide_bits
    rows = FULL >> high_bits
    coarse = FULL >> COARSE
    # the cells in which a place looks for returns
    looked = np.zeros(rows * columns, np.bool_)
    vectors = np.empty((len(asked), 4))
    windows = np.empty((len(asked), 4), np.int32)
    for k in range(len(asked)):
        x = asked[k, 0] - origin[0]
        y = asked[k, 1] - origin[1]
        z = asked[k, 2] - origin[2]
        r = max(math.sqrt(x * x + y * y + z * z), 1e-9)
        x /= r
        y /= r
        z /= r
        vectors[k, 0] = x
        vectors[k, 1] = y
        vectors[k, 2] = z
        vectors[k, 3] = r
        turn = int(_turn(x, y) * QUARTER)
        rise = int((z + 1.0) * HALF)
        wide, high = _reach(z, cap)
        windows[k, 0] = (turn - wide) >> wide_bits
        windows[k, 1] = min((turn + wide) >> wide_bits, windows[k, 0] + columns - 1)
        windows[k, 2] = max((rise - high) >> high_bits, 0)
        windows[k, 3] = min((rise + high) >> high_bits, rows - 1)
        for row in range(windows[k, 2], windows[k, 3] + 1):
            for column in range(windows[k, 0], windows[k, 1] + 1):
                looked[row * columns + (column & (columns - 1))] = True
    # the returns of these cells, in the order of cells
    starts = np.zeros(rows * columns + 1, np.int32)
    occupied = np.zeros(coarse * coarse, np.bool_)
    for i in range(len(ways)):
        occupied[(int(ways[i, 1]) >> COARSE) * coarse + (int(ways[i, 0]) >> COARSE)] = True
        cell = (int(ways[i, 1]) >> high_bits) * columns + (int(ways[i, 0]) >> wide_bits)
        if looked[cell]:
            starts[cell + 1] += 1
    for cell in range(rows * columns):
        starts[cell + 1] += starts[cell]
    members = np.empty((starts[rows * columns], 4), np.float32)
    filled = starts.copy()
    for i in range(len(ways)):
        cell = (int(ways[i, 1]) >> high_bits) * columns + (int(ways[i, 0]) >> wide_bits)
        if looked[cell]:
            at = filled[cell]
            members[at, 0], members[at, 1], members[at, 2] = _way(ways[i, 0], ways[i, 1])
            members[at, 3] = ranges[i]
            filled[cell] += 1
    best = np.empty(NEAREST)
    ends = np.empty(NEAREST)
    for k in range(len(asked)):
        x = vectors[k, 0]
        y = vectors[k, 1]
        z = vectors[k, 2]
        r = vectors[k, 3]
        for n in range(NEAREST):
            best[n] = cap * cap
            ends[n] = -1.0
        for row in range(windows[k, 2], windows[k, 3] + 1):
            for column in range(windows[k, 0], windows[k, 1] + 1):
                cell = row * columns + (column & (columns - 1))
                for at in range(starts[cell], starts[cell + 1]):
                    dx = members[at, 0] - x
                    dy = members[at, 1] - y
                    dz = members[at, 2] - z
                    gap = dx * dx + dy * dy + dz * dz
                    if gap >= best[NEAREST - 1]:
                        continue
                    n = NEAREST - 1
                    while n > 0 and best[n - 1] > gap:
                        best[n] = best[n - 1]
                        ends[n] = ends[n - 1]
                        n -= 1
                    best[n] = gap
                    ends[n] = members[at, 3]
        kind = OUTSIDE
        passed = np.inf
        if ends[0] >= 0.0:
            kind = HIDDEN
            for n in range(NEAREST):
                if ends[n] < 0.0:
                    break
                if abs(ends[n] - r) < margin:
                    kind = HIT
                elif ends[n] > r and passed == np.inf:
                    passed = ends[n] - r
            if kind != HIT and passed < np.inf:
                kind = THROUGH
                slope = abs(x * normals[k, 0] + y * normals[k, 1] + z * normals[k, 2])
                if slope < steep:  # never where the normal is unknown
                    kind = GRAZING
        elif _is_near(occupied, coarse, x, y, z, around):
            kind = BETWEEN
        if kind < kinds[k]:
            kinds[k] = kind
            beyond[k] = passed


@njit(cache=True, nogil=True)
def _is_near(occupied, coarse, x, y, z, around):
    """Whether a cell with returns lies within an angle of a direction."""
    turn = int(_turn(x, y) * QUARTER)
    rise = int((z + 1.0) * HALF)
    wide, high = _reach(z, around)
    first = (turn - wide) >> COARSE
    last = min((turn + wide) >> COARSE, first + coarse - 1)
    half = 1 << (COARSE - 1)
    for row in range(max((rise - high) >> COARSE, 0), min((rise + high) >> COARSE, coarse - 1) + 1):
        for column in range(first, last + 1):
            if occupied[row * coarse + (column & (coarse - 1))]:
                vx, vy, vz = _way(
                    np.uint16(((column & (coarse - 1)) << COARSE) + half),
                    np.uint16((row << COARSE) + half),
                )
                if (vx - x) ** 2 + (vy - y) ** 2 + (vz - z) ** 2 <= around * around:
                    return True
    return False
