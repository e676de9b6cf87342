"""Repair of triangle defects that have exactly one cure, on all surfaces of a cortex before it is measured or unfolded.

These are flipped triangles (on one surface or both), pieces that are inside out, edges that more than two triangles
share, torn seams, specks beside the cortex, and triangles that occur twice or name a vertex twice. Other defects stay,
and ``defects`` refuses them.

A *side* of a triangle has the number of the corner where it starts: side 3 t + k of triangle t runs from its corner k
to the next one. Two sides along one edge that belong together are *joined*.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from morphofold import geometry
from morphofold.arrays import Bools, Ints
from morphofold.geometry import connected
from morphofold.mesh_quality import checks, defects
from morphofold.surface import Cortex, Faces
from morphofold.unfolding.unfold import check_same_mesh


class Sides(NamedTuple):
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
        corners = _corners_at_ends(rest, corner)
        for groups in (fan[corners[0]], fan[corners[1]], np.zeros(len(edge), dtype=np.int64)):
            pairs = _pairs_to_join(edge, groups)
            if len(pairs):
                break
        else:
            break
        joined = np.concatenate([joined, rest[pairs]])
        fan = fans(faces, joined)
        rest, edge = np.delete(rest, pairs), np.delete(edge, pairs)
    return Sides(joined, crowded, order[begin[count == 1]], rest, fan)


def _corners_at_ends(side: Ints, corner: Ints) -> tuple[Ints, Ints]:
    """Corners of sides at both ends of their edge. The end with more triangles (of two welded vertices) first."""
    far, size = after(side), np.bincount(corner)
    a, b = corner[side], corner[far]
    first = (size[a] > size[b]) | ((size[a] == size[b]) & (a < b))
    return np.where(first, side, far), np.where(first, far, side)


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
    corner, (first, other) = faces.ravel(), joined.T
    same = corner[first] == corner[other]
    far = after(other)
    i, j = (first, after(first)), (np.where(same, other, far), np.where(same, far, other))
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
    first, other = (joined // 3).T
    shift = np.where(same, m, 0)
    ways = np.concatenate([first, first + m]), np.concatenate([other + shift, other + m - shift])
    part = connected(2 * m, np.column_stack(ways))
    as_is, reverse = part[:m], part[m:]
    if (as_is == reverse).any():
        return None
    votes = np.bincount(as_is, minlength=int(part.max()) + 1)
    return (votes[as_is] < votes[reverse]) | ((votes[as_is] == votes[reverse]) & (as_is > reverse))


RepairCounts = dict[str, tuple[int, int]]

LARGEST_DEBRIS_SHARE = 0.005  # of the pial area of the largest piece: smaller pieces are left out
REPAIR_TEXTS = {  # what is repaired, by the name of its count
    "repaired_unlike_triangles": "triangles of pial reversed to match those of white",
    "repaired_flat_triangles": "triangles removed that name a vertex twice",
    "repaired_seam_vertices": "vertices of torn seams joined with another at the same position",
    "repaired_double_triangles": "triangles removed that occur twice",
    "repaired_pinched_edges": "edges separated that more than two triangles shared",
    "repaired_pinched_vertices": "vertices separated at which sheets touched",
    "repaired_debris_triangles": "triangles removed of small pieces beside the cortex",
    "repaired_flipped_triangles": "flipped triangles reversed",
}


@dataclass(frozen=True, eq=False, repr=False)
class Mended:
    """A repaired cortex that can be measured, and how its vertices correspond to those of the given one.

    Attributes
    ----------
    of, cortex : Cortex
        The given one with N vertices, and the repaired one with n. The same object if there is nothing to repair.
    target : (N,) int64
        For each given vertex the repaired vertex whose values it has; -1 where it is left out.
    source : (n,) int64
        Given vertex of each repaired vertex. A vertex that was separated occurs more than once.
    done : mapping of str to (int, int)
        For the names of ``REPAIR_TEXTS``: the count, and a given vertex at the first place.
    why_not : str
        Why the defects were left as they are; empty if none were left.
    """

    of: Cortex
    cortex: Cortex
    target: Ints
    source: Ints
    done: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    why_not: str = ""

    @property
    def numbers(self) -> dict[str, int]:
        """Count of each kind of repair."""
        return {kind: count for kind, (count, _) in self.done.items()}

    @property
    def notes(self) -> dict[str, str]:
        """Note ``repair``: what was repaired, how often, and where first."""
        if not self.done:
            return {}
        verts, done = self.of.white.verts, self.done.items()
        lines = [f"{REPAIR_TEXTS[kind]}: {n}, the first at {checks.place_of(verts[v])}" for kind, (n, v) in done]
        fewer = len(np.unique(self.source)) < self.of.n_vertices
        more = " Vertex numbers in other notes do not count the vertices that were left out." if fewer else ""
        return {"repair": f"The surfaces were repaired; {'; '.join(lines)}.{more}"}


def measurable(cortex: Cortex, *, repair: bool = True) -> Mended:
    """The cortex, repaired unless ``repair`` is False, without vertices that no triangle uses.

    Raises ``ValueError`` if it still cannot be measured.
    """
    cortex = checks.labelled(cortex)
    mend = mended(cortex) if repair else as_given(cortex)
    checks.cortex_mask(mend.cortex)
    defects.check_edges(mend.cortex, mend.why_not)
    if geometry.is_closed(mend.cortex.faces):
        checks.check_sides(mend.cortex)
    checks.check_pair(mend.cortex)
    checks.check_open_pieces(mend.cortex)
    return _without_unused(mend)


def unfoldable(cortex: Cortex) -> Mended:
    """As :func:`measurable`, for a cortex of which white alone is known, with its sphere if it has one.

    Raises ``ValueError`` if its triangles form no surface, or its sphere is that of another one. Whether it is closed
    and of one piece is seen when it is unfolded.
    """
    if cortex.sphere is not None:
        check_same_mesh(cortex.white, cortex.sphere)
    mend = mended(checks.labelled(cortex))
    defects.check_edges(mend.cortex, mend.why_not)
    return _without_unused(mend)


def _without_unused(mend: Mended) -> Mended:
    if mend.cortex is not mend.of or geometry.used(mend.of.n_vertices, mend.of.faces).all():
        return mend
    return _build_mended(mend.of, mend.of.faces, mend.target, mend.source, {})


def as_given(cortex: Cortex, why_not: str = "") -> Mended:
    """The cortex as it is."""
    every = np.arange(cortex.n_vertices)
    return Mended(cortex, cortex, every, every, why_not=why_not)


def mended(cortex: Cortex) -> Mended:
    """The cortex with all defects repaired that have exactly one cure; unchanged where that does not make it sound.

    First, vertices on a border that have the same position on white and on pial are joined, and triangles that name a
    vertex twice or occur twice are removed. Then sheets of surface that share an edge or a vertex are separated (see
    :func:`~morphofold.mesh_quality.repair.joined_sides`): each gets its own vertices at the same
    position. If that cuts off a small piece (``LARGEST_DEBRIS_SHARE``), the piece is left out. Last, triangles are
    reversed to match the majority of their piece, and closed pieces that are inside out, with white within pial, are
    reversed as a whole. Needles and caps stay: the measures allow them.
    """
    done: RepairCounts = {}
    if len(unlike := np.flatnonzero(np.any(cortex.white.faces != cortex.pial.faces, axis=1))):
        done["repaired_unlike_triangles"] = len(unlike), int(cortex.faces[unlike[0], 0])
    faces, target = _clean_triangles(cortex, done)
    if len(faces) == 0:
        return as_given(cortex, "no triangle is left")
    sides = joined_sides(faces)
    keep, faces, owner = _separate_sheets(faces, sides, cortex, done)
    if keep[sides.left // 3].any():
        i, j = faces.ravel()[sides.left[0]], faces.ravel()[after(sides.left[0])]
        return as_given(cortex, f"the sheets of surface that meet at vertices {i} and {j} cannot be told apart")
    joined = sides.joined
    if not keep.all():
        renumbered = np.cumsum(keep) - 1
        joined = joined[keep[joined[:, 0] // 3]]
        joined, faces = 3 * renumbered[joined // 3] + joined % 3, faces[keep]
    flipped = against(faces, joined)
    if flipped is None:
        return as_given(cortex, "a piece of the surface has one side only, like a Moebius strip")
    if flipped.any():
        faces = np.where(flipped[:, None], faces[:, ::-1], faces)
    inside_out = _inside_out_triangles(cortex, faces, owner, joined)
    if inside_out.any():
        flipped ^= inside_out
        faces = np.where(inside_out[:, None], faces[:, ::-1], faces)
    if flipped.any():
        done["repaired_flipped_triangles"] = _counted(owner[faces], flipped)
    return _build_mended(cortex, faces, target, owner, done) if done else as_given(cortex)


def _clean_triangles(cortex: Cortex, done: RepairCounts) -> tuple[Faces, Ints]:
    """Triangles of three different vertices, none twice, torn seams closed; and the new vertex (N,) of each vertex."""
    faces, target = cortex.faces, np.arange(cortex.n_vertices)
    flat = _names_vertex_twice(faces)
    border, source = checks.border_duplicates(cortex, faces[~flat] if flat.any() and not flat.all() else faces)
    target[border] = source
    if len(moved := np.flatnonzero(target != np.arange(len(target)))):
        done["repaired_seam_vertices"] = len(moved), int(moved[0])
        faces = target[faces]
        flat = _names_vertex_twice(faces)
    if flat.any():
        done["repaired_flat_triangles"] = _counted(faces, flat)
        faces = faces[~flat]
    double = _duplicate_triangles(faces)
    if double.any():
        done["repaired_double_triangles"] = _counted(faces, double)
        faces = faces[~double]
    return faces, target


def _counted(faces: Faces, some: Bools) -> tuple[int, int]:
    """How many triangles these are, and the first vertex of the first."""
    return int(some.sum()), int(faces[some][0, 0])


def _names_vertex_twice(faces: Faces) -> Bools:
    return np.any(faces == np.roll(faces, 1, axis=1), axis=1)


def _duplicate_triangles(faces: Faces) -> Bools:
    """Triangles (M,) on the same vertices as others: all but one where an edge of the surface needs it, else all."""
    three = np.sort(faces, axis=1)
    order = np.lexsort(three.T)
    begin = np.flatnonzero(np.any(np.diff(three[order], axis=0, prepend=-1) != 0, axis=1))
    copies = np.diff(begin, append=len(faces))
    double = np.zeros(len(faces), dtype=bool)
    double[order] = np.repeat(copies > 1, copies)
    if double.any():
        first, copies = order[begin[copies > 1]], copies[copies > 1]
        others = geometry.edges_and_counts(faces)[1][geometry.edges_of_faces(faces)[first]] - copies[:, None]
        double[first[np.any(others % 2 == 1, axis=1)]] = False
    return double


def _separate_sheets(faces: Faces, sides: Sides, cortex: Cortex, done: RepairCounts) -> tuple[Bools, Faces, Ints]:
    """Triangles (M,) to keep, triangles with a vertex for each sheet, and the given vertex (N + K,) of each vertex."""
    n, corner = cortex.n_vertices, faces.ravel()
    keep, owner = ~_debris_triangles(faces, sides, cortex), np.arange(n)
    if not keep.all():
        done["repaired_debris_triangles"] = _counted(faces, ~keep)
    fan = sides.fan
    if fan.max() + 1 == np.count_nonzero(np.bincount(corner)):  # as many fans as vertices
        return keep, faces, owner
    ends = lambda of: np.unique(corner[np.concatenate([of, after(of)])])
    crowded = ends(sides.crowded)
    shared = np.bincount(corner[np.unique(fan, return_index=True)[1]], minlength=n) > 1
    touching = np.setdiff1d(np.flatnonzero(shared), np.union1d(ends(sides.border), crowded))
    shared[:] = False
    shared[crowded] = shared[touching] = True
    if len(crowded):
        pairs = np.sort([corner[sides.crowded], corner[after(sides.crowded)]], axis=0)
        done["repaired_pinched_edges"] = len(np.unique(pairs, axis=1).T), int(pairs[0, 0])
    if len(touching):
        done["repaired_pinched_vertices"] = len(touching), int(touching[0])
    part = np.repeat(keep, 3) & shared[corner]  # corners that may get another vertex
    names, first, size = np.unique(fan[part], return_index=True, return_counts=True)
    vertex = corner[part][first]
    order = np.lexsort((names, -size, vertex))  # of each vertex the largest fan first
    other = np.diff(vertex[order], prepend=-1) == 0
    number = np.full(fan.max() + 1, -1)
    number[names[order[other]]] = n + np.arange(other.sum())
    split = np.where(part & (number[fan] >= 0), number[fan], corner)
    return keep, split.reshape(-1, 3), np.concatenate([owner, vertex[order[other]]])


def _debris_triangles(faces: Faces, sides: Sides, cortex: Cortex) -> Bools:
    """Triangles (M,) of pieces much smaller than the largest one. Walls of cavities are none: they face inwards."""
    piece = sheets(faces, sides.joined)
    area = np.bincount(piece, geometry.face_areas(cortex.pial.verts, faces))
    inner, outer = checks.piece_volumes(cortex, faces, piece)
    hollow = (inner < outer) & (outer < 0)
    hollow[piece[sides.border // 3]] = False
    return ((area < LARGEST_DEBRIS_SHARE * area.max()) & ~hollow)[piece]


def _inside_out_triangles(cortex: Cortex, faces: Faces, owner: Ints, joined: Ints) -> Bools:
    """Triangles (M,) of closed pieces where white has a negative volume and pial's is not larger."""
    piece = geometry.components(len(owner), faces)[1][faces[:, 0]]
    inner, outer = (checks.signed_volumes(s.verts[owner], faces, piece) for s in (cortex.white, cortex.pial))
    wrong: Bools = (outer <= inner) & (inner < 0)  # in walls of cavities pial's is larger
    alone = np.ones(faces.size, dtype=bool)
    alone[joined] = False
    wrong[piece[np.flatnonzero(alone) // 3]] = False  # a piece with a border encloses no volume
    return wrong[piece]


def _build_mended(cortex: Cortex, faces: Faces, target: Ints, owner: Ints, done: RepairCounts) -> Mended:
    """The cortex with these faces, without the vertices that none of them uses."""
    gone = ~geometry.used(len(owner), faces)
    source, number = owner[~gone], np.where(gone, -1, np.cumsum(~gone) - 1)
    repaired = lambda surface: replace(surface, verts=surface.verts[source], faces=number[faces])
    mended_cortex = replace(
        cortex,
        white=repaired(cortex.white),
        pial=repaired(cortex.pial),
        maps={name: np.asarray(v)[source] for name, v in cortex.maps.items()},
        cortex=None if cortex.cortex is None else np.asarray(cortex.cortex)[source],
        regions=None if cortex.regions is None else replace(cortex.regions, labels=cortex.regions.labels[source]),
        inflated=None,
        sphere=cortex.sphere and repaired(cortex.sphere),
        registered=None,
    )
    return Mended(cortex, mended_cortex, number[target], source, done)
