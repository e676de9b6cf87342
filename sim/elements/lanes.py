"""Lanes: elements are stored in blocks of ``LANES``, arrays as (block, rows * LANES) with the lane fastest.

So each loop over lanes becomes vector instructions (with unsigned indices and constant row offsets: otherwise LLVM
can't exclude overlap and stays scalar, six times slower). This file has the parts of the kernels that know nodes:
reading positions, adding up forces.
"""

import numpy as np
from llvmlite import ir
from numba import njit, prange, types
from numba.core import cgutils
from numba.extending import intrinsic

from morphofold.kernels import kernel

LANES = 32  # lanes per block
CORNER_SCALE = 0.125  # positions and forces of bricks are scaled by this, so that their kernels need no such factors

FAST_MATH = {"contract", "nsz", "arcp", "nnan", "ninf"}
UINT = np.uint64
ROW = UINT(LANES)  # from one row to the next
_FACE = UINT(3 * LANES)  # of one corner of the quads on one face: three coordinates

#: decorates what becomes part of the loops of its callers
inlined = njit(forceinline=True, fastmath=FAST_MATH)


@intrinsic
def prefetch(typing_context, array, index):
    """Prefetch the cache line of element ``index`` of a contiguous array, so that the next block's data are there."""

    def code(context, builder, signature, arguments):
        array_data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        byte_pointer, i32 = ir.IntType(8).as_pointer(), ir.IntType(32)
        llvm_prefetch = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.VoidType(), [byte_pointer, i32, i32, i32]), "llvm.prefetch.p0"
        )
        address = builder.bitcast(builder.gep(array_data, [arguments[1]]), byte_pointer)
        builder.call(llvm_prefetch, [address, i32(0), i32(2), i32(1)])  # for reading, into the second-level cache, data
        return context.get_dummy_value()

    return types.void(array, types.intp), code


@njit(forceinline=True)
def fetch(x, nodes, local_row, n_corners, next_data, nodal, corner_x):
    """Read corner positions of a block: coordinate r of corner c into row 3 c + r of ``corner_x``.

    ``next_data``, the data of the next block, is prefetched into the cache; ``nodal`` is scratch.
    """
    for row in range(len(nodes)):
        node = nodes[row]
        nodal[row, 0], nodal[row, 1], nodal[row, 2] = x[node, 0], x[node, 1], x[node, 2]
    for corner in range(n_corners):
        for lane in range(LANES):
            row = local_row[corner * LANES + lane]
            i = 3 * corner * LANES + lane
            corner_x[i], corner_x[i + LANES], corner_x[i + 2 * LANES] = nodal[row, 0], nodal[row, 1], nodal[row, 2]
            prefetch(next_data, 8 * (corner * LANES + lane))  # a cache line holds 8 numbers of 64 bits


@njit(forceinline=True)
def deliver(corner_force, local_row, n_corners, force):
    """Add the forces in ``corner_force`` (laid out as by ``fetch``) to the rows (rows, 3) of a block."""
    for corner in range(n_corners):
        for lane in range(LANES):
            row = local_row[corner * LANES + lane]
            i = 3 * corner * LANES + lane
            force[row, 0] += corner_force[i]
            force[row, 1] += corner_force[i + LANES]
            force[row, 2] += corner_force[i + 2 * LANES]


