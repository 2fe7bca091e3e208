"""Binary columns of a map: each column has its own base height and one bit per height slice.

Columns are stored in tiles of 64 x 64, which a directory numbers where there are points. Column (i,
j), counted from the map's corner, has the number tile * 4096 + (i % 64) * 64 + j % 64.
"""

import math

import numpy as np
from numba import njit

TOP = 30  # the highest slice, which includes everything above it
FINE = 32  # maximum number of fine bins per slice
HIGH = 1e6  # metres: points at or beyond this height or depth have no column


@njit(cache=True, nogil=True, inline="always")
def _place(x, y, z, corner, side, shape):
    """Column (i, j) of a point, counted from the map's corner.

    (-1, -1) if it is not finite or outside the tiles.
    """
    a = (x - corner[0]) / side
    b = (y - corner[1]) / side
    if not (0 <= a < shape[0] * 64 and 0 <= b < shape[1] * 64 and abs(z) < HIGH):
        return -1, -1
    return math.floor(a), math.floor(b)


@njit(cache=True, nogil=True, inline="always")
def _slice(z, base, height):
    """Number of a point's slice, rounded towards 0, so slice 0 extends as far below the base as
    above; -1 if deeper.
    """
    k = (z - base) / height
    return -1 if k <= -1 else int(min(k, TOP))


@njit(cache=True, nogil=True, inline="always")
def _fine(z, base, height, k, step):
    """Number of a point's fine bin in slice k, rounded towards 0 as for slices; -1 if deeper."""
    f = (z - base - k * height) / step
    return -1 if f <= -1 else int(min(f, FINE - 1))


@njit(cache=True, nogil=True)
def _below(bits, k):
    """Number of set bits below bit k."""
    n = 0
    for b in range(k):
        n += bits >> b & 1
    return n


@njit(cache=True, nogil=True)
def _end(bits, gap):
    """The bit above the lowest group of set bits.

    A group ends at a gap of at least ``gap`` bits.
    """
    last = -1
    for k in range(FINE):
        if bits >> k & 1:
            if last >= 0 and k - last > gap:
                break
            last = k
    return last + 1


@njit(cache=True, nogil=True)
def bounds(points, reach):
    """(2,) float64, twice: lowest and highest x and y, metres, of the points within ``reach`` of 0
    in x and y.
    """
    low = np.full(2, np.inf)
    high = np.full(2, -np.inf)
    for p in range(len(points)):
        x = points[p, 0]
        y = points[p, 1]
        if abs(x) < reach and abs(y) < reach and abs(points[p, 2]) < HIGH:
            low[0] = min(low[0], x)
            low[1] = min(low[1], y)
            high[0] = max(high[0], x)
            high[1] = max(high[1], y)
    return low, high


@njit(cache=True, nogil=True)
def enter(points, corner, side, tiles):
    """Set the entries of ``tiles``, an int32 array, to 0 where there are points."""
    for p in range(len(points)):
        i, j = _place(points[p, 0], points[p, 1], points[p, 2], corner, side, tiles.shape)
        if i >= 0:
            tiles[i >> 6, j >> 6] = 0


@njit(cache=True, nogil=True)
def number(tiles):
    """Number the tiles that are at least 0, in place; returns how many they are."""
    n = 0
    for a in range(tiles.shape[0]):
        for b in range(tiles.shape[1]):
            if tiles[a, b] >= 0:
                tiles[a, b] = n
                n += 1
    return n


@njit(cache=True, nogil=True)
def locate(points, corner, side, directory):
    """(N,) int32: number of the column of each point (N, 3) float32, metres, world frame.

    -1 if none.
    """
    columns = np.empty(len(points), np.int32)
    for p in range(len(points)):
        i, j = _place(points[p, 0], points[p, 1], points[p, 2], corner, side, directory.shape)
        tile = directory[i >> 6, j >> 6] if i >= 0 else np.int32(-1)
        columns[p] = -1 if tile < 0 else tile * 4096 + (i & 63) * 64 + (j & 63)
    return columns


