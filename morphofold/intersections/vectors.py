"""Arithmetic of points and vectors in kernels: three numbers in, a tuple of three out, nothing allocated."""

from numba import njit


@njit(cache=True)
def less(a, b):
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(cache=True)
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def area_vector(a, b, c):
    """Normal of the triangle abc, outward where it runs counter-clockwise, twice its area long."""
    return cross(less(b, a), less(c, a))
