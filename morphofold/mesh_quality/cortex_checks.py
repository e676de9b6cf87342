"""Checks of a cortex before it is measured: where it is cortex, and refusals with the numbers and the cure."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.sparse import csgraph

from morphofold import geometry
from morphofold.digests_and_json import unchanged
from morphofold.errors import InsideOut, NoCortex, UnlikeSurfaces
from morphofold.frozen_arrays import Array, Bools, Ints, memoized
from morphofold.intersections.box_tree import box_tree, ray_hits, ray_winding
from morphofold.io import read_label
from morphofold.io.files import side_named
from morphofold.kernels import reading
from morphofold.spheres.template_folders import carried_cortex
from morphofold.surface import Cortex, Faces, Surface, Verts

# of the median distance of white and pial: below it a vertex is not cortex (0.5 mm in adults)
WALL_DISTANCE_OVER_MEDIAN = 0.2
# shares of the white area: least of one patch, most of all patches; walls have 0.03 to 0.1
LEAST_PATCH_SHARE, LARGEST_WALL_SHARE = 0.01, 0.2


def wall_of_thickness(cortex: Cortex) -> Bools:
    """True (N,) in the wall, where the thickness that came with the surfaces is 0 or NaN; nowhere without one."""
    thickness = cortex.maps.get("thickness")
    if thickness is None:
        return np.zeros(cortex.n_vertices, dtype=bool)
    return _wall_patches(cortex.white.verts, cortex.faces, ~(np.asarray(thickness) > 0))


def wall_of_geometry(cortex: Cortex) -> Bools:
    """True (N,) in the wall, where white and pial are closer than ``WALL_DISTANCE_OVER_MEDIAN`` times their median
    distance.

    The step from white to pial is first averaged over a vertex and its neighbours. Noise of the vertices differs
    between the two surfaces, and without the average it would tear the patch. The bound is relative: it is the same in
    any unit, and a cortex that is thin everywhere has no wall.
    """
    return _wall_between(cortex.white.verts, cortex.pial.verts, cortex.faces)


@memoized
def _wall_between(white: Verts, pial: Verts, faces: Faces) -> Bools:
    to_pial = pial - white
    neighbours = geometry.adjacency(len(white), faces).astype(np.float64)
    mean_to_pial = (to_pial + neighbours @ to_pial) / (1 + np.diff(neighbours.indptr))[:, None]
    is_thin = geometry.norms(mean_to_pial) < WALL_DISTANCE_OVER_MEDIAN * np.median(geometry.norms(to_pial))
    return _wall_patches(white, faces, is_thin)


def _wall_patches(white: Verts, faces: Faces, is_thin: Bools) -> Bools:
    """The thin vertices in connected patches as large as a wall; none if these cover too much of the surface."""
    thin_vertices = np.flatnonzero(is_thin)
    area = geometry.vertex_areas(white, faces)
    thin_adjacency = geometry.adjacency(len(white), faces)[thin_vertices][:, thin_vertices]
    _, patch = csgraph.connected_components(thin_adjacency, directed=False)
    is_large = np.bincount(patch, area[thin_vertices]) >= LEAST_PATCH_SHARE * area.sum()
    in_wall = np.zeros(len(white), dtype=bool)
    in_wall[thin_vertices[is_large[patch]]] = True
    return in_wall & (area[in_wall].sum() <= LARGEST_WALL_SHARE * area.sum())


# within names of regions, without spaces and _
NAMES_OUTSIDE_CORTEX = ("unknown", "corpuscallosum", "medialwall", "???")
# of the vertices, in regions of cortex: least share for an annotation to define the cortex
LEAST_PARCELLATED_SHARE = 0.75

LARGEST_SHARE_OF_WALL = 0.5  # of the wall that geometry finds, in the cortex of a template; fsaverage has 0.003

# of the radius of the sphere of equal area: at larger distances pial must lie along the normals of white
FAR_APART_IN_RADII = 0.05
SAME_SURFACE_IN_RADII = 1e-3  # of that radius: closer surfaces count as the same; the thinnest cortices have 0.01
SAME_POINT_SHARE = 1e-7  # of the largest distance from white to pial: less is rounding
LEAST_LABELLED_SHARE = 0.01  # of the vertices: a cortex label that holds fewer is refused
LARGEST_OUTSIDE_SHARE = 0.5  # of a piece with a border, outside pial: more than mistakes of reconstruction
# mean cosine to the normal that is then required; any cortex has 0.8 or more, however thick and folded
LEAST_NORMAL_COSINE = 0.5


def cortex_label(cortex: Cortex) -> tuple[Bools, str]:
    """True (N,) where the vertex is cortex, and a word for the source: the first that is available, in this order.

    ``"label"``: the cortex label that came with the surfaces. ``"annotation"``: all regions that are not
    ``NAMES_OUTSIDE_CORTEX``, if they cover three quarters of the vertices but not all. A parcellation does; a map of a
    few areas does not. ``"template"``: where fsaverage5 is cortex, carried over by the registered sphere, unless half
    of the wall that geometry finds is cortex there: then the sphere is registered to something else.
    ``"thickness"``: all but large patches where the thickness that came with the surfaces is 0.
    ``"geometry"``: all but large patches where white and pial nearly meet
    (:mod:`~morphofold.mesh_quality.cortex_checks`). Otherwise, and for a simulated body without a label, all
    vertices are cortex and the word is "".
    """
    if cortex.cortex is not None:
        return np.asarray(cortex.cortex, dtype=bool), cortex.info.get("cortex_from", "label")
    if cortex.regions is not None:
        outside_regions = [label for label, name in enumerate(cortex.regions.names) if is_no_cortex(name)]
        is_labelled = (cortex.regions.labels >= 0) & ~np.isin(cortex.regions.labels, outside_regions)
        if LEAST_PARCELLATED_SHARE <= is_labelled.mean() < 1:
            return is_labelled, "annotation"
    if cortex.registered is not None:
        carried_label, in_wall = carried_cortex(cortex.registered, cortex.hemi), wall_of_geometry(cortex)
        if np.count_nonzero(in_wall & carried_label) <= LARGEST_SHARE_OF_WALL * np.count_nonzero(in_wall):
            return carried_label, "template"
    if cortex.origin != "simulation":
        for source, wall_of in (("thickness", wall_of_thickness), ("geometry", wall_of_geometry)):
            if (in_wall := wall_of(cortex)).any():
                return ~in_wall, source
    return np.ones(cortex.n_vertices, dtype=bool), ""


def labelled(cortex: Cortex) -> Cortex:
    """The cortex with the label of a template, if it has one only by this: a repair may leave vertices out."""
    label, word = cortex_label(cortex)
    return replace(cortex, cortex=label, info={**cortex.info, "cortex_from": word}) if word == "template" else cortex


def excluded_file(pattern: str | None, subject: str, hemi: str) -> Path | None:
    """The file of ``--exclude`` for a hemisphere, if there is one: ``{subject}``, ``{hemi}`` (lh) and ``{side}`` (L) in
    its name are filled in, and a name of the other hemisphere is not for this one."""
    if pattern is None:
        return None
    of_side = pattern.replace("{hemi}", hemi).replace("{side}", hemi[0].upper())
    path = Path(of_side.replace("{subject}", subject))
    return path if side_named(Path(of_side).name) in (None, hemi) and path.is_file() else None


def shows_side(pattern: str) -> bool:
    """Whether a pattern of ``--exclude`` shows of which hemisphere a file is; a file of CIFTI is of both."""
    name = Path(pattern.replace("{subject}", "").replace("{hemi}", "lh").replace("{side}", "hemi-L")).name
    return name.endswith(".nii") or side_named(name) is not None


def excluding(cortex: Cortex, file: Path | None) -> Cortex:
    """The cortex and its regions without the vertices of a label or map, such as a tumour; a note gives their number.

    Raises
    ------
    OSError, ValueError
        If the file can't be read or belongs to another surface.
    """
    if file is None:
        return cortex
    with unchanged([file]) as records:
        excluded = read_label(file, cortex.n_vertices, cortex.hemi)
    label, source = cortex_label(cortex)
    area = geometry.vertex_areas(cortex.white.verts, cortex.faces)[label & excluded].sum()
    regions = cortex.regions and replace(cortex.regions, labels=np.where(excluded, -1, cortex.regions.labels))
    counts = {"file": str(file), "vertices": int(np.count_nonzero(label & excluded)), "area_mm2": float(area)}
    return replace(
        cortex,
        cortex=label & ~excluded,
        regions=regions,
        info={**cortex.info, "cortex_from": source, "excluded": counts},
        files=(*cortex.files, str(file)),
        inputs=(*cortex.inputs, *records),
    )


def is_no_cortex(region: str) -> bool:
    """Whether a region has one of the names that annotations use for areas outside the cortex."""
    plain_name = region.lower().replace("_", "").replace(" ", "")
    return any(outside_name in plain_name for outside_name in NAMES_OUTSIDE_CORTEX)


def cortex_mask(cortex: Cortex) -> Bools:
    """True (N,) where the vertex is cortex by :func:`cortex_label` and white and pial do not coincide.

    Raises
    ------
    ValueError
        If white and pial are the same surface, or no vertex is cortex.
    """
    is_apart = off_pial(cortex)
    if not is_apart.any():
        raise UnlikeSurfaces(
            f"{cortex.called}: white ({cortex.white.name}) and pial ({cortex.pial.name}) are the same surface at all "
            f"{cortex.n_vertices} vertices. Pass the two surfaces of one reconstruction."
        )
    label, source = cortex_label(cortex)
    if source == "label" and label.mean() < LEAST_LABELLED_SHARE:
        label_text = f"{cortex.name}: the cortex label"
        file = next((file for file in cortex.files if file.endswith("cortex.label")), label_text)
        raise NoCortex(
            f"{file}: holds {label.sum()} of {cortex.n_vertices} vertices, too few to be measured; "
            "FreeSurfer's labels hold about 90 %. Name the right label, or leave it out."
        )
    mask = is_apart & label
    if not mask.any():
        raise NoCortex(
            f"{cortex.called}: no vertex is cortex. The cortex {source} holds {label.sum()} of "
            f"{cortex.n_vertices} vertices, white and pial differ at {is_apart.sum()}, and no vertex is in both sets. "
            "Check the label, or leave it out; check what --exclude names."
        )
    return mask


def off_pial(cortex: Cortex) -> Bools:
    """True (N,) where white and pial are not the same point up to rounding; everywhere if only one was given."""
    if cortex.is_one_surface:
        return np.ones(cortex.n_vertices, dtype=bool)
    distances = geometry.norms(cortex.pial.verts - cortex.white.verts)
    return distances > SAME_POINT_SHARE * distances.max()


def check_sides(cortex: Cortex) -> None:
    """Refuse closed surfaces that are inside out or swapped. The walls of a cavity may face inwards."""
    (piece, inner_volumes, outer_volumes), cavity_pieces = _pieces_and_volumes(cortex), cavities(cortex)
    for surface, volumes in ((cortex.white, inner_volumes), (cortex.pial, outer_volumes)):
        for k in np.setdiff1d(np.flatnonzero(volumes < 0), cavity_pieces)[:1].tolist():
            piece_text = "" if len(inner_volumes) == 1 else f"the piece of vertex {np.flatnonzero(piece == k)[0]} of "
            raise InsideOut(
                f"{cortex.called}: {piece_text}{surface.name} is inside out, its signed volume is {volumes[k]:.4g} "
                "mm^3: its faces are clockwise seen from outside. Reverse the triangles (faces[:, ::-1])."
            )
    if inner_volumes.sum() > outer_volumes.sum():
        raise UnlikeSurfaces(
            f"{cortex.called}: white ({cortex.white.name}) encloses {inner_volumes.sum():.6g} mm^3, more than the "
            f"{outer_volumes.sum():.6g} mm^3 of pial ({cortex.pial.name}). Were white and pial swapped?"
        )


def cavities(cortex: Cortex) -> list[int]:
    """Pieces of a closed cortex, numbered as by ``components``, that are walls of cavities within another piece.

    Their faces point inwards on both surfaces, and white lies around pial: the outward direction is into the cavity.
    """
    vertex_piece, inner_volumes, outer_volumes = _pieces_and_volumes(cortex)
    cavity_pieces = np.flatnonzero((inner_volumes < outer_volumes) & (outer_volumes < 0))
    for surface in (cortex.white, cortex.pial):
        cavity_pieces = _pieces_within_others(surface, vertex_piece, cavity_pieces)
    return cavity_pieces.tolist()


def _pieces_and_volumes(cortex: Cortex) -> tuple[Ints, Array, Array]:
    """Piece (N,) of each vertex, and the signed volumes [mm^3] of the pieces of white and of pial."""
    vertex_piece: Ints = geometry.components(cortex.n_vertices, cortex.faces)[1]
    return vertex_piece, *piece_volumes(cortex, cortex.faces, vertex_piece[cortex.faces[:, 0]])


def _pieces_within_others(surface: Surface, vertex_piece: Ints, candidates: Ints) -> Ints:
    """Those ``candidates`` that lie within others: the rest of the closed surface winds around them.

    The winding number of the rest is that of the whole less that of the piece, so one tree of boxes serves all pieces.
    """
    if len(candidates) == 0:
        return candidates
    verts, faces = surface.verts, surface.faces
    face_piece = vertex_piece[faces[:, 0]]
    by_piece, starts = np.argsort(face_piece, kind="stable"), np.concatenate([[0], np.cumsum(np.bincount(face_piece))])
    tree, direction, no_hits = box_tree(verts, faces), (0.0, 0.0, 1.0), np.empty(0)
    windings = []
    for candidate in candidates:
        piece_faces = faces[by_piece[starts[candidate] : starts[candidate + 1]]]
        origin = tuple(verts[piece_faces[0, 0]].tolist())
        winding = ray_hits(*reading(verts, faces, tree.bounds, tree.order), origin, direction, no_hits, no_hits)[1]
        windings.append(winding - ray_winding(*reading(verts, piece_faces), origin, direction))
    return candidates[np.array(windings) > 0]


def check_pair(cortex: Cortex) -> None:
    """Refuse one surface given twice, and surfaces of two hemispheres or two people.

    Surfaces of two cortices: vertex i of pial is far from vertex i of white, and not outward of it. Distance alone is
    not enough, because a simulated cortex may be as thick as half the radius of its brain.
    """
    white, pial = cortex.white, cortex.pial
    to_pial = pial.verts - white.verts
    distances = np.linalg.norm(to_pial, axis=1)
    differs = (distances > 0) & geometry.used(len(distances), cortex.faces)
    if not differs.any():
        return
    median_distance = float(np.median(distances[differs]))
    radius = geometry.equal_area_radius(white.verts, cortex.faces)
    cosines = geometry.inner(to_pial, geometry.vertex_normals(white.verts, cortex.faces))[differs] / distances[differs]
    if median_distance < SAME_SURFACE_IN_RADII * radius:
        raise UnlikeSurfaces(
            f"{cortex.name}: white ({white.name}) and pial ({pial.name}) are the same surface up to rounding: half "
            f"of their vertices are less than {median_distance:.2g} {cortex.units} apart. Pass the two surfaces of one "
            "reconstruction."
        )
    if median_distance > FAR_APART_IN_RADII * radius and abs(cosines.mean()) < LEAST_NORMAL_COSINE:
        file_names = cortex.files[:2] or (white.name, pial.name)
        raise UnlikeSurfaces(
            f"{cortex.called}: {file_names[0]} and {file_names[1]} are not of one cortex: the median distance from "
            f"vertex i of white to vertex i of pial is {median_distance:.3g} {cortex.units}, but not outward. Pass the "
            "two surfaces of one hemisphere of one person."
        )


def check_open_pieces(cortex: Cortex) -> None:
    """Refuse a piece with a border if white lies outside pial on most of it. Such a piece encloses no volume."""
    if not len(border_edges := geometry.border_edges(cortex.faces)):
        return
    piece = geometry.components(cortex.n_vertices, cortex.faces)[1] + 1  # 0: vertices of no triangle
    share = np.bincount(piece, outside(cortex)) / np.maximum(np.bincount(piece), 1)
    for k in np.intersect1d(piece[border_edges], np.flatnonzero(share > LARGEST_OUTSIDE_SHARE))[:1]:
        raise InsideOut(
            f"{cortex.called}: white ({cortex.white.name}) lies outside pial ({cortex.pial.name}) at {share[k]:.0%} of "
            f"the piece of vertex {np.flatnonzero(piece == k)[0]}, which has a border: its faces are clockwise seen "
            "from outside, or white and pial are swapped. Reverse the triangles (faces[:, ::-1]), or swap the two."
        )


def outside(cortex: Cortex) -> Bools:
    """True (N,) where white lies outside pial by the normals of both surfaces."""
    to_pial = cortex.pial.verts - cortex.white.verts
    outward = [geometry.inner(to_pial, geometry.vertex_normals(s.verts, s.faces)) for s in (cortex.white, cortex.pial)]
    return np.maximum(*outward) < 0


def shift(cortex: Cortex, mask: Bools) -> Array:
    """Vector (3,) [mm] by which pial as a whole is shifted from white, on the cortex ``mask`` (N,) of closed surfaces.

    The least-squares shift, weighted by area, of the steps from white to pial *along* the surface. On a closed surface
    no thickness causes such a shift, however uneven it is. On an open piece it may: from a wall to a crown all steps
    along the surface have one direction.
    """
    normal = geometry.unit(np.add(*(geometry.vertex_normals(s.verts, s.faces) for s in (cortex.white, cortex.pial))))
    area = mask * sum(geometry.vertex_areas(s.verts, s.faces) for s in (cortex.white, cortex.pial))
    to_pial = cortex.pial.verts - cortex.white.verts
    tangential = to_pial - geometry.inner(to_pial, normal)[:, None] * normal
    matrix = area.sum() * np.eye(3) - (normal * area[:, None]).T @ normal
    shift_vector: Array = np.linalg.lstsq(matrix, area @ tangential, rcond=0.05)[0]
    return shift_vector


def border_duplicates(cortex: Cortex, faces: Faces) -> tuple[Ints, Ints]:
    """Vertices on a border of the faces (B,), and for each the first at the same position on white and on pial."""
    border = np.unique(geometry.border_edges(faces))
    positions = np.column_stack([cortex.white.verts[border], cortex.pial.verts[border]])
    _, first_rows, position_number = np.unique(positions, axis=0, return_index=True, return_inverse=True)
    return border, border[first_rows[position_number.reshape(-1)]]


def volume(surface: Surface) -> float:
    """Volume [mm^3] that a closed surface encloses, without its cavities; negative if it is inside out."""
    return float(signed_volumes(surface.verts, surface.faces, np.zeros(len(surface.faces), dtype=np.int64)).sum())


def piece_volumes(cortex: Cortex, faces: Faces, piece: Ints) -> tuple[Array, Array]:
    """Signed volumes [mm^3] in each closed ``piece`` (M,) of faces, of white and of pial."""
    return signed_volumes(cortex.white.verts, faces, piece), signed_volumes(cortex.pial.verts, faces, piece)


def signed_volumes(verts: Verts, faces: Faces, piece: Ints) -> Array:
    """Signed volume [mm^3] in each closed ``piece`` (M,) of faces, positive if these face outwards."""
    offset = verts[faces[:, 0]] - verts[faces[0, 0]]  # a corner is as good: the triangle has one height over the origin
    face_volumes = geometry.inner(offset, geometry.face_vectors(verts, faces)) / 3
    return np.bincount(piece, face_volumes).astype(np.float64)


def place_of(point: Array) -> str:
    """Coordinates (3,) as text for messages."""
    x, y, z = np.round(point, 6) + 0.0  # no -0, and no 1e-17 on a plane of symmetry
    return f"({x:.6g}, {y:.6g}, {z:.6g})"


def vertices_at(text: str, cortex: Cortex) -> list[int]:
    """Vertices nearest to the places in a text, which :func:`place_of` wrote, on white or pial; each once."""
    points = np.array(re.findall(r"\(([-+\d.e]+), ([-+\d.e]+), ([-+\d.e]+)\)", text), dtype=np.float64)
    all_verts = np.concatenate([cortex.white.verts, cortex.pial.verts])
    nearest_vertices = (int(((all_verts - point) ** 2).sum(axis=1).argmin()) % cortex.n_vertices for point in points)
    return list(dict.fromkeys(nearest_vertices))