@njit(cache=True, nogil=True)
def lowest(points, columns, low):
    """Lower ``low`` (n,) float64, metres, to the lowest points (N, 3) of the columns (N,).

    NaN without points.
    """
    for p in range(len(points)):
        c = columns[p]
        if c >= 0 and not low[c] <= points[p, 2]:
            low[c] = points[p, 2]


@njit(cache=True, nogil=True)
def level(low, directory, reach, least, deviations):
    """Base heights: the lowest points, bounded by the bases of the preceding columns.

    Neighbours of (i, j) are the columns (i - reach ... i - 1, j - reach ... j - 1), whose bases are
    already known. If at least ``least`` of them have points, the base is clipped to their median
    plus or minus a few median absolute deviations.

    Args:
        low: (n,) float64, metres, as from ``lowest``.
        directory: tiles.
        reach, least: numbers of columns.
        deviations: number of median absolute deviations to each side.

    Returns:
        base: (n,) float64, metres; NaN without points.
        raised: (n,) bool: columns whose lowest point is below the base.
    """
    base = low.copy()
    raised = np.zeros(len(low), np.bool_)
    near = np.empty(reach * reach)
    for a in range(directory.shape[0]):
        for b in range(directory.shape[1]):
            if directory[a, b] < 0:
                continue
            for c in range(directory[a, b] * 4096, directory[a, b] * 4096 + 4096):
                if math.isnan(low[c]):
                    continue
                i = a * 64 + (c >> 6 & 63)
                j = b * 64 + (c & 63)
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
def slices(points, columns, base, height):
    """(N,) int8: slice of each point (N, 3), from its column (N,); -1 if none."""
    found = np.full(len(points), np.int8(-1))
    for p in range(len(points)):
        c = columns[p]
        if c >= 0 and not math.isnan(base[c]):
            found[p] = _slice(points[p, 2], base[c], height)
    return found


@njit(cache=True, nogil=True)
def fill(columns, slices, bits):
    """Set the bits (n,) int32 of the slices with points, which are given by column
    and slice (N,).
    """
    for p in range(len(columns)):
        if slices[p] >= 0:
            bits[columns[p]] |= 1 << slices[p]


@njit(cache=True, nogil=True)
def rows(bits):
    """(n + 1,) int64: how many slices the columns before a column have."""
    before = np.zeros(len(bits) + 1, np.int64)
    for c in range(len(bits)):
        before[c + 1] = before[c] + _below(bits[c], TOP + 1)
    return before


@njit(cache=True, nogil=True)
def histograms(points, columns, slices, base, height, step, bits, rows, wanted, fine):
    """Add points to the fine bins of their slices.

    Args:
        points: (N, 3) float32, metres.
        columns, slices: (N,), as from ``locate`` and ``slices``.
        base, height: of columns and slices, metres.
        step: height of a fine bin, metres.
        bits, rows: of the map; row of a slice.
        wanted: (n,) int32: bits of the slices whose points count.
        fine: (R, FINE + 1) uint32: number of points in the fine bins of each slice; last, those
            below. Modified.
    """
    for p in range(len(points)):
        c = columns[p]
        k = slices[p]
        if k >= 0 and wanted[c] >> k & 1:
            fine[rows[c] + _below(bits[c], k), _fine(points[p, 2], base[c], height, k, step)] += (
                np.uint32(1)
            )


@njit(cache=True, nogil=True)
def ground(fine, part, gap):
    """The fine bins to remove if a slice is split.

    Args:
        fine: (R, FINE + 1) uint32, as from ``histograms``.
        part: minimum share of the slice's points that are ground.
        gap: number of empty bins; bins above such a gap are ignored.

    Returns:
        (R, 2) uint8: bins [first, end) to remove; empty if ground does not reach its share.
    """
    cuts = np.zeros((len(fine), 2), np.uint8)
    for r in range(len(fine)):
        bits = 0
        found = 0
        f = 0
        for b in range(FINE):
            bits |= (fine[r, b] > 0) << b
        end = _end(bits, gap)
        enough = part * fine[r].sum()
        while f < end and found < enough:
            found += fine[r, f]
            f += 1
        cuts[r, 0] = f
        cuts[r, 1] = end
    return cuts


