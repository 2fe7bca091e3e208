"""Tracks: an object that continues a dynamic one is dynamic, too.

Seen from above, objects are in columns of blocks. ``last`` has the dynamic object that was last in
each column. An object continues those in its columns.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def follow(firsts, at, columns, width, dynamic, back):
    """Follow dynamic objects through the scans.

    In each scan, every object looks for what it continues (``continued``). If it continues dynamic
    objects, and enough columns of its track were dynamic by themselves, it is dynamic. Then the
    scan is remembered: where a track came before anything else (``claim``), and which object was in
    each column last (``leave``).

    Enough: the columns of those on the way to it that are dynamic by themselves, less those of the
    others, must once have been as many as its own. A fragment tells nothing about what it merges
    into, nor errors of single scans about what stands.

    Args:
        firsts: (F + 1,) int64: the first object of each scan.
        at: (O + 1,) int64: where the columns of each object begin; columns: (K,) int32, below
            ``width``.
        dynamic: (O,) bool. Modified.
        back: backwards in time.
    """
    scans = len(firsts) - 1
    sizes = np.diff(at)
    shared = np.zeros(len(dynamic), np.int64)  # by object: columns shared with the present one
    last = np.full(width, -1)
    free = np.zeros(width, np.bool_)  # columns to which a track came before anything else
    since = np.full(width, scans)  # by column: the step of its first object
    when = np.empty(len(dynamic), np.int64)  # by object: its step
    came = np.zeros(len(dynamic), np.bool_)  # objects that continue a track
    # by object: columns of its track that are dynamic by themselves, less others
    run = np.where(dynamic, sizes, -sizes)
    shown = np.maximum(run, 0)  # the most that these ever were
    smallest = np.empty(width, np.int64)
    for step in range(scans):
        t = scans - 1 - step if back else step
        its_objects = range(firsts[t], firsts[t + 1])
        for of in its_objects:
            when[of] = step
            its = columns[at[of] : at[of + 1]]
            count_shared(its, last, shared)
            found, most, before = continued(its, sizes, last, shared, free, since, when, shown, run)
            if found:
                came[of] = True
                run[of] = max(run[of] + before, 0)
                shown[of] = max(most, run[of])
                dynamic[of] |= shown[of] >= sizes[of]
            reset_shared(its, last, shared)
        smallest[:] = width + 1
        for of in its_objects:
            its = columns[at[of] : at[of + 1]]
            claim(its, dynamic[of] and came[of], step, free, since)
            if not dynamic[of]:
                shrink(its, sizes[of], smallest)
        for of in its_objects:
            if dynamic[of]:
                leave(columns[at[of] : at[of + 1]], of, sizes[of], smallest, last)


@njit(cache=True, nogil=True)
def count_shared(its, last, shared):
    """Count, for the last object of each column, how many columns of an object it was in."""
    for c in its:
        if last[c] >= 0:
            shared[last[c]] += 1


@njit(cache=True, nogil=True)
def reset_shared(its, last, shared):
    """Undo ``count_shared``."""
    for c in its:
        if last[c] >= 0:
            shared[last[c]] = 0


@njit(cache=True, nogil=True)
def continued(its, sizes, last, shared, free, since, when, shown, run):
    """Whether an object continues dynamic ones; the most columns that they ever showed; and their
    columns now.

    It continues them as a whole if it covers more than half of each, and they, together, at least
    half of it and more than half of those of its columns that any object had visited by then. It
    continues one as a part of it if that covers more than half of it, in columns to which a track
    came before anything else. Where a track begins, something else may have been.

    Args:
        its: (C,) int32, columns of the object; the others as in ``follow``.
    """
    size = len(its)
    covered = 0
    part = 0
    seen = -1
    most = 0
    before = 0
    for c in its:
        other = last[c]
        covers = other >= 0 and 2 * shared[other] > sizes[other]
        within = other >= 0 and 2 * shared[other] > size and free[c]
        covered = covered + covers
        part = part + within
        if covers or within:
            most = max(most, shown[other])
            before = max(before, run[other])
        if covers:
            seen = max(seen, when[other])
    known = 0
    for c in its:
        known += since[c] <= seen
    as_whole = 2 * covered > known and 2 * covered >= size
    as_part = 2 * part > size
    return as_whole or as_part, most, before


@njit(cache=True, nogil=True)
def claim(its, continues, step, free, since):
    """Mark the columns to which an object that continues a track comes before anything else."""
    for c in its:
        free[c] |= continues and since[c] > step
        since[c] = min(since[c], step)


@njit(cache=True, nogil=True)
def shrink(its, size, smallest):
    """Keep the size of the smallest object that is not dynamic, by column."""
    for c in its:
        smallest[c] = min(smallest[c], size)


@njit(cache=True, nogil=True)
def leave(its, of, size, smallest, last):
    """Leave a dynamic object in its columns, where nothing static is as small.

    Otherwise, what is there afterwards may be the static one.
    """
    for c in its:
        if smallest[c] > size:
            last[c] = of
