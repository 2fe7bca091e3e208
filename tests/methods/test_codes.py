"""Reason codes survive packing, also an odd number of them."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz_methods.shared.codes import pack_codes, unpack_codes


@pytest.mark.parametrize("n", [0, 1, 16, 33])
def test_codes_survive_packing_in_half_a_byte_each(n: int) -> None:
    codes = (np.arange(n) * 7 % 16).astype(np.uint8)
    packed = pack_codes(codes)
    assert packed.nbytes == (n + 1) // 2
    np.testing.assert_array_equal(unpack_codes(packed, n), codes)
