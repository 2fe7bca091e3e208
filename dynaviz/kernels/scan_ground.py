"""The ground of one scan: the lowest layers of its points, and how steep they may be."""

import math

import numpy as np
from numba import njit, prange

FELLOWS = (
    3  # minimum number of cells among 5 x 5, itself included, that are not above a cell of ground
)
UNKNOWN = np.int16(32767)  # millimetres: height of a surface without ground around


@njit(cache=True, nogil=True, parallel=True)
def cells_of(points, position, most, edge):
    """The cells of points (N, 3) in a square raster around the sensor that contains them all, or is
    as wide as allowed.

    Its number of cells along each axis is a power of two; the sensor is in the first cell beyond
    the middle. Cell (i, j) of the raster is number i wide + j; keys (i, j) span [i, i + 1) * edge
    in the world.

    Args:
        points: (N, 3) float32, position: (3,) float64, metres, world frame.
        most: maximum number of cells to each side of the sensor, a power of two; edge: of a cell,
            metres.

    Returns:
        (N,) int32: the cell of each point, -1 outside; wide: cells along each axis; (2,) int64: key
        of the first cell.
    """
    farthest = np.float32(edge)
    x = np.float32(position[0])
    y = np.float32(position[1])
    for i in prange(len(points)):
        away = max(abs(points[i, 0] - x), abs(points[i, 1] - y))
        farthest = max(farthest, away if away < most * edge else np.float32(0))
    reach = most
    while reach > 2 and reach // 2 > math.ceil(farthest / edge):
        reach //= 2
    first = np.array(
        [
            np.int64(math.floor(position[0] / edge)) - reach,
            np.int64(math.floor(position[1] / edge)) - reach,
        ]
    )
    wide = 2 * reach
    cells = np.full(len(points), np.int32(-1))
    for p in prange(len(points)):
        if math.isfinite(points[p, 0] + points[p, 1] + points[p, 2]):
            i = math.floor(points[p, 0] / edge) - first[0]
            j = math.floor(points[p, 1] / edge) - first[1]
            if 0 <= i < wide and 0 <= j < wide:
                cells[p] = np.int32(i) * wide + np.int32(j)
    return cells, wide, first


@njit(cache=True, nogil=True)
def lowest(heights, cells, wide):
    """(wide, wide) float64, metres above the sensor: the lowest point of each cell.

    Infinite without points.

    Args:
        heights: (N,) float32, metres above the sensor.
        cells: (N,) int32, as from ``cells_of``; wide: cells along each axis.
    """
    low = np.full(wide * wide, np.inf)
    for i in range(len(cells)):
        if cells[i] >= 0:
            low[cells[i]] = min(low[cells[i]], np.float64(heights[i]))
    return low.reshape(wide, wide)


@njit(cache=True, nogil=True)
def lowest_layers(heights, cells, least, layer):
    """The mean height of the lowest layer of points in each cell, and the number of its points.

    One with less than a tenth of its cell's points is not ground: a few returns below it.

    Args:
        heights: (N,) float32, metres above the sensor.
        cells: (N,) int32, as from ``cells_of``.
        least: (X, X) float64, metres: lower points of a cell do not count.
        layer: height of a layer, metres.

    Returns:
        (X, X) float64, metres above the sensor, infinite without; and (X, X) int32.
    """
    shape = least.shape
    bounds = least.ravel()
    n = len(bounds)
    low = np.full(n, np.float32(np.inf))
    summed = np.zeros(n, np.int64)
    total = np.zeros(n, np.int32)
    number = np.zeros(n, np.int32)
    found = np.full(n, np.inf)
    for i in range(len(cells)):
        c = cells[i]
        if c >= 0 and heights[i] >= bounds[c]:
            low[c] = min(low[c], heights[i])
            total[c] += 1
    for i in range(len(cells)):
        c = cells[i]
        if c >= 0 and low[c] <= heights[i] < low[c] + layer:
            number[c] += 1
            summed[c] += np.int64(np.float64(heights[i]) * 1e6)  # integers: any order
    for c in range(n):
        if number[c] > 0 and 10 * number[c] >= total[c]:
            found[c] = summed[c] / (1e6 * number[c])
    return found.reshape(shape), number.reshape(shape)


@njit(cache=True, nogil=True)
def pits(surface, deep):
    """(X, Y) bool: cells that are reflections, not ground.

    They are more than ``deep`` below over three quarters of the known cells among the 5 x 5 cells
    around them, or below all but one of them: stray returns far below the ground have few known
    cells around. Unknown cells are infinite, and not reflections.
    """
    rows, columns = surface.shape
    found = np.zeros(surface.shape, np.bool_)
    for x in range(rows):
        for y in range(columns):
            if surface[x, y] == np.inf:
                continue
            around = 0
            level = 0
            for i in range(max(x - 2, 0), min(x + 3, rows)):
                for j in range(max(y - 2, 0), min(y + 3, columns)):
                    if surface[i, j] < np.inf:
                        around += 1
                        level += surface[i, j] <= surface[x, y] + deep
            found[x, y] = 4 * level < around or level < FELLOWS
    return found


