"""Ground height under a map: the densest layer near the lowest points of each column, and a smooth surface below.

A column is 8 x 8 voxels wide, like a block; a layer is one voxel high. Blocks are sorted by x, y and z, so those of a
column are consecutive.
"""

import math

import numpy as np
from numba import njit, prange

LEAST = 3  # minimum number of points in a layer
SHARE = 0.03  # minimum share of a column's points in a layer; reflections below the ground are fewer
FELLOWS = 3  # minimum number of cells among 5 x 5, itself included, that are not above a cell of ground
RISE = 3  # the ground is searched in this many layers above the first
NEARLY = 1e-9  # metres: a surface that is lowered by less is not lowered
SQUARES = 64  # cells to each side of the sensor in which heights are levelled
THIN = 100  # layers per metre in which the densest one of a scan is searched


@njit(cache=True, nogil=True)
def add(voxels, points, number, height, column, stale):
    """Add points to the layers of blocks, and mark their columns as stale.

    Args:
        voxels: (N,) int64, the voxel of each point, -1 for none.
        points: (N, 3) float32, metres.
        number, height: (B, 8), number of points in each layer, and the sum of their heights in mm. Modified.
        column: (B + 1,), the column of each block.
        stale: (all columns + 1,) bool. Modified.
    """
    for i in range(len(voxels)):
        if voxels[i] >= 0:
            block, layer = voxels[i] >> 9, voxels[i] & 7
            number[block, layer] += 1
            height[block, layer] += np.int64(np.round(np.float64(points[i, 2]) * 1000.0))  # integers: any order
            stale[column[block]] = True


@njit(cache=True, nogil=True, parallel=True)
def quarters(voxels, column):
    """(N,) int64: four times the column that contains each voxel, plus the number of its quarter; the last is for -1.

    Args:
        voxels: (N,) int64, -1 for none.
        column: (B + 1,), the column of each block; the last is for -1.
    """
    found = np.empty(len(voxels), np.int64)
    for i in prange(len(voxels)):
        found[i] = column[voxels[i] >> 9] << 2 | (voxels[i] >> 8 & 1) << 1 | voxels[i] >> 5 & 1
    return found


@njit(cache=True, nogil=True, parallel=True)
def floors(columns, starts, blocks, number, height, floor):
    """Compute the floor of some columns.

    Args:
        columns: (K,) int64, the columns.
        starts: (C + 1,) int64, the first block of each column, and the end.
        blocks: (B, 3) int64, keys of the blocks.
        number, height: (B, 8), as filled by ``add``.
        floor: (C,) float64, metres; infinite for columns with too few points. Modified.
    """
    for k in prange(len(columns)):
        c = columns[k]
        first, last = starts[c], starts[c + 1]
        total = number[first:last].sum()
        least = max(LEAST, int(SHARE * total))
        floor[c] = np.inf
        below, below_sum, below_at = np.int64(0), np.int64(0), np.int64(-(1 << 40))  # the layer under this one
        bottom, most = np.int64(1 << 40), np.int64(0)
        for b in range(first, last):
            for layer in range(8):
                at = np.int64(blocks[b, 2]) << 3 | layer
                n, total_height = np.int64(number[b, layer]), height[b, layer]
                if n == 0 and below_at != at - 1:
                    continue
                pair, pair_sum = n, total_height
                if below_at == at - 1:
                    pair, pair_sum = n + below, total_height + below_sum
                if pair >= least and bottom > at:
                    bottom = at
                if bottom <= at <= bottom + RISE and pair > most:
                    most = pair
                    floor[c] = pair_sum / (1000.0 * pair)
                below, below_sum, below_at = n, total_height, at
            if bottom + RISE < np.int64(blocks[b, 2]) << 3:
                break


@njit(cache=True, nogil=True, parallel=True)
def pits(surface, deep):
    """(X, Y) bool: cells that are reflections, not ground.

    They are more than ``deep`` below over three quarters of the known cells among the 5 x 5 cells around them, or below
    all but one of them: stray returns far below the ground have few known cells around. Unknown cells are infinite, and
    not reflections.
    """
    rows, columns = surface.shape
    found = np.zeros(surface.shape, np.bool_)
    for x in prange(rows):
        for y in range(columns):
            if surface[x, y] == np.inf:
                continue
            around, level = 0, 0
            for i in range(max(x - 2, 0), min(x + 3, rows)):
                for j in range(max(y - 2, 0), min(y + 3, columns)):
                    if surface[i, j] < np.inf:
                        around += 1
                        level += surface[i, j] <= surface[x, y] + deep
            found[x, y] = 4 * level < around or level < FELLOWS
    return found