@njit(forceinline=True)
def read_level(x, nodes, local_row, nodal, origin, shift, corner_x):
    """Step down a column of bricks: their lower face becomes the upper one, and the next level of nodes is read.

    Coordinate r of corner c = 2 q + k of a brick is row 3 c + r of ``corner_x``; q is the corner of the quad, k is 1 on
    the upper face. Positions are times ``CORNER_SCALE``, relative to the brick's first corner (whose rows stay 0):
    subtracted in 64 bits, for precision if ``corner_x`` has 32. ``origin`` (3 LANES) holds that corner; ``nodal``
    (rows, 3) and ``shift`` (3 LANES) are scratch. ``nodes`` are those of the level; ``local_row`` (4 LANES): ``local``
    of ``Columns``.
    """
    for s in range(len(nodes)):
        n = nodes[s]
        nodal[s, 0], nodal[s, 1], nodal[s, 2] = CORNER_SCALE * x[n, 0], CORNER_SCALE * x[n, 1], CORNER_SCALE * x[n, 2]
    for lane in range(LANES):
        s = local_row[lane]
        shift[lane], shift[LANES + lane], shift[2 * LANES + lane] = nodal[s, 0], nodal[s, 1], nodal[s, 2]
    for i in range(_FACE):
        previous, origin[i] = origin[i], shift[i]
        shift[i] = previous - shift[i]
    for corner in range(UINT(4)):
        lower_row = UINT(2) * corner * _FACE
        for i in range(_FACE):
            corner_x[lower_row + _FACE + i] = corner_x[lower_row + i] + shift[i]
    for corner in range(1, 4):
        row = 6 * corner * LANES
        for lane in range(LANES):
            s = local_row[corner * LANES + lane]
            corner_x[row + lane] = nodal[s, 0] - origin[lane]
            corner_x[row + LANES + lane] = nodal[s, 1] - origin[LANES + lane]
            corner_x[row + 2 * LANES + lane] = nodal[s, 2] - origin[2 * LANES + lane]


@njit(forceinline=True)
def add_level(corner_force, shared_force, local_row, force):
    """Add the forces on one level to its rows (rows, 3): those on the upper faces, and ``shared_force`` from above.

    ``corner_force`` is laid out as ``corner_x`` in :func:`read_level`; lower faces replace ``shared_force`` (12 LANES).
    """
    for corner in range(UINT(4)):
        lower_row, face_row = UINT(2) * corner * _FACE, corner * _FACE
        for i in range(_FACE):
            corner_force[lower_row + _FACE + i] += shared_force[face_row + i]
        for i in range(_FACE):
            shared_force[face_row + i] = corner_force[lower_row + i]
    for corner in range(4):
        row = (6 * corner + 3) * LANES
        for lane in range(LANES):
            node_row = local_row[corner * LANES + lane]
            force[node_row, 0] += corner_force[row + lane]
            force[node_row, 1] += corner_force[row + LANES + lane]
            force[node_row, 2] += corner_force[row + 2 * LANES + lane]


@kernel(parallel=True)
def gather(values, node_start, node_rows, out):
    """Nodal sums (N, C) of the rows of ``values`` (R, C); n owns ``node_rows[node_start[n]:node_start[n + 1]]``."""
    for node in prange(len(out)):
        for column in range(values.shape[1]):
            total = 0.0
            for k in range(node_start[node], node_start[node + 1]):
                total += values[node_rows[k], column]
            out[node, column] = total


@kernel(parallel=True)
def sum_forces(row_force, node_start, node_rows, rest_force, added_force, is_free, out):
    """Nodal forces (N, 3) on the free coordinates, 0 on the others.

    They are the sums of the rows of ``row_force`` (R, 3), less ``rest_force`` (N, 3), the round-off of the kernel in
    the reference state, so that a body that does not grow stays bitwise at rest; plus ``added_force`` (S, 3) on the
    first S nodes: surface filter and effects. ``is_free`` (N, 3) is True where a coordinate may move.
    """
    for node in prange(len(out)):
        f0, f1, f2 = 0.0, 0.0, 0.0
        for k in range(node_start[node], node_start[node + 1]):
            row = node_rows[k]
            f0 += row_force[row, 0]
            f1 += row_force[row, 1]
            f2 += row_force[row, 2]
        node_force = f0, f1, f2
        for axis in range(3):
            total = node_force[axis] - rest_force[node, axis]
            if node < len(added_force):
                total += added_force[node, axis]
            out[node, axis] = total if is_free[node, axis] else 0.0