@njit(cache=True, nogil=True)
def _lower(surface, step):
    """Lower a surface (X, Y), in place, until no cell is more than ``step`` above a neighbour, √2
    as much diagonally.

    The shortest way between two cells has steps of two adjacent directions at most: a sweep from
    either end is enough.
    """
    rows, columns = surface.shape
    slant = step * np.sqrt(2.0)
    for back in (-1, 1):
        for i in range(rows):
            x = i if back < 0 else rows - 1 - i
            for j in range(columns):
                y = j if back < 0 else columns - 1 - j
                z = surface[x, y]
                if 0 <= x + back < rows:
                    z = min(z, surface[x + back, y] + step)
                    if y > 0:
                        z = min(z, surface[x + back, y - 1] + slant)
                    if y < columns - 1:
                        z = min(z, surface[x + back, y + 1] + slant)
                if 0 <= y + back < columns:
                    z = min(z, surface[x, y + back] + step)
                surface[x, y] = z


@njit(cache=True, nogil=True)
def _rise(z, axis, steep, most):
    """Mean rise from cell to cell along an axis, where it is at most ``steep``.

    Limited to ``most``, up and down.
    """
    a, b = (z[:-1], z[1:]) if axis == 0 else (z[:, :-1], z[:, 1:])
    total = 0.0
    number = 0
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            rise = b[i, j] - a[i, j]
            if abs(rise) <= steep:  # not if both are infinite
                total = total + rise
                number = number + 1
    return min(max(total / max(number, 1), -most), most)


@njit(cache=True, nogil=True)
def surface_of(lowest, steep, step):
    """The highest surface (X, Y) not above cells (X, Y) that rises by at most ``step`` more than
    their mean incline.

    The incline is the mean rise from cell to cell, at most ``step`` as well, of adjacent cells that
    can both be ground: those that differ by at most ``steep`` in height.
    """
    u = _rise(lowest, 0, steep, step)
    v = _rise(lowest, 1, steep, step)
    plane = u * np.arange(len(lowest)).reshape(-1, 1) + v * np.arange(lowest.shape[1])
    surface = lowest - plane
    _lower(surface, step)
    return surface + plane


@njit(cache=True, nogil=True)
def lowered(surface, deep, step):
    """A surface (X, Y), lowered to deep cells (X, Y), and around them as far as ``step`` per cell
    reaches; cells that are not deep are infinite.
    """
    reached = deep.copy()
    _lower(reached, step)
    return np.minimum(surface, reached)


@njit(cache=True, nogil=True, parallel=True)
def above(points, lift, first, surface, edge):
    """(N,) float32, metres: height of points (N, 3) above a surface, interpolated between the
    centres of its cells.

    Points outside get that of the border; points that are not finite, and all over unknown cells,
    are infinitely high.

    Args:
        lift: metres, added to the surface; first: (2,) int64, its first cell; edge: of a cell,
            metres.
        surface: (X, X) int16, millimetres; 32767 where unknown.
    """
    found = np.full(len(points), np.float32(np.inf))
    wide = surface.shape[0]
    per_metre = 1.0 / edge
    for i in prange(len(points)):
        if math.isfinite(points[i, 0] + points[i, 1] + points[i, 2]):
            u = min(max(points[i, 0] * per_metre - 0.5 - first[0], 0.0), wide - 1.0)
            v = min(max(points[i, 1] * per_metre - 0.5 - first[1], 0.0), wide - 1.0)
            x = min(np.int64(u), wide - 2)
            y = min(np.int64(v), wide - 2)
            u = u - x
            v = v - y
            a = surface[x, y]
            b = surface[x + 1, y]
            c = surface[x, y + 1]
            d = surface[x + 1, y + 1]
            if max(a, b, c, d) < UNKNOWN:
                z = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
                found[i] = points[i, 2] - lift - z / 1000
    return found


@njit(cache=True, nogil=True)
def bands(heights, exact, low, highest):
    """(N,) uint8: 0 for points on the ground, 1 for others near it, 3 for those that are too high,
    2 for the rest.

    Args:
        heights: (N,) float32, metres above the ground, infinite if unknown, which is not too high.
        exact, low, highest: float32, metres: points up to ``low`` are near the ground, and on it up
            to ``exact``.
    """
    found = np.empty(len(heights), np.uint8)
    for i in range(len(heights)):
        h = heights[i]
        near = np.uint8(h > exact)
        above = np.uint8(2) + np.uint8((h > highest) & (h < np.inf))
        found[i] = near if h <= low else above
    return found


@njit(cache=True, nogil=True)
def plane(x, y, z, weight, start, flat, exact, rounds):
    """(3,) float64: the plane c + a x + b y through most points (K,) each.

    Iterated least squares, which tend to L1.

    Args:
        x, y, z, weight: (K,) float64, metres, and without unit.
        start: (3,) float64, the first guess of c, a and b.
        flat: square metres: weight of a = b = 0, so that a few cells near the origin do not tilt
            the plane.
        exact: metres: cells that fit worse count less, in inverse proportion.
        rounds: number of iterations.
    """
    c = start[0]
    a = start[1]
    b = start[2]
    for _ in range(rounds):
        m = np.zeros((3, 4))
        m[0, 0] = 1e-6
        m[1, 1] = flat
        m[2, 2] = flat
        for k in range(len(x)):
            w = weight[k] / max(abs(z[k] - c - a * x[k] - b * y[k]), exact)
            row = (1.0, x[k], y[k], z[k])
            for i in range(3):
                for j in range(4):
                    m[i, j] += w * row[i] * row[j]
        for i in range(3):  # the matrix is positive definite: no pivots
            for k in range(3):
                if k != i:
                    share = m[k, i] / m[i, i]
                    for j in range(4):
                        m[k, j] -= share * m[i, j]
        c = m[0, 3] / m[0, 0]
        a = m[1, 3] / m[1, 1]
        b = m[2, 3] / m[2, 2]
    return np.array([c, a, b])
