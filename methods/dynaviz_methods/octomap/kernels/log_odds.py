"""The log-odds update of a block grid. Bits are those of ``raycast.collect``."""

from numba import njit, prange


@njit(cache=True, nogil=True, parallel=True)
def update(log_odds, ever, blocks, bits, miss, hit, low, high):
    """Update each marked voxel once: add a miss and clamp, then a hit and clamp.

    Record voxels ever crossed or hit.

    Args:
        log_odds: (all blocks + 1, 512) float32. Modified.
        ever: (all blocks + 1, 16) int64, bits as from ``collect``. Modified.
        blocks, bits: the marks of a scan, as from ``collect``.
        miss, hit: increments, log-odds.
        low, high: clamping thresholds, log-odds.
    """
    for n in prange(len(blocks)):
        block = blocks[n]
        for w in range(8):
            crossed = bits[n, w]
            struck = bits[n, 8 + w]
            ever[block, w] |= crossed
            ever[block, 8 + w] |= struck
            if crossed | struck:
                values = log_odds[block, w << 6 : (w << 6) + 64]
                for v in range(64):  # without branches, so that it is vectorised
                    value = values[v]
                    value = max(value + miss, low) if crossed >> v & 1 else value
                    values[v] = min(value + hit, high) if struck >> v & 1 else value
