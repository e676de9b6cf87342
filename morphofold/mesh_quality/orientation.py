"""Which triangles are neighbours, also where more than two share an edge, and which of them are flipped.

A *side* of a triangle has the number of the corner where it starts: side 3 t + k of triangle t runs from its corner k
to the next one. Two sides along one edge that belong together are *joined*.
"""

from dataclasses import dataclass

import numpy as np

from morphofold.arrays import Bools, Ints
from morphofold.geometry import connected
from morphofold.surface import Faces


@dataclass(frozen=True, eq=False)
class Sides:
    """How the sides of triangles are joined.

    Attributes
    ----------
    joined : (P, 2) int64
        Sides that belong together, each side at most once.
    crowded : (C,) int64
        Sides of edges with more than two triangles.
    border : (B,) int64
        Sides of edges with one triangle.
    left : (L,) int64
        Sides of crowded edges for which no partner was found.
    fan : (3 M,) int64
        Fan of each corner, as in :func:`fans`.
    """

    joined: Ints
    crowded: Ints
    border: Ints
    left: Ints
    fan: Ints


def joined_sides(faces: Faces) -> Sides:
    """Sides that belong together: the two of an edge, or, of more than two, those that the surface joins elsewhere.

    Around a vertex, triangles are neighbours across edges with two triangles. A chain of neighbours that begins and
    ends at the same crowded edge is one sheet of surface, so its first and last side are joined. This may close chains
    around the other end of the edge. If two sides are left at an edge at the end, they belong together.
    """
    corner = faces.ravel()
    ends = np.sort([corner, corner[after(np.arange(len(corner)))]], axis=0)
    key = ends[0] * (int(corner.max()) + 1) + ends[1]
    order = np.argsort(key, kind="stable")
    begin = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(begin, append=len(key))
    two, many = begin[count == 2], np.repeat(count > 2, count)
    joined = np.column_stack([order[two], order[two + 1]])
    crowded = order[many]
    rest, edge = crowded, np.repeat(np.arange(len(count)), count)[many]
    fan = fans(faces, joined)
    while len(rest):
        ways = _corners_at_ends(rest, corner)
        found = _pairs_to_join(edge, fan[ways[0]])
        found = found if len(found) else _pairs_to_join(edge, fan[ways[1]])
        found = found if len(found) else _pairs_to_join(edge, np.zeros(len(edge), dtype=np.int64))
        if len(found) == 0:
            break
        joined = np.concatenate([joined, rest[found]])
        fan = fans(faces, joined)
        rest, edge = np.delete(rest, found), np.delete(edge, found)
    return Sides(joined, crowded, order[begin[count == 1]], rest, fan)


def _corners_at_ends(side: Ints, corner: Ints) -> tuple[Ints, Ints]:
    """Corners of sides at both ends of their edge. The end with more triangles (of two welded vertices) first."""
    far, size = after(side), np.bincount(corner)
    a, b = corner[side], corner[far]
    here = (size[a] > size[b]) | ((size[a] == size[b]) & (a < b))
    return np.where(here, side, far), np.where(here, far, side)


def _pairs_to_join(edge: Ints, fan: Ints) -> Ints:
    """Pairs (P, 2) of rows where exactly two have the same edge and fan."""
    order = np.lexsort((fan, edge))
    begin = np.flatnonzero((np.diff(edge[order], prepend=-1) != 0) | (np.diff(fan[order], prepend=-1) != 0))
    two = begin[np.diff(begin, append=len(edge)) == 2]
    return np.column_stack([order[two], order[two + 1]])


def after(side: Ints) -> Ints:
    """The next side of the same triangle; it begins where this one ends."""
    return side - side % 3 + (side + 1) % 3


def fans(faces: Faces, joined: Ints) -> Ints:
    """Number (3 M,) of the fan of each corner. A fan is the joined triangles around a vertex."""
    corner, (one, other) = faces.ravel(), joined.T
    same = corner[one] == corner[other]
    far = after(other)
    i, j = (one, after(one)), (np.where(same, other, far), np.where(same, far, other))
    return connected(len(corner), np.column_stack([np.concatenate(i), np.concatenate(j)]))


def sheets(faces: Faces, joined: Ints) -> Ints:
    """Number (M,) of the sheet of each triangle. A sheet is a set of joined triangles."""
    return connected(len(faces), joined // 3)


def against(faces: Faces, joined: Ints) -> Bools | None:
    """Triangles (M,) oriented against the majority of their piece; None if a piece has one side only.

    Each triangle is taken in both orientations, and those that agree across joined sides form one part. On a piece with
    two sides, the two orientations of a triangle lie in two parts. The part with more triangles as given is right.
    """
    corner, m = faces.ravel(), len(faces)
    same = corner[joined[:, 0]] == corner[joined[:, 1]]  # one of the two is flipped
    if not same.any():
        return np.zeros(m, dtype=bool)
    one, other = (joined // 3).T
    shift = np.where(same, m, 0)
    ways = np.concatenate([one, one + m]), np.concatenate([other + shift, other + m - shift])
    part = connected(2 * m, np.column_stack(ways))
    as_is, turned = part[:m], part[m:]
    if (as_is == turned).any():
        return None
    votes = np.bincount(as_is, minlength=int(part.max()) + 1)
    return (votes[as_is] < votes[turned]) | ((votes[as_is] == votes[turned]) & (as_is > turned))
