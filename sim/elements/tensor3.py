"""Vectors of three numbers, and 3x3 matrices of nine, column by column, as tuples: for kernels of 32 or 64 bits.

A symmetric matrix has six numbers, 00 01 02 11 12 22. What takes vectors takes the first columns of matrices, too. All
sums are in the order of the entries.

LLVM chooses anew in each function which of two equal sums of products it fuses. So where a function ends decides about
the last bit: what is ``spelled_out`` is as if it stood in its caller; what is ``inlined`` is a function of its own.
"""

from numba import njit

from morphofold.sim.elements.lanes import ROW, UINT, inlined

spelled_out = njit(inline="always")


@spelled_out
def in_precision_of(like, number):
    """A constant in the precision of ``like``; a constant in 64 bits would widen all results."""
    return type(like)(number)


@spelled_out
def read3(array, start):
    """The three rows from ``start``."""
    return array[start], array[start + ROW], array[start + UINT(2) * ROW]


@inlined
def read9(array, start):
    """The nine rows from ``start``."""
    return read3(array, start) + read3(array, start + UINT(3) * ROW) + read3(array, start + UINT(6) * ROW)


@spelled_out
def write3(array, start, values):
    """Write the three rows from ``start``."""
    array[start], array[start + ROW], array[start + UINT(2) * ROW] = values[0], values[1], values[2]


@inlined
def write9(array, start, values):
    """Write the nine rows from ``start``."""
    write3(array, start, values)
    write3(array, start + UINT(3) * ROW, values[3:6])
    write3(array, start + UINT(6) * ROW, values[6:9])


@spelled_out
def plus(u, v):
    return u[0] + v[0], u[1] + v[1], u[2] + v[2]


@spelled_out
def minus(u, v):
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


@spelled_out
def dot(u, v):
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@spelled_out
def cross(u, v):
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@spelled_out
def inner(a, b):
    """A : B."""
    partial_sum = dot(a, b) + a[3] * b[3] + a[4] * b[4] + a[5] * b[5]
    return partial_sum + a[6] * b[6] + a[7] * b[7] + a[8] * b[8]


@inlined
def det(a):
    return dot(a, cross(a[3:6], a[6:9]))


@inlined
def cofactor(a):
    """Cofactors of A, det A A^-T: the columns b x c, c x a, a x b from its columns a, b, c."""
    return cross(a[3:6], a[6:9]) + cross(a[6:9], a) + cross(a, a[3:6])


@inlined
def transposed(a):
    return a[0::3] + a[1::3] + a[2::3]


@spelled_out
def symmetric(b):
    """The nine numbers of a symmetric matrix."""
    return b[0], b[1], b[2], b[1], b[3], b[4], b[2], b[4], b[5]


@spelled_out
def times(a, u):
    """A u."""
    return dot(a[0::3], u), dot(a[1::3], u), dot(a[2::3], u)


@inlined
def product(a, b):
    """A B."""
    return times(a, b) + times(a, b[3:6]) + times(a, b[6:9])


@spelled_out
def scaled(s, a):
    """s A."""
    return s * a[0], s * a[1], s * a[2], s * a[3], s * a[4], s * a[5], s * a[6], s * a[7], s * a[8]


@spelled_out
def _vector_combination(f, u, s, v):
    return f * u[0] + s * v[0], f * u[1] + s * v[1], f * u[2] + s * v[2]


@spelled_out
def combination(f, a, s, b):
    """f A + s B."""
    first_column = _vector_combination(f, a, s, b)
    return first_column + _vector_combination(f, a[3:6], s, b[3:6]) + _vector_combination(f, a[6:9], s, b[6:9])


@inlined
def left_cauchy_green(a, d, scale):
    """``scale`` A D^T, of which it takes for granted that it is symmetric: six numbers."""
    a0, a1, d1, d2 = a[0::3], a[1::3], d[1::3], d[2::3]
    return (
        scale * dot(a0, d[0::3]),
        scale * dot(a0, d1),
        scale * dot(a0, d2),
        scale * dot(a1, d1),
        scale * dot(a1, d2),
        scale * dot(a[2::3], d2),
    )


@inlined
def second_invariant(I1, b):
    """I2 = (I1^2 - tr(b b)) / 2 for symmetric b, six numbers."""
    two = in_precision_of(I1, 2.0)
    trace_bb = b[0] * b[0] + b[3] * b[3] + b[5] * b[5] + two * (b[1] * b[1] + b[2] * b[2] + b[4] * b[4])
    return in_precision_of(I1, 0.5) * (I1 * I1 - trace_bb)


@inlined
def _scaled_times(b, h, u):
    """h b u."""
    product = times(symmetric(b), u)
    return h * product[0], h * product[1], h * product[2]


@spelled_out
def minus_product(p, h, b, a):
    """P - h b A for symmetric b, six numbers."""
    first_column = minus(p, _scaled_times(b, h, a))
    return first_column + minus(p[3:6], _scaled_times(b, h, a[3:6])) + minus(p[6:9], _scaled_times(b, h, a[6:9]))


@spelled_out
def refined_inverse_cube_root(J, root):
    """J^-1/3 to round-off from an approximation, by steps of fourth order: three in 64 bits and two in 32."""
    one = in_precision_of(J, 1.0)
    for _ in range(2 if one + in_precision_of(J, 1e-12) == one else 3):
        residual = one - J * root * root * root
        correction = in_precision_of(J, 2.0 / 9.0) + residual * in_precision_of(J, 14.0 / 81.0)
        root += root * residual * (in_precision_of(J, 1.0 / 3.0) + residual * correction)
    return root


@spelled_out
def halley_step(r):
    """What brings y nearer to J^-1/3 if it is multiplied by it, at r = J y^3."""
    two = in_precision_of(r, 2.0)
    return (r + two) / (two * r + in_precision_of(r, 1.0))
