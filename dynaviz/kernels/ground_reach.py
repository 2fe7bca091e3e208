"""How far the ground under a sensor reaches, and what lies below it: reflections, other floors.

A ray ends at the first surface. What lies below ground that is seen, on a ray that passes below it,
is a reflection. Heights are in metres above the sensor, cells as from ``scan_ground.cells_of``: the
sensor is in the middle one.
"""

import math

import numpy as np
from numba import njit

# A layer with so many times the cells of a lower one is the ground if so large a share of the rays
# to the lower one pass below it; less is enough where earlier scans had the ground.
OTHER = 0.1
MOST = 0.5
BEFORE = 0.05
SOME = 0.25


@njit(cache=True, nogil=True)
def _passes_below(x, y, lowest, high, drop):
    """Whether the ray to cell (x, y) passes more than ``drop`` below cells that are lower than
    ``high``.
    """
    middle = len(lowest) // 2
    z = lowest[x, y]
    steps = max(abs(x - middle), abs(y - middle))
    for k in range(1, steps):
        i = middle + round((x - middle) * k / steps)
        j = middle + round((y - middle) * k / steps)
        least = z * k / steps + drop * (1 + abs(z) / steps)
        for u in range(i - 1, i + 2):
            for v in range(j - 1, j + 2):
                if least < lowest[u, v] < high:
                    return True
    return False


@njit(cache=True, nogil=True)
def _reflected(lowest, low, high, near, layer):
    """Share of the cells of a layer that begins at ``low`` whose rays pass below others up to
    ``high``.
    """
    middle = len(lowest) // 2
    first = max(middle - near, 0)
    last = min(middle + near + 1, len(lowest))
    total = 0
    below = 0
    for x in range(first, last):
        for y in range(first, last):
            if low <= lowest[x, y] < low + layer:
                total += 1
                below += _passes_below(x, y, lowest, high, 2 * layer)
    return below / total


@njit(cache=True, nogil=True)
def level(lowest, near, layer, before):
    """Height of the ground under the sensor.

    The layer with the lowest points of most near cells; a higher one, if the rays to most of these
    pass below it, or to a quarter if the ground was there before. The sensor may be on the ground
    itself, as far as poses know: what is less than a layer above it can be ground.

    Args:
        lowest: (X, X) float64: the lowest point of each cell, infinite without.
        near: number of cells around the sensor among which the ground under it is sought.
        layer: height of a layer, metres.
        before: what earlier scans found, infinite if unknown.
    """
    middle = len(lowest) // 2
    first = max(middle - near, 0)
    part = lowest[first : middle + near + 1, first : middle + near + 1].copy().ravel()
    z = np.sort(part[part < layer])
    if not len(z):
        return np.inf
    number = np.searchsorted(z, z + layer) - np.arange(len(z))
    best = int(np.argmax(number))
    while True:
        higher = -1
        usual = -1
        for k in range(len(z)):
            if z[k] > z[best] + 2 * layer:
                if number[k] > OTHER * number[best] and (higher < 0 or number[k] > number[higher]):
                    higher = k
                if abs(z[k] + layer / 2 - before) < 2 * layer and (
                    usual < 0 or number[k] > number[usual]
                ):
                    usual = k
        if (
            usual >= 0
            and number[usual] > BEFORE * number[best]
            and _reflected(lowest, z[best], z[usual] + layer, near, layer) > SOME
        ):
            best = usual
            continue
        if higher < 0 or _reflected(lowest, z[best], z[higher] + layer, near, layer) <= MOST:
            return z[best] + layer / 2
        best = higher


@njit(cache=True, nogil=True)
def lowest_possible(lowest, under, edge, steep, margin):
    """(X, X) float64: the lowest ground that a slope from the ground under the sensor can reach, in
    cells with points below it; minus infinity in the others.

    Args:
        lowest: (X, X) float64: the lowest point of each cell.
        under: height of the ground under the sensor.
        edge: of a cell, metres.
        steep: slope of the steepest ground, as seen from the sensor, metres per metre.
        margin: metres that ground may be lower than that.
    """
    middle = len(lowest) // 2
    least = np.full(lowest.shape, -np.inf)
    for x in range(len(lowest)):
        for y in range(len(lowest)):
            far = math.sqrt(float((x - middle) ** 2 + (y - middle) ** 2))
            possible = under - margin - steep * edge * far
            if lowest[x, y] < possible:
                least[x, y] = possible
    return least