@njit(cache=True, nogil=True)
def inclines(surface, first, wide, steep, most):
    """(X, Y, 2) float64, metres: the mean rise of a surface (X, Y) from cell to cell around each cell, along x and y.

    The mean is over the adjacent known cells in 3 x 3 squares, the cell being in the middle one. 0 without such cells.

    Args:
        surface: (X, Y) float64, metres; infinite where unknown.
        first: (2,) int64, key of the first cell, from which squares are counted.
        wide: edge of a square, cells.
        steep: metres: adjacent cells whose heights differ by more are not both ground.
        most: metres: maximum rise in the steepest direction.
    """
    rows, columns = surface.shape
    west, south = first[0] // wide, first[1] // wide
    squares = (first[0] + rows - 1) // wide - west + 3, (first[1] + columns - 1) // wide - south + 3
    total, number = np.zeros((*squares, 2)), np.zeros((*squares, 2))  # with a border of one square
    for x in range(rows):
        for y in range(columns):
            z, a, b = surface[x, y], (first[0] + x) // wide - west + 1, (first[1] + y) // wide - south + 1
            if x < rows - 1 and abs(surface[x + 1, y] - z) <= steep:  # not a number if both are unknown
                total[a, b, 0] += surface[x + 1, y] - z
                number[a, b, 0] += 1
            if y < columns - 1 and abs(surface[x, y + 1] - z) <= steep:
                total[a, b, 1] += surface[x, y + 1] - z
                number[a, b, 1] += 1
    mean, found = np.zeros(total.shape), np.empty((rows, columns, 2))
    for a in range(1, squares[0] - 1):
        for b in range(1, squares[1] - 1):
            for axis in range(2):
                around = number[a - 1 : a + 2, b - 1 : b + 2, axis].sum()
                mean[a, b, axis] = total[a - 1 : a + 2, b - 1 : b + 2, axis].sum() / max(around, 1.0)
            mean[a, b] *= most / max(most, math.sqrt(mean[a, b, 0] ** 2 + mean[a, b, 1] ** 2))
    for x in range(rows):
        for y in range(columns):
            found[x, y] = mean[(first[0] + x) // wide - west + 1, (first[1] + y) // wide - south + 1]
    return found


@njit(cache=True, nogil=True)
def lower(surface, incline, step):
    """Lower a surface (X, Y), in place, until no cell is more than ``step`` beyond the incline above any neighbour.

    A diagonal neighbour allows √2 times as much. The incline between two cells is the mean of theirs, (X, Y, 2). None
    may be steeper than ``step``: then no cell must be below its neighbour, and this ends.
    """
    rows, columns = surface.shape
    slant, half, lowered = step * np.sqrt(2.0), incline / 2, True
    while lowered:
        lowered = False
        for x in range(rows):
            for y in range(columns):
                before = z = surface[x, y]
                u, v = half[x, y]
                if x > 0:
                    z = min(z, surface[x - 1, y] + step + u + half[x - 1, y, 0])
                    if y > 0:
                        there = half[x - 1, y - 1]
                        z = min(z, surface[x - 1, y - 1] + slant + u + v + (there[0] + there[1]))
                    if y < columns - 1:
                        there = half[x - 1, y + 1]
                        z = min(z, surface[x - 1, y + 1] + slant + u - v + there[0] - there[1])
                if y > 0:
                    z = min(z, surface[x, y - 1] + step + v + half[x, y - 1, 1])
                if z < before - NEARLY:
                    surface[x, y], lowered = z, True
        for x in range(rows - 1, -1, -1):
            for y in range(columns - 1, -1, -1):
                before = z = surface[x, y]
                u, v = half[x, y]
                if x < rows - 1:
                    z = min(z, surface[x + 1, y] + step - u - half[x + 1, y, 0])
                    if y > 0:
                        there = half[x + 1, y - 1]
                        z = min(z, surface[x + 1, y - 1] + slant - u + v - there[0] + there[1])
                    if y < columns - 1:
                        there = half[x + 1, y + 1]
                        z = min(z, surface[x + 1, y + 1] + slant - u - v - (there[0] + there[1]))
                if y < columns - 1:
                    z = min(z, surface[x, y + 1] + step - v - half[x, y + 1, 1])
                if z < before - NEARLY:
                    surface[x, y], lowered = z, True


@njit(cache=True, nogil=True)
def spanned(voxels, column, columns):
    """(2, 2) int64: the lowest and highest keys of the columns that contain voxels.

    The last column is for voxels -1. Without others, the lowest key is above the highest.
    """
    seen = np.zeros(len(columns) + 1, np.bool_)
    for i in range(len(voxels)):
        seen[column[voxels[i] >> 9]] = True
    bounds = np.empty((2, 2), np.int64)
    bounds[0], bounds[1] = 1 << 40, -(1 << 40)
    for c in range(len(columns)):
        if seen[c]:
            for axis in range(2):
                bounds[0, axis] = min(bounds[0, axis], columns[c, axis])
                bounds[1, axis] = max(bounds[1, axis], columns[c, axis])
    return bounds


@njit(cache=True, nogil=True)
def surface(columns, floor, low, high):
    """(X, Y) float64, metres: the floors (C,) of the columns from key ``low`` to key ``high``, infinite elsewhere."""
    found = np.full((high[0] - low[0] + 1, high[1] - low[1] + 1), np.inf)
    for c in range(len(columns)):
        x, y = columns[c, 0] - low[0], columns[c, 1] - low[1]
        if floor[c] < np.inf and 0 <= x < found.shape[0] and 0 <= y < found.shape[1]:
            found[x, y] = floor[c]
    return found


@njit(cache=True, nogil=True, parallel=True)
def heights(points, voxels, column, columns, first, surface, edge):
    """(N,) float32, metres: height of points (N, 3) above a surface whose first cell is column ``first``.

    The surface is interpolated between the centres of its cells, which are ``edge`` metres wide. Infinite for voxels
    -1, outside the surface, and where the surface is infinite.
    """
    found = np.empty(len(voxels), np.float32)
    rows, lines = surface.shape
    for i in prange(len(voxels)):
        found[i] = np.inf
        c = column[voxels[i] >> 9]
        if c == len(columns):
            continue
        x, y = columns[c, 0] - first[0], columns[c, 1] - first[1]
        if not (0 <= x < rows and 0 <= y < lines):
            continue
        u, v = points[i, 0] / edge - 0.5 - first[0], points[i, 1] / edge - 0.5 - first[1]
        u, v = min(max(u, 0.0), rows - 1.0), min(max(v, 0.0), lines - 1.0)
        x, y = min(np.int64(u), max(rows - 2, 0)), min(np.int64(v), max(lines - 2, 0))
        right, up, u, v = min(x + 1, rows - 1), min(y + 1, lines - 1), u - x, v - y
        south = (1 - u) * surface[x, y] + u * surface[right, y]
        north = (1 - u) * surface[x, up] + u * surface[right, up]
        z = (1 - v) * south + v * north
        if z < np.inf:
            found[i] = points[i, 2] - z
    return found


@njit(cache=True, nogil=True)
def stale_blocks(blocks, stale, column, number):
    """Those of some blocks (K,) int64 that contain points and are in stale columns.

    Args:
        blocks: (K,) int64.
        stale: (all columns + 1,) bool.
        column: (B + 1,), the column of each block.
        number: (B, 8), number of points in each layer.
    """
    found, n = np.empty(len(blocks), np.int64), 0
    for b in blocks:
        if stale[column[b]] and number[b].any():
            found[n] = b
            n += 1
    return found[:n]


@njit(cache=True, nogil=True)
def _densest(number, thick):
    """Number of points in the densest run of ``thick`` thin layers, and the middle of the first and last such run."""
    inside = number[:thick].sum()
    most, first, last = inside, 0, 0
    for bottom in range(1, len(number) - thick + 1):
        inside += number[bottom + thick - 1] - number[bottom - 1]
        if inside > most:
            most, first = inside, bottom
        if inside == most:
            last = bottom
    return most, (first + last + thick) / 2


@njit(cache=True, nogil=True)
def aligned(height, points, within, position, reach, edge, layer, least, share):
    """(N,) float32, metres: heights less that of the ground that the scan sees in the same square cell near the sensor.

    The ground of a cell is the densest layer of its points near height 0; it counts if it is not nearly at 0.

    Args:
        height: (N,) float32, metres.
        points: (N, 3) float32, metres.
        within: (N,) bool: points to align; they must be finite.
        position: (3,) float64, metres: position of the sensor.
        reach: metres: horizontal distance from the sensor up to which points are aligned.
        edge: edge of a cell, metres.
        layer: metres: height of the layer; minimum and maximum distance of its middle from 0.
        least, share: minimum number of points in the layer, and minimum share of the cell's points.
    """
    (tall, off, most), half = layer, np.int64(math.ceil(reach / edge))
    lowest, thick, wide = -most - tall / 2, round(tall * THIN), 2 * half + 1
    west, south = math.floor(position[0] / edge) - half, math.floor(position[1] / edge) - half
    cells, total = np.full(len(points), np.int32(-1)), np.zeros(wide * wide, np.int64)
    number = np.zeros((wide * wide, round(2 * most * THIN) + thick), np.int64)
    for i in range(len(points)):
        dx, dy = points[i, 0] - position[0], points[i, 1] - position[1]
        if within[i] and dx * dx + dy * dy <= reach * reach:
            x, y = np.int64(math.floor(points[i, 0] / edge) - west), np.int64(math.floor(points[i, 1] / edge) - south)
            cells[i] = x * wide + y
            total[cells[i]] += 1
            if lowest <= height[i] < -lowest:
                number[cells[i], min(np.int64((height[i] - lowest) * THIN), number.shape[1] - 1)] += 1
    level = np.zeros(wide * wide)
    for cell in range(len(level)):
        inside, middle = _densest(number[cell], thick)
        found = middle / THIN + lowest
        if inside >= max(least, share * total[cell]) and abs(found) > off:
            level[cell] = found
    lower = height.copy()
    for i in range(len(points)):
        if cells[i] >= 0:
            lower[i] -= np.float32(level[cells[i]])
    return lower


@njit(cache=True, nogil=True, parallel=True)
def levelled(height, points, within, position, low, deep, sway, edge, many):
    """(N,) float32, metres: heights less the mean height of the points near the ground in the same square cell.

    Points are near the ground if their height is from -deep to low, both extended by ``sway`` times their distance
    from the sensor, and levelled by at most that. Points more than ``SQUARES`` cells away stay as they are.

    Args:
        height: (N,) float32, metres.
        points: (N, 3) float32, metres.
        within: (N,) bool: points to level; they must be finite.
        position: (3,) float64, metres: position of the sensor.
        low, deep: metres.
        sway: radians.
        edge: edge of a cell, metres.
        many: minimum number of points near the ground in a cell; others are not levelled.
    """
    wide = 2 * SQUARES + 1
    west, south = math.floor(position[0] / edge) - SQUARES, math.floor(position[1] / edge) - SQUARES
    cells, most = np.empty(len(points), np.int32), np.empty(len(points), np.float32)
    for i in prange(len(points)):
        cells[i] = -1
        if within[i] and math.isfinite(height[i]):
            dx, dy, dz = points[i, 0] - position[0], points[i, 1] - position[1], points[i, 2] - position[2]
            most[i] = sway * math.sqrt(dx * dx + dy * dy + dz * dz)
            if -deep - most[i] < height[i] <= low + most[i]:
                x = np.int64(math.floor(points[i, 0] / edge) - west)
                y = np.int64(math.floor(points[i, 1] / edge) - south)
                if 0 <= x < wide and 0 <= y < wide:
                    cells[i] = x * wide + y
    number, total = np.zeros(wide * wide, np.int64), np.zeros(wide * wide, np.int64)
    for i in range(len(points)):
        if cells[i] >= 0:
            number[cells[i]] += 1
            total[cells[i]] += np.int64(np.float64(height[i]) * 1e6)  # integers: any order
    found = np.empty(len(points), np.float32)
    for i in prange(len(points)):
        found[i] = height[i]
        if cells[i] >= 0 and number[cells[i]] >= many:
            level = total[cells[i]] / (1e6 * number[cells[i]])
            found[i] -= np.float32(min(max(level, -most[i]), most[i]))
    return found
