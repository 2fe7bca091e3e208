"""Scratch memory of a scan for the blocks that its rays reach."""

from numba import njit


@njit(cache=True, nogil=True, inline="always")
def slot_of_block(slots, owners, masks, used, block):
    """The scratch memory of a block in this scan; allocated and cleared on first use.

    Args:
        slots: (B,) int32: the slot of each block, 0 for none. Modified.
        owners: (S,): the block of each slot. Modified.
        masks: (S, words): bits of each slot. Modified.
        used: number of slots in use.
        block: number of the block.

    Returns:
        slot: of the block.
        used: number of slots in use.
    """
    slot = slots[block]
    if slot == 0:
        used += 1
        slot = used
        slots[block] = slot
        owners[slot] = block
        masks[slot] = 0
    return slot, used
