"""Disjoint sets of numbers: ``parent[i]`` is a number of the same set, i itself for its root."""

from numba import njit


@njit(cache=True, nogil=True, inline="always")
def root_of(parent, i):
    """The number that represents the set of i."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def unite(parent, i, j):
    """Join two sets; the smaller root represents both."""
    i = root_of(parent, i)
    j = root_of(parent, j)
    parent[max(i, j)] = min(i, j)
