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
        byte_pointer, word = ir.IntType(8).as_pointer(), ir.IntType(32)
        llvm_prefetch = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.VoidType(), [byte_pointer, word, word, word]), "llvm.prefetch.p0"
        )
        line = builder.bitcast(builder.gep(array_data, [arguments[1]]), byte_pointer)
        builder.call(llvm_prefetch, [line, word(0), word(2), word(1)])  # for reading, into the second-level cache, data
        return context.get_dummy_value()

    return types.void(array, types.intp), code


@njit(forceinline=True)
def fetch(x, nodes, local, corners, ahead, nodal, xs):
    """Read corner positions of a block: coordinate r of corner c into row 3 c + r of ``xs``.

    ``ahead``, the data of the next block, is prefetched into the cache; ``nodal`` is scratch.
    """
    for s in range(len(nodes)):
        n = nodes[s]
        nodal[s, 0], nodal[s, 1], nodal[s, 2] = x[n, 0], x[n, 1], x[n, 2]
    for c in range(corners):
        for l in range(LANES):
            s = local[c * LANES + l]
            i = 3 * c * LANES + l
            xs[i], xs[i + LANES], xs[i + 2 * LANES] = nodal[s, 0], nodal[s, 1], nodal[s, 2]
            prefetch(ahead, 8 * (c * LANES + l))  # a cache line holds 8 numbers of 64 bits


@njit(forceinline=True)
def deliver(xs, local, corners, force):
    """Add the forces in ``xs`` (laid out as by ``fetch``) to the rows (rows, 3) of a block."""
    for c in range(corners):
        for l in range(LANES):
            s = local[c * LANES + l]
            i = 3 * c * LANES + l
            force[s, 0] += xs[i]
            force[s, 1] += xs[i + LANES]
            force[s, 2] += xs[i + 2 * LANES]


@njit(forceinline=True)
def read_level(x, nodes, local, nodal, origin, origin_shift, xs):
    """Step down a column of bricks: their lower face becomes the upper one, and the next level of nodes is read.

    Coordinate r of corner c = 2 q + k of a brick is row 3 c + r of ``xs``; q is the corner of the quad, k is 1 on the
    upper face. Positions are times ``CORNER_SCALE``, relative to the brick's first corner (whose rows stay 0):
    subtracted in 64 bits, for precision if ``xs`` has 32. ``origin`` (3 LANES) holds that corner; ``nodal``
    (rows, 3) and ``origin_shift`` (3 LANES) are scratch. ``nodes`` are those of the level; ``local`` (4 LANES): see
    ``Columns``.
    """
    for s in range(len(nodes)):
        n = nodes[s]
        nodal[s, 0], nodal[s, 1], nodal[s, 2] = CORNER_SCALE * x[n, 0], CORNER_SCALE * x[n, 1], CORNER_SCALE * x[n, 2]
    for l in range(LANES):
        s = local[l]
        origin_shift[l], origin_shift[LANES + l], origin_shift[2 * LANES + l] = nodal[s, 0], nodal[s, 1], nodal[s, 2]
    for i in range(_FACE):
        previous, origin[i] = origin[i], origin_shift[i]
        origin_shift[i] = previous - origin_shift[i]
    for q in range(UINT(4)):
        lower_row = UINT(2) * q * _FACE
        for i in range(_FACE):
            xs[lower_row + _FACE + i] = xs[lower_row + i] + origin_shift[i]
    for q in range(1, 4):
        row = 6 * q * LANES
        for l in range(LANES):
            s = local[q * LANES + l]
            xs[row + l] = nodal[s, 0] - origin[l]
            xs[row + LANES + l] = nodal[s, 1] - origin[LANES + l]
            xs[row + 2 * LANES + l] = nodal[s, 2] - origin[2 * LANES + l]


@njit(forceinline=True)
def add_level(f, shared, local, force):
    """Add the forces on one level to its rows (rows, 3): those on the upper faces, and ``shared`` from the layer above.

    ``f`` is laid out as ``xs`` in :func:`read_level`; the forces on its lower faces replace ``shared`` (12 LANES).
    """
    for q in range(UINT(4)):
        lower_row, face_row = UINT(2) * q * _FACE, q * _FACE
        for i in range(_FACE):
            f[lower_row + _FACE + i] += shared[face_row + i]
        for i in range(_FACE):
            shared[face_row + i] = f[lower_row + i]
    for q in range(4):
        row = (6 * q + 3) * LANES
        for l in range(LANES):
            s = local[q * LANES + l]
            force[s, 0] += f[row + l]
            force[s, 1] += f[row + LANES + l]
            force[s, 2] += f[row + 2 * LANES + l]


@kernel(parallel=True)
def gather(values, first, rows, out):
    """Nodal sums (N, C) of the rows of ``values`` (R, C); node n owns ``rows[first[n]:first[n + 1]]``."""
    for n in prange(len(out)):
        for r in range(values.shape[1]):
            total = 0.0
            for k in range(first[n], first[n + 1]):
                total += values[rows[k], r]
            out[n, r] = total


@kernel(parallel=True)
def sum_forces(force, first, rows, rest, extra, free, out):
    """Nodal forces (N, 3) on the free coordinates, 0 on the others.

    They are the sums of the rows of ``force`` (R, 3), less ``rest`` (N, 3), the round-off of the kernel in the
    reference state, so that a body that does not grow stays bitwise at rest; plus ``extra`` (S, 3), other forces on the
    first S nodes: surface filter and effects. ``free`` (N, 3) is True where a coordinate may move.
    """
    for n in prange(len(out)):
        f0, f1, f2 = 0.0, 0.0, 0.0
        for k in range(first[n], first[n + 1]):
            row = rows[k]
            f0 += force[row, 0]
            f1 += force[row, 1]
            f2 += force[row, 2]
        node_force = f0, f1, f2
        for r in range(3):
            total = node_force[r] - rest[n, r]
            if n < len(extra):
                total += extra[n, r]
            out[n, r] = total if free[n, r] else 0.0
