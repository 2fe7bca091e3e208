"""Columns of slices over a map, seen from above: each column has its own base height, and a bit for each slice.

Columns come in tiles of 64 x 64 that exist where a directory says so. Column (i, j), counted from the map's corner, has
the number tile * 4096 + (i % 64) * 64 + j % 64.
"""

import math

import numpy as np
from numba import njit

TOP = 30  # the highest slice, which holds everything above as well
FINE = 32  # fine bins of a slice, at most
HIGH = 1e6  # metres: points as high or as low have no column


@njit(cache=True, nogil=True)
def _inside(point, corner, side, shape):
    """Whether a point has a column; points that are not finite have none."""
    a, b = (point[0] - corner[0]) / side, (point[1] - corner[1]) / side
    return 0 <= a < shape[0] * 64 and 0 <= b < shape[1] * 64 and abs(point[2]) < HIGH


@njit(cache=True, nogil=True)
def _column(point, corner, side, directory):
    """Number of a point's column, -1 without."""
    if not _inside(point, corner, side, directory.shape):
        return -1
    i, j = math.floor((point[0] - corner[0]) / side), math.floor((point[1] - corner[1]) / side)
    tile = directory[i >> 6, j >> 6]
    return -1 if tile < 0 else tile * 4096 + (i & 63) * 64 + (j & 63)


@njit(cache=True, nogil=True)
def _slice(z, base, height):
    return int(min(max((z - base) / height, 0.0), TOP))  # towards 0, which is down


@njit(cache=True, nogil=True)
def _fine(z, base, height, k, step):
    return int(min(max((z - base - k * height) / step, 0.0), FINE - 1))


@njit(cache=True, nogil=True)
def _below(bits, k):
    """How many bits below bit k are set."""
    n = 0
    for b in range(k):
        n += bits >> b & 1
    return n


