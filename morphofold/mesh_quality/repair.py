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
from morphofold.frozen_arrays import Bools, Ints
from morphofold.geometry import connected
from morphofold.mesh_quality import cortex_checks, defects
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
    unpaired : (L,) int64
        Sides of crowded edges for which no partner was found.
    fan : (3 M,) int64
        Fan of each corner, as in :func:`fans`.
    """

    joined: Ints
    crowded: Ints
    border: Ints
    unpaired: Ints
    fan: Ints


def joined_sides(faces: Faces) -> Sides:
    """Sides that belong together: the two of an edge, or, of more than two, those that the surface joins elsewhere.

    Around a vertex, triangles are neighbours across edges with two triangles. A chain of neighbours that begins and
    ends at the same crowded edge is one sheet of surface, so its first and last side are joined. This may close chains
    around the other end of the edge. If two sides are left at an edge at the end, they belong together.
    """
    corner_vertices = faces.ravel()
    edge_ends = np.sort([corner_vertices, corner_vertices[after(np.arange(len(corner_vertices)))]], axis=0)
    edge_key = edge_ends[0] * (int(corner_vertices.max()) + 1) + edge_ends[1]
    side_order = np.argsort(edge_key, kind="stable")
    edge_starts = np.flatnonzero(np.diff(edge_key[side_order], prepend=-1))
    n_sides = np.diff(edge_starts, append=len(edge_key))
    pair_starts, is_crowded = edge_starts[n_sides == 2], np.repeat(n_sides > 2, n_sides)
    joined = np.column_stack([side_order[pair_starts], side_order[pair_starts + 1]])
    crowded = side_order[is_crowded]
    unjoined, unjoined_edge = crowded, np.repeat(np.arange(len(n_sides)), n_sides)[is_crowded]
    fan = fans(faces, joined)
    while len(unjoined):
        corners = _corners_at_ends(unjoined, corner_vertices)
        for fan_at_end in (fan[corners[0]], fan[corners[1]], np.zeros(len(unjoined_edge), dtype=np.int64)):
            pairs = _pairs_to_join(unjoined_edge, fan_at_end)
            if len(pairs):
                break
        else:
            break
        joined = np.concatenate([joined, unjoined[pairs]])
        fan = fans(faces, joined)
        unjoined, unjoined_edge = np.delete(unjoined, pairs), np.delete(unjoined_edge, pairs)
    return Sides(joined, crowded, side_order[edge_starts[n_sides == 1]], unjoined, fan)


def _corners_at_ends(sides: Ints, corner_vertices: Ints) -> tuple[Ints, Ints]:
    """Corners of sides at both ends of their edge. The end with more triangles (of two welded vertices) first."""
    far_corner, n_triangles = after(sides), np.bincount(corner_vertices)
    start, end = corner_vertices[sides], corner_vertices[far_corner]
    is_first = (n_triangles[start] > n_triangles[end]) | ((n_triangles[start] == n_triangles[end]) & (start < end))
    return np.where(is_first, sides, far_corner), np.where(is_first, far_corner, sides)


def _pairs_to_join(edge: Ints, fan: Ints) -> Ints:
    """Pairs (P, 2) of rows where exactly two have the same edge and fan."""
    order = np.lexsort((fan, edge))
    group_starts = np.flatnonzero((np.diff(edge[order], prepend=-1) != 0) | (np.diff(fan[order], prepend=-1) != 0))
    pair_starts = group_starts[np.diff(group_starts, append=len(edge)) == 2]
    return np.column_stack([order[pair_starts], order[pair_starts + 1]])


def after(side: Ints) -> Ints:
    """The next side of the same triangle; it begins where this one ends."""
    return side - side % 3 + (side + 1) % 3


def fans(faces: Faces, joined: Ints) -> Ints:
    """Number (3 M,) of the fan of each corner. A fan is the joined triangles around a vertex."""
    corner_vertices, (side, partner) = faces.ravel(), joined.T
    same_start = corner_vertices[side] == corner_vertices[partner]
    partner_end = after(partner)
    i, j = (side, after(side)), (np.where(same_start, partner, partner_end), np.where(same_start, partner_end, partner))
    return connected(len(corner_vertices), np.column_stack([np.concatenate(i), np.concatenate(j)]))


def sheets(faces: Faces, joined: Ints) -> Ints:
    """Number (M,) of the sheet of each triangle. A sheet is a set of joined triangles."""
    return connected(len(faces), joined // 3)


def against(faces: Faces, joined: Ints) -> Bools | None:
    """Triangles (M,) oriented against the majority of their piece; None if a piece has one side only.

    Each triangle is taken in both orientations, and those that agree across joined sides form one part. On a piece with
    two sides, the two orientations of a triangle lie in two parts. The part with more triangles as given is right.
    """
    corner_vertices, n_faces = faces.ravel(), len(faces)
    same_start = corner_vertices[joined[:, 0]] == corner_vertices[joined[:, 1]]  # one of the two is flipped
    if not same_start.any():
        return np.zeros(n_faces, dtype=bool)
    triangle, other = (joined // 3).T
    shift = np.where(same_start, n_faces, 0)
    links = (np.concatenate([triangle, triangle + n_faces]), np.concatenate([other + shift, other + n_faces - shift]))
    part = connected(2 * n_faces, np.column_stack(links))
    kept_part, flip_part = part[:n_faces], part[n_faces:]
    if (kept_part == flip_part).any():
        return None
    votes = np.bincount(kept_part, minlength=int(part.max()) + 1)
    return (votes[kept_part] < votes[flip_part]) | ((votes[kept_part] == votes[flip_part]) & (kept_part > flip_part))


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
    original, cortex : Cortex
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

    original: Cortex
    cortex: Cortex
    target: Ints
    source: Ints
    done: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    why_not: str = ""

    @property
    def numbers(self) -> dict[str, int]:
        """Count of each kind of repair."""
        return {kind: n_repairs for kind, (n_repairs, _) in self.done.items()}

    @property
    def notes(self) -> dict[str, str]:
        """Note ``repair``: what was repaired, how often, and where first."""
        if not self.done:
            return {}
        verts, done = self.original.white.verts, self.done.items()
        texts = [f"{REPAIR_TEXTS[kind]}: {n}, the first at {cortex_checks.place_of(verts[v])}" for kind, (n, v) in done]
        has_fewer = len(np.unique(self.source)) < self.original.n_vertices
        numbering = " Vertex numbers in other notes do not count the vertices that were left out." if has_fewer else ""
        return {"repair": f"The surfaces were repaired; {'; '.join(texts)}.{numbering}"}


def measurable(cortex: Cortex, *, repair: bool = True) -> Mended:
    """The cortex, repaired unless ``repair`` is False, without vertices that no triangle uses.

    Raises ``ValueError`` if it still cannot be measured.
    """
    cortex = cortex_checks.labelled(cortex)
    repaired = mended(cortex) if repair else as_given(cortex)
    cortex_checks.cortex_mask(repaired.cortex)
    defects.check_edges(repaired.cortex, repaired.why_not)
    if geometry.is_closed(repaired.cortex.faces):
        cortex_checks.check_sides(repaired.cortex)
    cortex_checks.check_pair(repaired.cortex)
    cortex_checks.check_open_pieces(repaired.cortex)
    return _without_unused(repaired)


def unfoldable(cortex: Cortex) -> Mended:
    """As :func:`measurable`, for a cortex of which white alone is known, with its sphere if it has one.

    Raises ``ValueError`` if its triangles form no surface, or its sphere is that of another one. Whether it is closed
    and of one piece is seen when it is unfolded.
    """
    if cortex.sphere is not None:
        check_same_mesh(cortex.white, cortex.sphere)
    repaired = mended(cortex_checks.labelled(cortex))
    defects.check_edges(repaired.cortex, repaired.why_not)
    return _without_unused(repaired)


def _without_unused(mend: Mended) -> Mended:
    if mend.cortex is not mend.original or geometry.used(mend.original.n_vertices, mend.original.faces).all():
        return mend
    return _build_mended(mend.original, mend.original.faces, mend.target, mend.source, {})


def as_given(cortex: Cortex, why_not: str = "") -> Mended:
    """The cortex as it is."""
    all_vertices = np.arange(cortex.n_vertices)
    return Mended(cortex, cortex, all_vertices, all_vertices, why_not=why_not)


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
    if len(unlike_triangles := np.flatnonzero(np.any(cortex.white.faces != cortex.pial.faces, axis=1))):
        done["repaired_unlike_triangles"] = len(unlike_triangles), int(cortex.faces[unlike_triangles[0], 0])
    faces, target = _clean_triangles(cortex, done)
    if len(faces) == 0:
        return as_given(cortex, "no triangle is left")
    sides = joined_sides(faces)
    keep_triangle, faces, source_vertex = _separate_sheets(faces, sides, cortex, done)
    if keep_triangle[sides.unpaired // 3].any():
        i, j = faces.ravel()[sides.unpaired[0]], faces.ravel()[after(sides.unpaired[0])]
        return as_given(cortex, f"the sheets of surface that meet at vertices {i} and {j} cannot be told apart")
    joined = sides.joined
    if not keep_triangle.all():
        new_number = np.cumsum(keep_triangle) - 1
        joined = joined[keep_triangle[joined[:, 0] // 3]]
        joined, faces = 3 * new_number[joined // 3] + joined % 3, faces[keep_triangle]
    is_flipped = against(faces, joined)
    if is_flipped is None:
        return as_given(cortex, "a piece of the surface has one side only, like a Moebius strip")
    if is_flipped.any():
        faces = np.where(is_flipped[:, None], faces[:, ::-1], faces)
    is_inside_out = _inside_out_triangles(cortex, faces, source_vertex, joined)
    if is_inside_out.any():
        is_flipped ^= is_inside_out
        faces = np.where(is_inside_out[:, None], faces[:, ::-1], faces)
    if is_flipped.any():
        done["repaired_flipped_triangles"] = _counted(source_vertex[faces], is_flipped)
    return _build_mended(cortex, faces, target, source_vertex, done) if done else as_given(cortex)


def _clean_triangles(cortex: Cortex, done: RepairCounts) -> tuple[Faces, Ints]:
    """Triangles of three different vertices, none twice, torn seams closed; and the new vertex (N,) of each vertex."""
    faces, target = cortex.faces, np.arange(cortex.n_vertices)
    is_flat = _names_vertex_twice(faces)
    checked_faces = faces[~is_flat] if is_flat.any() and not is_flat.all() else faces
    border, source = cortex_checks.border_duplicates(cortex, checked_faces)
    target[border] = source
    if len(merged_vertices := np.flatnonzero(target != np.arange(len(target)))):
        done["repaired_seam_vertices"] = len(merged_vertices), int(merged_vertices[0])
        faces = target[faces]
        is_flat = _names_vertex_twice(faces)
    if is_flat.any():
        done["repaired_flat_triangles"] = _counted(faces, is_flat)
        faces = faces[~is_flat]
    is_double = _duplicate_triangles(faces)
    if is_double.any():
        done["repaired_double_triangles"] = _counted(faces, is_double)
        faces = faces[~is_double]
    return faces, target


def _counted(faces: Faces, is_counted: Bools) -> tuple[int, int]:
    """How many triangles these are, and the first vertex of the first."""
    return int(is_counted.sum()), int(faces[is_counted][0, 0])


def _names_vertex_twice(faces: Faces) -> Bools:
    return np.any(faces == np.roll(faces, 1, axis=1), axis=1)


def _duplicate_triangles(faces: Faces) -> Bools:
    """Triangles (M,) on the same vertices as others: all but one where an edge of the surface needs it, else all."""
    sorted_faces = np.sort(faces, axis=1)
    face_order = np.lexsort(sorted_faces.T)
    group_starts = np.flatnonzero(np.any(np.diff(sorted_faces[face_order], axis=0, prepend=-1) != 0, axis=1))
    n_copies = np.diff(group_starts, append=len(faces))
    is_double = np.zeros(len(faces), dtype=bool)
    is_double[face_order] = np.repeat(n_copies > 1, n_copies)
    if is_double.any():
        first_copies, n_copies = face_order[group_starts[n_copies > 1]], n_copies[n_copies > 1]
        n_others = geometry.edges_and_counts(faces)[1][geometry.edges_of_faces(faces)[first_copies]] - n_copies[:, None]
        is_double[first_copies[np.any(n_others % 2 == 1, axis=1)]] = False
    return is_double


def _separate_sheets(faces: Faces, joins: Sides, cortex: Cortex, done: RepairCounts) -> tuple[Bools, Faces, Ints]:
    """Triangles (M,) to keep, triangles with a vertex for each sheet, and the given vertex (N + K,) of each vertex."""
    n_vertices, corner_vertices = cortex.n_vertices, faces.ravel()
    keep_triangle, source_vertex = ~_debris_triangles(faces, joins, cortex), np.arange(n_vertices)
    if not keep_triangle.all():
        done["repaired_debris_triangles"] = _counted(faces, ~keep_triangle)
    fan = joins.fan
    if fan.max() + 1 == np.count_nonzero(np.bincount(corner_vertices)):  # as many fans as vertices
        return keep_triangle, faces, source_vertex
    ends_of = lambda side: np.unique(corner_vertices[np.concatenate([side, after(side)])])
    crowded_ends = ends_of(joins.crowded)
    is_shared = np.bincount(corner_vertices[np.unique(fan, return_index=True)[1]], minlength=n_vertices) > 1
    touching_vertices = np.setdiff1d(np.flatnonzero(is_shared), np.union1d(ends_of(joins.border), crowded_ends))
    is_shared[:] = False
    is_shared[crowded_ends] = is_shared[touching_vertices] = True
    if len(crowded_ends):
        crowded_edges = np.sort([corner_vertices[joins.crowded], corner_vertices[after(joins.crowded)]], axis=0)
        done["repaired_pinched_edges"] = len(np.unique(crowded_edges, axis=1).T), int(crowded_edges[0, 0])
    if len(touching_vertices):
        done["repaired_pinched_vertices"] = len(touching_vertices), int(touching_vertices[0])
    may_split = np.repeat(keep_triangle, 3) & is_shared[corner_vertices]  # corners that may get another vertex
    fan_numbers, first_corner, fan_size = np.unique(fan[may_split], return_index=True, return_counts=True)
    fan_vertex = corner_vertices[may_split][first_corner]
    order = np.lexsort((fan_numbers, -fan_size, fan_vertex))  # of each vertex the largest fan first
    is_extra_fan = np.diff(fan_vertex[order], prepend=-1) == 0
    new_vertex = np.full(fan.max() + 1, -1)
    new_vertex[fan_numbers[order[is_extra_fan]]] = n_vertices + np.arange(is_extra_fan.sum())
    split_corners = np.where(may_split & (new_vertex[fan] >= 0), new_vertex[fan], corner_vertices)
    return keep_triangle, split_corners.reshape(-1, 3), np.concatenate([source_vertex, fan_vertex[order[is_extra_fan]]])


def _debris_triangles(faces: Faces, sides: Sides, cortex: Cortex) -> Bools:
    """Triangles (M,) of pieces much smaller than the largest one. Walls of cavities are none: they face inwards."""
    piece = sheets(faces, sides.joined)
    piece_area = np.bincount(piece, geometry.face_areas(cortex.pial.verts, faces))
    inner_volume, outer_volume = cortex_checks.piece_volumes(cortex, faces, piece)
    is_hollow = (inner_volume < outer_volume) & (outer_volume < 0)
    is_hollow[piece[sides.border // 3]] = False
    return ((piece_area < LARGEST_DEBRIS_SHARE * piece_area.max()) & ~is_hollow)[piece]


def _inside_out_triangles(cortex: Cortex, faces: Faces, source: Ints, joined: Ints) -> Bools:
    """Triangles (M,) of closed pieces where white has a negative volume and pial's is not larger."""
    piece = geometry.components(len(source), faces)[1][faces[:, 0]]
    white_mm3, pial_mm3 = (
        cortex_checks.signed_volumes(s.verts[source], faces, piece) for s in (cortex.white, cortex.pial)
    )
    is_inside_out: Bools = (pial_mm3 <= white_mm3) & (white_mm3 < 0)  # in walls of cavities pial's is larger
    is_unjoined = np.ones(faces.size, dtype=bool)
    is_unjoined[joined] = False
    is_inside_out[piece[np.flatnonzero(is_unjoined) // 3]] = False  # a piece with a border encloses no volume
    return is_inside_out[piece]


def _build_mended(cortex: Cortex, faces: Faces, target: Ints, source_vertex: Ints, done: RepairCounts) -> Mended:
    """The cortex with these faces, without the vertices that none of them uses."""
    is_unused = ~geometry.used(len(source_vertex), faces)
    source, new_number = source_vertex[~is_unused], np.where(is_unused, -1, np.cumsum(~is_unused) - 1)
    with_new_mesh = lambda surface: replace(surface, verts=surface.verts[source], faces=new_number[faces])
    mended_cortex = replace(
        cortex,
        white=with_new_mesh(cortex.white),
        pial=with_new_mesh(cortex.pial),
        maps={name: np.asarray(values)[source] for name, values in cortex.maps.items()},
        cortex=None if cortex.cortex is None else np.asarray(cortex.cortex)[source],
        regions=None if cortex.regions is None else replace(cortex.regions, labels=cortex.regions.labels[source]),
        inflated=None,
        sphere=cortex.sphere and with_new_mesh(cortex.sphere),
        registered=None,
    )
    return Mended(cortex, mended_cortex, new_number[target], source, done)
