"""Places: quarters of the blocks of a grid, 4 x 4 x 8 voxels.

Their evidence, and what they inherit from objects.

Place p is in block p >> 2. A scan visits the places that contain points of its objects. Those that
were visited have rows. Seen from above, objects are in columns of blocks.
"""

import numpy as np
from numba import njit, prange

from dynaviz.kernels.blocks import BIT_OF, SEQUENCE

ONE = np.uint64(1)
HALF = np.uint64(0xFFFFFFFF)
WAYS = np.array([[1, 0], [0, 1], [1, 1], [1, -1], [-1, 0], [0, -1], [-1, -1], [-1, 1]])
# eight horizontal unit vectors, opposite ones four apart
WAYS = WAYS / np.hypot(WAYS[:, :1], WAYS[:, 1:])


@njit(cache=True, nogil=True)
def visit(voxels, objects, count, now, up, stamps):
    """The places that a scan visits, by object.

    Where two objects meet, the place is that of the first point.

    Args:
        voxels: (N,) int64; objects: (N,) int32: the voxel and the object of each point, -1 for
            none.
        count: number of objects.
        now: number of this scan.
        up: (B, 8) uint64: bits of the voxels that ever contained a point of an object. Modified.
        stamps: (B, 4) int32: the last scan that visited each place. Modified.

    Returns:
        places: (V,) int32; begins: (O + 1,) int64: where those of each object begin.
    """
    places = np.empty(len(voxels), np.int32)
    owners = np.empty(len(voxels), np.int32)
    n = 0
    begins = np.zeros(count + 2, np.int64)
    for i in range(len(voxels)):
        v = voxels[i]
        if v < 0 or objects[i] < 0:
            continue
        block = v >> 9
        up[block, v >> 6 & 7] |= ONE << np.uint64(v & 63)
        quarter = (v >> 8 & 1) << 1 | v >> 5 & 1
        if stamps[block, quarter] != now:
            stamps[block, quarter] = now
            places[n] = block << 2 | quarter
            owners[n] = objects[i]
            begins[objects[i] + 2] += 1
            n += 1
    begins = np.cumsum(begins)
    grouped = np.empty(n, np.int32)
    for k in range(n):
        at = owners[k] + 1
        grouped[begins[at]] = places[k]
        begins[at] += 1
    return grouped, begins[: count + 1].copy()


@njit(cache=True, nogil=True)
def clearness(hits, clear, grazed, weights):
    """The evidence that a voxel is empty at times, at most 1.

    Below 0 if it was rather always occupied.

    Args:
        hits, clear, grazed: number of scans that hit the voxel, saw it clear, and crossed it near a
            hit.
        weights: of a crossing near a hit, and of a hit, against one clear crossing; clear crossings
            for full evidence; the prior: the evidence that a place must exceed, and the most that
            hits alone are against it.
    """
    near, hit, votes, prior = weights
    against = near * grazed + hit * hits
    if clear > against:
        return min(clear / votes, 1.0) * (clear - against) / (clear + against)
    return prior * (clear - against) / (clear + against + 1.0)


@njit(cache=True, nogil=True)
def of_voxel(v, hits, clear, grazed, weights):
    """The evidence of a voxel; 0 for -1, or if no other scan touched it."""
    h = hits[v >> 9, v & 511]
    c = clear[v >> 9, v & 511]
    q = grazed[v >> 9, v & 511]
    return clearness(h, c, q, weights) if v >= 0 and (h > 1 or c > 0 or q > 0) else 0.0


@njit(cache=True, nogil=True)
def of_points(voxels, hits, clear, grazed, weights):
    """(N,) float32: the evidence of each point's voxel, as from ``of_voxel``."""
    found = np.empty(len(voxels), np.float32)
    for i in range(len(voxels)):
        found[i] = of_voxel(voxels[i], hits, clear, grazed, weights)
    return found


@njit(cache=True, nogil=True)
def distinct(places, rows):
    """The distinct ones of some places (V,) int32, (R,).

    ``rows`` (4 B,) int32, zero before, is 1 there after.
    """
    found = np.empty(len(places), np.int32)
    n = 0
    for p in places:
        if rows[p] == 0:
            found[n] = p
            rows[p] = 1
            n += 1
    return found[:n].copy()