@njit(cache=True, nogil=True)
def reached(layers, under, edge, steep, rise, margin):
    """The ground, followed outwards from below the sensor, cell by cell.

    Args:
        layers: (X, X) float64: lowest layers, infinite if unknown.
        under: height of the ground under the sensor.
        edge: of a cell, metres.
        steep: slope by which the ground may descend, metres per metre.
        rise: slope by which it may rise; what is higher is an object.
        margin: metres that ground may be lower than that.

    Returns:
        ground: (X, X) float64: its height, that of the cells on the way if unknown.
        gap: (X, X) int32: number of cells since it was seen last, 0 where it is seen.
        cut: (X, X) bool: lowest layers that are too low to belong to it.
    """
    wide = len(layers)
    middle = wide // 2
    ground = np.full((wide, wide), under)
    gap = np.zeros((wide, wide), np.int32)
    cut = np.zeros((wide, wide), np.bool_)
    for ring in range(1, middle + 1):
        for x in range(middle - ring, min(middle + ring + 1, wide)):
            whole = abs(x - middle) == ring
            for y in range(middle - ring, min(middle + ring + 1, wide), 1 if whole else 2 * ring):
                height, cells = _inwards(x, y, ring, ground, gap)
                ground[x, y] = height
                gap[x, y] = cells
                z = layers[x, y]
                descent = steep * edge * cells
                ascent = rise * edge * cells
                if z < height - margin - descent:
                    cut[x, y] = True
                elif z <= height + margin / 4 + ascent:
                    # what is within the margin does not add up from cell to cell
                    ground[x, y] = min(max(z, height - descent), height + ascent)
                    gap[x, y] = 0
    return ground, gap, cut


@njit(cache=True, nogil=True)
def _inwards(x, y, ring, ground, gap):
    """Mean height of the ground in those cells next to (x, y), a ring further in, that are nearest
    to ground that is seen, and the number of cells from (x, y) to it.
    """
    wide = len(ground)
    middle = wide // 2
    i = middle + round((x - middle) * (ring - 1) / ring)
    j = middle + round((y - middle) * (ring - 1) / ring)
    least = np.int32(wide)
    total = 0.0
    number = 0
    for u in range(max(i - 1, 0), min(i + 2, wide)):
        for v in range(max(j - 1, 0), min(j + 2, wide)):
            if max(abs(u - middle), abs(v - middle)) == ring - 1 and gap[u, v] <= least:
                if gap[u, v] < least:
                    least = gap[u, v]
                    total = 0.0
                    number = 0
                total += ground[u, v]
                number += 1
    return total / number, least + np.int32(1)


@njit(cache=True, nogil=True)
def reflections(layers, ground, gap, cut, margin):
    """(X, X) bool: layers that are reflections: rays to them pass below ground that is seen.

    Below one such cell, or one next to it, if the layer is too low for the ground; below two if it
    is not.

    Args:
        layers: (X, X) float64: lowest layers, infinite if unknown.
        ground, gap, cut: as from ``reached``.
        margin: metres that a ray must be lower.
    """
    wide = len(layers)
    middle = wide // 2
    found = np.zeros((wide, wide), np.bool_)
    for x in range(wide):
        for y in range(wide):
            z = layers[x, y]
            if z == np.inf:
                continue
            beside = 1 if cut[x, y] else 0
            wanted = 1 if cut[x, y] else 2
            steps = max(abs(x - middle), abs(y - middle))
            for k in range(1, steps):
                i = middle + round((x - middle) * k / steps)
                j = middle + round((y - middle) * k / steps)
                least = z * k / steps + margin * (1 + abs(z) / steps)
                passed = False
                for u in range(i - beside, i + beside + 1):
                    for v in range(j - beside, j + beside + 1):
                        passed |= gap[u, v] == 0 and ground[u, v] > least
                wanted -= passed
                if wanted == 0:
                    found[x, y] = True
                    break
    return found
