"""Readable twin of the exact signs: rational arithmetic, and vertices truly displaced."""

from fractions import Fraction

from morphofold.intersections.signs import TIE_BREAKING_DIRECTION


def fractions(point):
    return [Fraction(float(x)) for x in point]


def rational_sign(a, b, c, d, weight=1):
    """Twin of ``plane_sign``: (d - weight a) . ((b - a) x (c - a)) in rational arithmetic."""
    a, b, c, d = (p if isinstance(p, list) else fractions(p) for p in (a, b, c, d))
    u, v = [x - y for x, y in zip(b, a)], [x - y for x, y in zip(c, a)]
    w = [x - weight * y for x, y in zip(d, a)]
    n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    volume = sum(x * y for x, y in zip(w, n))
    return (volume > 0) - (volume < 0)


def displaced(verts):
    """The vertices displaced along TIE_BREAKING_DIRECTION, each by 1e-60 of the one before.

    This is the definition of ``side``.
    """
    aside = fractions(TIE_BREAKING_DIRECTION)
    return [[x + u * Fraction(10) ** (-60 * (k + 1)) for x, u in zip(fractions(p), aside)] for k, p in enumerate(verts)]
