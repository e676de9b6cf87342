"""Blocks of elements: columns of bricks below each other."""

import numpy as np

from morphofold.sim.elements.blocks import Columns


def test_faces_whose_keys_agree_in_32_bits_stay_apart():
    """Scikit-fem numbers nodes in 32 bits, in which the products that tell faces apart overflow."""
    n = 2**17 + 1
    upper = np.array([[0, 1, 2, 2**15 + 5], [2**15, 3, 4, 5]])
    keys = upper[:, 0] * n + upper[:, 3]
    assert keys[0] != keys[1]
    assert keys[0] % 2**32 == keys[1] % 2**32
    corners = np.empty((2, 8), dtype=np.int32)
    corners[:, 1::2], corners[:, ::2] = upper, upper + 10
    columns = Columns(corners, n)
    assert columns.layers == 1
    assert sorted(columns.nodes) == sorted(corners.ravel())