@njit(cache=True, nogil=True, parallel=True)
def evidence(places, up, hits, clear, grazed, weights):
    """(R + 1,) float32: the evidence of the place in each row, (R + 1,) int32.

    0 in row 0, which is for none.

    The evidence of a place is the mean over its voxels with points of objects, less the prior,
    weighted with the scans that hit them; nearer 0 if these were fewer than ``votes``.

    Args:
        up, hits, clear, grazed, weights: as in ``visit`` and ``clearness``.
    """
    found = np.zeros(len(places), np.float32)
    for k in prange(1, len(places)):
        block = places[k] >> 2
        x0 = (places[k] >> 1 & 1) * 4
        y0 = (places[k] & 1) * 4
        total = 0.0
        summed = 0.0
        for w in range(x0, x0 + 4):
            word = up[block, w] & HALF << np.uint64(8 * y0)
            while word:
                rest = word & (word - ONE)
                v = w << 6 | BIT_OF[(word ^ rest) * SEQUENCE >> np.uint64(58)]
                h = hits[block, v]
                c = clear[block, v]
                q = grazed[block, v]
                word = rest
                if h > 1 or c > 0 or q > 0:
                    summed += h * (clearness(h, c, q, weights) - weights[3])
                    total += h
        found[k] = summed / max(total, weights[2])
    return found


@njit(cache=True, nogil=True, inline="always")
def _total(r, own, shared, link):
    """The evidence of the place in a row, with what it inherits; above 0 if it is dynamic.

    See ``certainties``.
    """
    return own[r] + link * max(shared[r], 0.0)


@njit(cache=True, nogil=True, parallel=True)
def certainties(rows, begins, own, shared, link, full):
    """How certain it is that each object is dynamic, (O,) float64 from -1 to 1.

    The mean of its places.

    Args:
        rows: (V,) int32: the row of the place of each visit, by object; begins: (O + 1,) int64: the
            first ones.
        own, shared: (R + 1,) float32: evidence of places, and the mean certainty of the objects
            that were there.
        link: weight of what a place inherits from these; full: what is full certainty. Places weigh
            1, certain ones 2.
    """
    found = np.empty(len(begins) - 1)
    for of in prange(len(found)):
        total = 0.0
        weight = 0.0
        for k in range(begins[of], begins[of + 1]):
            f = min(max(_total(rows[k], own, shared, link) / full, -1.0), 1.0)
            total += f * (1.0 + abs(f))
            weight += 1.0 + abs(f)
        found[of] = total / max(weight, 1.0)
    return found


@njit(cache=True, nogil=True)
def share(firsts, numbers, rows, begins, certain, size):
    """What places inherit from the objects that were there.

    Args:
        firsts: (F + 1,) int64: the first object of each scan; numbers: (F,) int32, of these scans.
        rows, begins: as in ``certainties``; certain: (O,) float64, of objects.
        size: number of rows, R + 1.

    Returns:
        shared: (R + 1,) float32: mean certainty, 0 where none was.
        source: (R + 1,) int32: number of the last scan with a certainty above 0; -1 for none.
    """
    visits = np.zeros(size, np.int32)
    shared = np.zeros(size, np.float32)
    source = np.full(size, np.int32(-1))
    for t in range(len(numbers)):
        for of in range(firsts[t], firsts[t + 1]):
            for k in range(begins[of], begins[of + 1]):
                r = rows[k]
                visits[r] += 1
                shared[r] += (certain[of] - shared[r]) / visits[r]
                if certain[of] > 0:
                    source[r] = numbers[t]
    return shared, source


@njit(cache=True, nogil=True)
def reaches(points, objects, count):
    """(O, 8) float32, metres, world frame.

    How far each object reaches in the ``WAYS``, along x + y and x - y as well.

    Args:
        points: (N, 3) float32, metres, world frame; objects: (N,) int32, that of each, -1 for none.
        count: number of objects.
    """
    found = np.full((count, 8), np.float32(-np.inf))
    slant = np.float32(WAYS[2, 0])
    for i in range(len(points)):
        of = objects[i]
        if of >= 0:
            x = points[i, 0]
            y = points[i, 1]
            along = x, y, slant * (x + y), slant * (x - y)
            for k in range(4):
                found[of, k] = max(found[of, k], along[k])
                found[of, k + 4] = max(found[of, k + 4], -along[k])
    return found


@njit(cache=True, nogil=True)
def _way(before, after, guard):
    """Along which of the ``WAYS`` an object is displaced, given how far it reaches.

    (8,) metres each; -1 if it is not.

    By a translation of at least twice the guard, to half of it.
    """
    x = (after[0] - before[0] - after[4] + before[4]) / 2
    y = (after[1] - before[1] - after[5] + before[5]) / 2
    if (
        x * x + y * y < 4 * guard * guard
    ):  # most objects stand: to see this first saves a third of the time
        return -1
    way = 0
    far = 0.0
    for k in range(8):
        along = x * WAYS[k, 0] + y * WAYS[k, 1]
        if abs(after[k] - before[k] - along) > guard / 2:
            return -1
        if along > far:
            way = k
            far = along
    return way if far >= 2 * guard else -1