@njit(cache=True, nogil=True)
def look(columns, slices, places, seen):
    """Set the bits of the slices that a scan sees in the window around it.

    Args:
        columns, slices: (N,) of the scan's points.
        places: (n,) int32: the position in the window of each column; -1 outside.
        seen: (columns of the window,) int32. Modified.
    """
    for p in range(len(columns)):
        if slices[p] >= 0 and places[columns[p]] >= 0:
            seen[places[columns[p]]] |= 1 << slices[p]


@njit(cache=True, nogil=True)
def steepest(points, sensor):
    """The steepest slope from the sensor (3,) to a finite point (N, 3), metres per metre.

    -inf without points.
    """
    slope = -np.inf
    for p in range(len(points)):
        x = points[p, 0] - sensor[0]
        y = points[p, 1] - sensor[1]
        z = points[p, 2] - sensor[2]
        flat = x * x + y * y
        if math.isfinite(x + y + z) and flat > 0:
            slope = max(slope, z / math.sqrt(flat))
    return slope


@njit(cache=True, nogil=True)
def _limit(seen, raised, di, dj, view, rise, blind, sight):
    """The step of the algorithm that limits a column, and the lowest slice that the scan cannot
    judge in it.

    Args:
        seen: bits of the column's slices that the scan sees.
        raised: as from ``level``.
        di, dj: offset from the sensor's column, columns.
        view, rise, blind, sight: as for ``judge``.
    """
    if -blind <= di < blind and -blind <= dj < blind:
        return 1, 0
    flat = di * di + dj * dj
    if seen & 1 == 0 and flat >= sight * sight:
        return 2, 0
    if seen >> 1 and not raised:
        highest = TOP
        while seen >> highest & 1 == 0:
            highest -= 1
        return 3, highest
    edge = view + math.sqrt(flat) * rise + 0.5
    return 4, int(min(edge, TOP + 1.0)) if edge > 0 else 0


@njit(cache=True, nogil=True)
def _blocked(left, columns, base, seen, i, j, view, sensor_base, skip):
    """The slices ``left`` of column (i, j) that are blocked by a slice of the scan on the line from
    the sensor.

    The line advances by one column along its longer axis. At distance t of its length s, its height
    in slices is view + (k - view) * t / s. Nothing blocks it in the first ``skip`` columns, counted
    in x and y together. Towards a near target it may end one column behind the target, or continue
    to the edge of the window.
    """
    width = len(columns)
    a = len(columns) // 2
    blocked = 0
    di = i - a
    dj = j - a
    n = max(abs(di), abs(dj))
    if n == 0:
        return 0
    step_x = di / n
    step_y = dj / n
    whole = math.sqrt(di * di + dj * dj)
    step_t = math.sqrt(step_x * step_x + step_y * step_y)
    x = a + step_x
    y = a + step_y
    t = step_t
    while 0 < x < width and 0 < y < width:
        if int(abs(x - a)) + int(abs(y - a)) > skip:
            u = int(x)
            v = int(y)
            if seen[u, v]:
                # metres, added to slices as in the public program
                rise = base[columns[u, v]] - sensor_base
                for k in range(TOP + 1):
                    e = rise + (k - view) * t / whole + view + 0.5
                    if left >> k & 1 and -1 < e < TOP + 1 and seen[u, v] >> int(e) & 1:
                        blocked |= 1 << k
            if abs(x - i) <= 1 and abs(y - j) <= 1:
                break
        x = x + step_x
        y = y + step_y
        t = t + step_t
    return blocked


