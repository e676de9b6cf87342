"""Blocks of elements: columns of bricks below each other."""

import numpy as np

from morphofold.sim.elements.blocks import Columns


def test_faces_whose_keys_agree_in_32_bits_stay_apart():
    """Scikit-fem numbers nodes in 32 bits, in which the products that tell faces apart overflow: a column was lost."""
    n = 2**17 + 1
    faces = [
        [[0, 1, 2, 2**15 + 5], [10, 11, 12, 13]],
        [[2**15, 3, 4, 5], [20, 21, 22, 23]],
    ]  # of two columns, downwards
    keys = np.array([face[0] * n + face[3] for face in (faces[0][0], faces[1][0])])
    assert keys[0] != keys[1]
    assert keys[0] % 2**32 == keys[1] % 2**32
    bricks = [(faces[0][0], faces[0][1]), ([30, 31, 32, 33], faces[1][0]), (faces[0][1], [40, 41, 42, 43]), faces[1]]
    corners = np.empty((4, 8), dtype=np.int32)
    for k, (upper, lower) in enumerate(bricks):
        corners[k, 1::2], corners[k, ::2] = upper, lower
    columns = Columns(corners, n)
    assert columns.layers == 2
    assert sorted(columns.nodes) == sorted(set(corners.ravel()))