@njit(cache=True, nogil=True)
def _end(rows, way, limit, centres, scans, than, own, shared, link):
    """Whether most places of an object beyond a limit along one of the ``WAYS`` are of scans after
    one; are dynamic.
    """
    count = 0
    free = 0
    dynamic = 0
    for r in rows:
        if centres[r, 0] * WAYS[way, 0] + centres[r, 1] * WAYS[way, 1] > limit:
            count = count + 1
            free = free + (scans[r] > than)
            dynamic += _total(r, own, shared, link) > 0
    return 2 * free > count, 2 * dynamic > count


@njit(cache=True, nogil=True)
def _before(firsts, at, columns, width):
    """(O,) int64: the object that each one continues, as in ``moved``; -1 for none."""
    found = np.full(len(at) - 1, -1)
    shared = np.zeros(len(at) - 1, np.int64)
    last = np.full(width, -1)
    for t in range(len(firsts) - 1):
        for of in range(firsts[t], firsts[t + 1]):
            most = -1
            its = columns[at[of] : at[of + 1]]
            for c in its:
                other = last[c]
                if other >= 0:
                    shared[other] += 1
                    most = other if most < 0 or shared[other] > shared[most] else most
            if most >= 0 and 2 * shared[most] > min(at[most + 1] - at[most], len(its)):
                found[of] = most
            for c in its:
                if last[c] >= 0:
                    shared[last[c]] = 0
        for of in range(firsts[t], firsts[t + 1]):
            last[columns[at[of] : at[of + 1]]] = of
    return found


@njit(cache=True, nogil=True)
def moved(
    firsts, at, columns, width, reach, guard, steps, least, centres, rows, begins, own, shared, link
):
    """(O,) bool: objects that moved along themselves, of whose middle nothing was ever seen clear.

    Each object continues the last one with which it shares most columns, if these are more than
    half of one of them. It is displaced from where an earlier one was, up to ``steps`` before it,
    if its outline is, if nothing was at its new end before and nothing at the old one since, and if
    one of these is dynamic; all for most places. An object has moved if it is displaced from more
    than a share of the earlier ones, or of the later ones.

    Args:
        firsts, at, columns, width: as in ``follow``.
        reach: (O, 8) float32, metres, as from ``reaches``; guard: metres; steps: number of scans;
            least: the share.
        centres: (R + 1, 2) float32, metres: those of places; rows, begins, own, shared, link: as in
            ``certainties``.
    """
    came = np.full(len(own), -1)
    gone = np.empty(len(own), np.int64)
    when = np.empty(len(reach), np.int64)
    for t in range(len(firsts) - 1):
        when[firsts[t] : firsts[t + 1]] = t
        for r in rows[begins[firsts[t]] : begins[firsts[t + 1]]]:
            came[r] = t if came[r] < 0 else came[r]
            gone[r] = -t
    of_places = (own, shared, link)
    before = _before(firsts, at, columns, width)
    compared = np.zeros((2, len(reach)), np.int64)
    displaced = np.zeros((2, len(reach)), np.int64)
    for of in range(len(reach)):
        other = before[of]
        mine = rows[begins[of] : begins[of + 1]]
        for _ in range(steps):
            if other < 0:
                break
            way = _way(reach[other], reach[of], guard)
            compared[0, of] += 1
            compared[1, other] += 1
            if way >= 0:
                back = (way + 4) % 8
                theirs = rows[begins[other] : begins[other + 1]]
                new, one = _end(
                    mine, way, reach[other, way], centres, came, when[other], *of_places
                )
                old, two = _end(theirs, back, reach[of, back], centres, gone, -when[of], *of_places)
                if new and old and (one or two):
                    displaced[0, of] += 1
                    displaced[1, other] += 1
            other = before[other]
    over = displaced > least * compared
    return over[0] | over[1]


