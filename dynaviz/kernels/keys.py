"""The layout of packed voxel keys: one int64 holds an index per axis, x in the highest bits.

``key = (x + REACH) << X_SHIFT | (y + REACH) << Y_SHIFT | (z + REACH)`` with each index in [-REACH,
REACH), so a key is never negative.

Constants only. Kernels import them as globals, which numba freezes when it compiles. Its cache on
disk does not notice a change of this file, so delete the caches after one.
"""

from __future__ import annotations

BITS = 21  # per axis
X_SHIFT = 2 * BITS
Y_SHIFT = BITS
REACH = 1 << (BITS - 1)  # voxels to each side of the origin
MASK = (1 << BITS) - 1  # of one axis