@njit(cache=True, nogil=True)
def judge(
    columns,
    bits,
    base,
    raised,
    seen,
    view,
    sensor_base,
    rise,
    blind,
    sight,
    gap,
    skip,
    steps,
    splits,
):
    """Apply the steps of the algorithm to the slices of the map that a scan does not see.

    Args:
        columns: (W, W) int64: numbers of the window's columns, -1 if none; the sensor's column is
            at W // 2.
        bits, base, raised: the map's columns.
        seen: (W, W) int32: the scan's slices.
        view: height of the sensor above the base of its column, slices, plus half a slice.
        sensor_base: that base, metres.
        rise: slope of the upper edge of the field of view, slices per column.
        blind: columns within this distance of the sensor are not judged, columns.
        sight: distance from which a column is judged only if its ground is seen, columns.
        gap: number of empty slices that ends a column.
        skip: number of columns, in x and y together, in which a line cannot be blocked.
        steps: (n, 9) int32: bits of each step by the scans so far; those of this scan are added.
        splits: (n,) int32: bits of the slices to split; those below the lowest slice that this scan
            removes are added.

    Returns:
        (W, W, 9) int32: bits of this scan's slices: in the window; kept near the sensor, beyond
        sight, above the highest seen slice, above the field of view, as ground, above a gap, behind
        an occupied slice; removed.
    """
    width = len(columns)
    half = len(columns) // 2
    outcome = np.zeros((width, width, 9), np.int32)
    for i in range(width):
        for j in range(width):
            c = columns[i, j]
            if c < 0 or bits[c] == 0:
                continue
            outcome[i, j, 0] = bits[c]
            left = bits[c] & ~seen[i, j]
            step, limit = _limit(
                seen[i, j], raised[c], i - half, j - half, view, rise, blind, sight
            )
            outcome[i, j, step] = left & ~((1 << limit) - 1)
            left &= ~outcome[i, j, step]
            outcome[i, j, 5] = left & bits[c] & -bits[c]
            left &= ~outcome[i, j, 5]
            outcome[i, j, 6] = left & ~((1 << _end(bits[c], gap)) - 1)
            left &= ~outcome[i, j, 6]
            if left:
                outcome[i, j, 7] = _blocked(
                    left, columns, base, seen, i, j, view, sensor_base, skip
                )
            left &= ~outcome[i, j, 7]
            outcome[i, j, 8] = left
            splits[c] |= (left & -left) >> 1 & bits[c]
            for s in range(9):
                steps[c, s] |= outcome[i, j, s]
    return outcome


@njit(cache=True, nogil=True)
def bins(points, columns, slices, base, height, step, bits, rows, cuts):
    """Fine bin of each point, and the bins to remove there: (N, 3) int64; -1 without a slice."""
    found = np.full((len(points), 3), np.int64(-1))
    for p in range(len(points)):
        c = columns[p]
        k = slices[p]
        if k >= 0:
            cut = rows[c] + _below(bits[c], k)
            found[p, 0] = _fine(points[p, 2], base[c], height, k, step)
            found[p, 1] = cuts[cut, 0]
            found[p, 2] = cuts[cut, 1]
    return found


@njit(cache=True, nogil=True)
def reasons(points, columns, slices, base, height, step, bits, rows, steps, splits, cuts):
    """Reason code of each point, (N,) uint8.

    0 without a slice of the map, 1 never in a window, 2 always seen, 3 ... 9 the last of the steps
    that kept its slice, 10 ground by its fine bin, 11 removed with its slice, 12 removed above fine
    ground; 8 also above a gap of fine bins.
    """
    codes = np.zeros(len(points), np.uint8)
    for p in range(len(points)):
        c = columns[p]
        k = slices[p]
        if k < 0:
            continue
        codes[p] = 1
        for s in range(9):
            if steps[c, s] >> k & 1:
                codes[p] = (2, 3, 4, 5, 6, 7, 8, 9, 11)[s]
        if codes[p] != 11 and splits[c] >> k & 1:
            f = _fine(points[p, 2], base[c], height, k, step)
            cut = rows[c] + _below(bits[c], k)
            codes[p] = 10 if f < cuts[cut, 0] else 12 if f < cuts[cut, 1] else 8
    return codes