@njit(cache=True, nogil=True)
def follow(firsts, at, columns, width, dynamic, back):
    """Follow dynamic objects through the scans.

    An object that continues a dynamic one is dynamic, too.

    It continues the last dynamic objects of its columns if it covers more than half of each, and
    they, together, at least half of it and more than half of those of its columns that any object
    had visited by then; or as a part of one, which covers more than half of it, in columns to which
    a track came before anything else. Where a track begins, something else may have been. A column
    does not count for a dynamic object if one that is not dynamic, nor larger, was there in the
    same scan: what is there afterwards may be the other one. In both cases, the columns of those on
    the way to it that are dynamic by themselves, less those of the others, must once have been as
    many as its own: a fragment tells nothing about what it merges into, nor errors of single scans
    about what stands.

    Args:
        firsts: (F + 1,) int64: the first object of each scan.
        at: (O + 1,) int64: where the columns of each object begin; columns: (K,) int32, below
            ``width``.
        dynamic: (O,) bool. Modified.
        back: backwards in time.
    """
    scans = len(firsts) - 1
    shared = np.zeros(len(dynamic), np.int64)
    last = np.full(width, -1)
    free = np.zeros(width, np.bool_)
    came = np.zeros(len(dynamic), np.bool_)
    # steps: the first of a column, of an object
    since = np.full(width, scans)
    when = np.empty(len(dynamic), np.int64)
    # by object: columns of its track that are dynamic, less others
    run = np.where(dynamic, np.diff(at), -np.diff(at))
    shown = np.maximum(run, 0)  # the most that these ever were
    # by column: columns of the smallest object of the scan that is not dynamic
    smallest = np.empty(width, np.int64)
    for step in range(scans):
        t = scans - 1 - step if back else step
        for of in range(firsts[t], firsts[t + 1]):
            its = columns[at[of] : at[of + 1]]
            size = at[of + 1] - at[of]
            when[of] = step
            for c in its:
                if last[c] >= 0:
                    shared[last[c]] += 1
            covered = 0
            part = 0
            known = 0
            seen = -1
            most = 0
            before = 0
            for c in its:
                other = last[c]
                covers = other >= 0 and 2 * shared[other] > at[other + 1] - at[other]
                within = other >= 0 and 2 * shared[other] > size and free[c]
                covered = covered + covers
                part = part + within
                if covers or within:
                    most = max(most, shown[other])
                    before = max(before, run[other])
                if covers:
                    seen = max(seen, when[other])
            for c in its:
                known += since[c] <= seen
            if (2 * covered > known and 2 * covered >= size) or 2 * part > size:
                came[of] = True
                run[of] = max(run[of] + before, 0)
                shown[of] = max(most, run[of])
                dynamic[of] |= shown[of] >= size
            for c in its:
                if last[c] >= 0:
                    shared[last[c]] = 0
        smallest[:] = width + 1
        for of in range(firsts[t], firsts[t + 1]):
            for c in columns[at[of] : at[of + 1]]:
                free[c] |= dynamic[of] and came[of] and since[c] > step
                since[c] = min(since[c], step)
                if not dynamic[of]:
                    smallest[c] = min(smallest[c], at[of + 1] - at[of])
        for of in range(firsts[t], firsts[t + 1]):
            for c in columns[at[of] : at[of + 1]]:
                if dynamic[of] and smallest[c] > at[of + 1] - at[of]:
                    last[c] = of


@njit(cache=True, nogil=True, parallel=True)
def outcomes(voxels, bands, rows, own, shared, link, hits, clear, grazed, weights, codes):
    """(N,) uint8: the reason code of each point, without feet.

    Args:
        voxels: (N,) int64, -1 for none.
        bands: (N,) uint8, as from ``scan_ground.bands``.
        rows: (4 B,) int32: the row of each place, 0 for none; own, shared, link: as in
            ``certainties``.
        hits, clear, grazed, weights: as in ``of_voxel``.
        codes: of points out of reach, near the ground, high, kept though seen clear, kept and never
            seen clear; removed by the evidence of their place alone, or with what it inherits.
    """
    out, near_ground, above, little, never, seen, followed = codes
    found = np.empty(len(voxels), np.uint8)
    for i in prange(len(voxels)):
        v = voxels[i]
        r = rows[v >> 9 << 2 | (v >> 8 & 1) << 1 | v >> 5 & 1]
        if v < 0:
            found[i] = out
        elif bands[i] < 2:
            found[i] = near_ground
        elif bands[i] > 2:
            found[i] = above
        elif _total(r, own, shared, link) > 0:
            found[i] = seen if own[r] > 0 else followed
        else:  # most voxels were never clear: to read one count is faster than all
            some = clear[v >> 9, v & 511] and of_voxel(v, hits, clear, grazed, weights) > 0
            found[i] = little if some else never
    return found