@njit(cache=True, nogil=True)
def bounds(points, reach):
    """(2,) float64: lowest x and y of the points within reach of 0 in x and y, (2,): the highest."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for p in range(len(points)):
        x, y = points[p, 0], points[p, 1]
        if abs(x) < reach and abs(y) < reach and abs(points[p, 2]) < HIGH:
            low[0], low[1] = min(low[0], x), min(low[1], y)
            high[0], high[1] = max(high[0], x), max(high[1], y)
    return low, high


@njit(cache=True, nogil=True)
def directory(points, corner, side, shape):
    """Tiles of the given shape, int32: a number for each that holds points, -1 for the others; and how many do."""
    tiles = np.full(shape, np.int32(-1))
    for p in range(len(points)):
        if _inside(points[p], corner, side, shape):
            i, j = math.floor((points[p, 0] - corner[0]) / side), math.floor((points[p, 1] - corner[1]) / side)
            tiles[i >> 6, j >> 6] = 0
    n = 0
    for a in range(shape[0]):
        for b in range(shape[1]):
            if tiles[a, b] == 0:
                tiles[a, b] = n
                n += 1
    return tiles, n


@njit(cache=True, nogil=True)
def lowest(points, corner, side, directory, n):
    """(n,) float64: the lowest point of each column, NaN without points."""
    low = np.full(n, np.nan)
    for p in range(len(points)):
        c = _column(points[p], corner, side, directory)
        if c >= 0 and not low[c] <= points[p, 2]:
            low[c] = points[p, 2]
    return low


@njit(cache=True, nogil=True)
def level(low, directory, reach, least, deviations):
    """Base heights: the lowest points, held near those of columns before.

    Neighbours of (i, j) are the columns (i - reach ... i - 1, j - reach ... j - 1), whose bases are known already.
    Where at least ``least`` of them hold points, a base is held within their median and a few median absolute
    deviations.

    Args:
        low: (n,) float64, metres, as from ``lowest``.
        directory: tiles.
        reach, least: columns.
        deviations: how many median absolute deviations to each side.

    Returns:
        base: (n,) float64, metres; NaN without points.
        raised: (n,) bool: columns whose lowest point lies below the base.
    """
    base, raised = low.copy(), np.zeros(len(low), np.bool_)
    near = np.empty(reach * reach)
    for a in range(directory.shape[0]):
        for b in range(directory.shape[1]):
            if directory[a, b] < 0:
                continue
            for c in range(directory[a, b] * 4096, directory[a, b] * 4096 + 4096):
                if math.isnan(low[c]):
                    continue
                i, j = a * 64 + (c >> 6 & 63), b * 64 + (c & 63)
                n = 0
                for u in range(max(i - reach, 0), i):
                    for v in range(max(j - reach, 0), j):
                        tile = directory[u >> 6, v >> 6]
                        if tile >= 0:
                            z = base[tile * 4096 + (u & 63) * 64 + (v & 63)]
                            if not math.isnan(z):
                                near[n] = z
                                n += 1
                if n < least:
                    continue
                middle = np.median(near[:n])
                spread = deviations * np.median(np.abs(near[:n] - middle))
                raised[c] = low[c] < middle - spread
                base[c] = min(max(low[c], middle - spread), middle + spread)
    return base, raised


@njit(cache=True, nogil=True)
def fill(points, corner, side, directory, base, height):
    """(n,) int32: the bits of occupied slices, and (n + 1,) int64: how many slices the columns before a column have."""
    bits = np.zeros(len(base), np.int32)
    for p in range(len(points)):
        c = _column(points[p], corner, side, directory)
        if c >= 0:
            bits[c] |= 1 << _slice(points[p, 2], base[c], height)
    rows = np.zeros(len(base) + 1, np.int64)
    for c in range(len(base)):
        rows[c + 1] = rows[c] + _below(bits[c], TOP + 1)
    return bits, rows


@njit(cache=True, nogil=True)
def histograms(points, corner, side, directory, base, height, step, bits, rows):
    """(occupied slices, FINE) uint32: points in fine bins of each slice."""
    fine = np.zeros((rows[-1], math.ceil(min(height / step, FINE - 1.0)) + 1), np.uint32)
    for p in range(len(points)):
        c = _column(points[p], corner, side, directory)
        if c >= 0:
            k = _slice(points[p, 2], base[c], height)
            f = min(_fine(points[p, 2], base[c], height, k, step), fine.shape[1] - 1)
            fine[rows[c] + _below(bits[c], k), f] += np.uint32(1)
    return fine


@njit(cache=True, nogil=True)
def look(points, corner, side, directory, base, height, first, width, sensor, near):
    """What a scan sees of the columns around it.

    Args:
        points: (N, 3) float32, metres, world frame.
        corner, side, directory, base, height: the map's columns.
        first: (2,) int64: the window's first column; width: columns along its edge.
        sensor: (3,) float64, metres, world frame.
        near: metres in x and y: points up to there say nothing of the field of view.

    Returns:
        bits: (width, width) int32: slices that hold points of the scan.
        slope: the steepest rise from the sensor to a point, metres per metre; -inf without one.
    """
    bits = np.zeros((width, width), np.int32)
    slope = -np.inf
    for p in range(len(points)):
        x, y, z = points[p, 0] - sensor[0], points[p, 1] - sensor[1], points[p, 2] - sensor[2]
        if not math.isfinite(x + y + z):
            continue
        flat = x * x + y * y
        if flat > near * near and (z > 0 or slope < 0):
            slope = max(slope, z / math.sqrt(flat))
        c = _column(points[p], corner, side, directory)
        if c < 0 or math.isnan(base[c]):
            continue
        i = math.floor((points[p, 0] - corner[0]) / side) - first[0]
        j = math.floor((points[p, 1] - corner[1]) / side) - first[1]
        if 0 <= i < width and 0 <= j < width:
            bits[i, j] |= 1 << _slice(points[p, 2], base[c], height)
    return bits, slope


@njit(cache=True, nogil=True)
def _blocked(seen, a, i, j, sensor_slice, k, skip):
    """Whether the line from the sensor's column (a, a) to slice k of (i, j) meets an occupied slice on its way."""
    n = max(abs(i - a), abs(j - a))
    for s in range(skip, n):
        f = s / n
        e = math.floor(sensor_slice * (1 - f) + (k + 0.5) * f + 0.5)
        if 0 <= e <= TOP and seen[a + (i - a) * s // n, a + (j - a) * s // n] >> e & 1:
            return True
    return False


@njit(cache=True, nogil=True)
def judge(columns, bits, base, raised, seen, sensor_z, sensor_base, slope, side, height, blind, sight, gap, steps):
    """Which slices of the map a scan does not see, and what each step of the algorithm says of them.

    Args:
        columns: (W, W) int64: numbers of the window's columns, -1 without; the sensor's is in the middle, at W // 2.
        bits, base, raised: the map's columns.
        seen: (W, W) int32: the scan's slices.
        sensor_z: metres; sensor_base: base of the sensor's column, NaN without points.
        slope: upper edge of the field of view, metres per metre.
        side, height: of a slice, metres.
        blind: columns around the sensor that are not judged; as many steps of a line are skipped.
        sight: metres from where on a column needs ground.
        gap: slices.
        steps: (n, 9) int32: all steps' bits so far; those of this scan are added.

    Returns:
        (W, W, 9) int32: of this scan the slices in the window, saved near the sensor, beyond sight, above the highest
        seen, above the field of view, as ground, above a gap, behind something seen; and those to be removed.
    """
    width = len(columns)
    said = np.zeros((width, width, 9), np.int32)
    half = width // 2
    for i in range(width):
        for j in range(width):
            c = columns[i, j]
            if c < 0 or bits[c] == 0:
                continue
            said[i, j, 0] = bits[c]
            left = bits[c] & ~seen[i, j]
            away = math.sqrt((i - half) ** 2 + (j - half) ** 2) * side
            if -blind <= i - half < blind and -blind <= j - half < blind:
                said[i, j, 1] = left
                left = 0
            if seen[i, j] & 1 == 0 and away >= sight:
                said[i, j, 2] = left
                left = 0
            highest = TOP
            while highest > 0 and seen[i, j] >> highest & 1 == 0:
                highest -= 1
            step = 3
            if highest == 0 or raised[c]:
                step = 4
                line = (sensor_z - base[c] + away * slope) / height
                highest = int(min(line, TOP + 1.0)) if line > 0 else 0
            above = left & ~((1 << highest) - 1)
            said[i, j, step] = above
            left &= ~above
            ground = left & (bits[c] & -bits[c])
            said[i, j, 5] = ground
            left &= ~ground
            last = TOP
            for k in range(TOP + 1):
                if bits[c] >> k & 1:
                    if k - last > gap:
                        said[i, j, 6] = left & ~((1 << k) - 1)
                        left &= ~said[i, j, 6]
                        break
                    last = k
            if not math.isnan(sensor_base):
                for k in range(TOP + 1):
                    if left >> k & 1 and _blocked(seen, half, i, j, (sensor_z - sensor_base) / height, k, blind):
                        said[i, j, 7] |= 1 << k
            said[i, j, 8] = left & ~said[i, j, 7]
            for s in range(9):
                steps[c, s] |= said[i, j, s]
    return said


@njit(cache=True, nogil=True)
def split(columns, bits, steps, rows, fine, part, cuts):
    """Of each column with slices to be removed: the fine bins of the slice below the lowest of them that are ground.

    Args:
        columns: (C,) int64: numbers; -1 is passed over.
        bits, steps, rows, fine: the map's columns.
        part: of the slice's points that ground holds at least.
        cuts: (n,) uint8: fine bins of ground, from the lowest; set for the columns given.
    """
    for c in columns:
        if c < 0 or steps[c, 8] == 0:
            continue
        k = 0
        while steps[c, 8] >> k & 1 == 0:
            k += 1
        if k == 0 or bits[c] >> (k - 1) & 1 == 0:
            cuts[c] = 0
            continue
        row = fine[rows[c] + _below(bits[c], k - 1)]
        total, found, f = row.sum(), 0, 0
        while found < part * total:
            found += row[f]
            f += 1
        cuts[c] = f


@njit(cache=True, nogil=True)
def reasons(points, corner, side, directory, base, height, step, bits, steps, cuts):
    """What became of each point, (N,) uint8.

    0 without a column of the map, 1 never in a window, 2 always seen, 3 ... 9 the last of the steps that saved its
    slice, 10 ground by its fine bin, 11 removed with its slice, 12 removed above fine ground.
    """
    why = np.zeros(len(points), np.uint8)
    for p in range(len(points)):
        c = _column(points[p], corner, side, directory)
        if c < 0 or math.isnan(base[c]):
            continue
        k = _slice(points[p, 2], base[c], height)
        why[p] = 1
        for s in range(9):
            if steps[c, s] >> k & 1:
                why[p] = (2, 3, 4, 5, 6, 7, 8, 9, 11)[s]
        gone = steps[c, 8]
        if why[p] != 11 and cuts[c] > 0 and gone >> (k + 1) & 1 and gone & ((1 << (k + 1)) - 1) == 0:
            why[p] = 12 if _fine(points[p, 2], base[c], height, k, step) >= cuts[c] else 10
    return why
