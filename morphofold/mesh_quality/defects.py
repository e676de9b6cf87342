"""Defects of a mesh and signs of a wrong input: what makes measuring impossible is refused, the rest gives a note."""

from collections.abc import Iterator

import numpy as np

from morphofold import geometry
from morphofold.errors import BadMesh
from morphofold.frozen_arrays import Bools
from morphofold.intersections.intersection import self_intersections
from morphofold.mesh_quality import cortex_checks
from morphofold.note_texts import note
from morphofold.surface import Cortex, PerVertex
from morphofold.validators import check_mesh

LEAST_HEIGHT_IN_EDGES = 1e-4  # of the mean edge: height below which a triangle is a needle or a cap
USUAL_CROSSED_SHARE = 5e-4  # of the triangles of the cortex that others cross: FreeSurfer's pial surfaces of people
LARGEST_CROSSED_SHARE = 10 * USUAL_CROSSED_SHARE
LARGEST_OUTSIDE_SHARE = 0.01  # share of the cortex outside pial; in people at most 0.0002
# shift of pial over the distance between white and pial; in people 0.07, after a shift of 2 mm 0.56
LARGEST_SHIFT_OVER_DISTANCE = 0.3
LARGEST_ROUNDING_IN_EDGES = 0.005  # of the mean edge, above which rounding is noted: noise of 1 % of an edge is a lot


def check_edges(cortex: Cortex, why_not: str = "") -> None:
    """Refuse triangles that do not form a surface: more than two at an edge, flipped on one or both, or torn apart.

    ``why_not``: why a repair was not possible, if it was tried.

    Raises
    ------
    ValueError
        The message gives the number of edges or vertices, the first of them, its place on white, and the cure.
    """
    attempt = f" Repair was not possible: {why_not}." if why_not else ""
    check_mesh(cortex.white.verts, cortex.faces, cortex.called)
    if len(unlike_faces := np.flatnonzero(np.any(cortex.white.faces != cortex.pial.faces, axis=1))):
        raise BadMesh(
            f"{cortex.called}: {len(unlike_faces)} of {len(cortex.faces)} triangles have opposite orientation on white "
            f"and on pial; the first is triangle {unlike_faces[0]}, at "
            f"{_vertex_coordinates(cortex, int(cortex.faces[unlike_faces[0], 0]))}. Flip those of one surface.{attempt}"
        )
    edge_ends, n_triangles = geometry.edges_and_counts(cortex.faces)
    if len(crowded_edges := edge_ends[n_triangles > 2]):
        i, j = crowded_edges[0].tolist()
        raise BadMesh(
            f"{cortex.called}: {len(crowded_edges)} edges have more than two triangles; the first joins vertices {i} "
            f"and {j}, at {_vertex_coordinates(cortex, i)}, with {n_triangles[n_triangles > 2][0]}. The surface "
            f"branches there, or some triangles occur twice: remove those that do not belong to it.{attempt}"
        )
    n_vertices = cortex.n_vertices
    directed_edges = np.sort((cortex.faces * n_vertices + np.roll(cortex.faces, -1, axis=1)).ravel())
    if len(double_edges := directed_edges[1:][directed_edges[1:] == directed_edges[:-1]]):
        i, j = divmod(int(double_edges[0]), n_vertices)
        has_edge = ((cortex.faces == i) & (np.roll(cortex.faces, -1, axis=1) == j)).any(axis=1)
        face1, face2 = np.flatnonzero(has_edge)
        raise BadMesh(
            f"{cortex.called}: {len(double_edges)} edges have the same direction in both of their triangles; the first "
            f"runs from vertex {i} to {j}, at {_vertex_coordinates(cortex, i)}, in triangles {face1} and {face2}: one "
            "of the two is flipped. Make all triangles counter-clockwise seen from outside (for example with "
            f"trimesh.repair.fix_winding).{attempt}"
        )
    border, source = cortex_checks.border_duplicates(cortex, cortex.faces)
    if len(torn_rows := np.flatnonzero(source != border)):
        i, j = source[torn_rows[0]], border[torn_rows[0]]
        raise BadMesh(
            f"{cortex.called}: {len(torn_rows)} vertices on a border have the same position as another one, on white "
            f"and on pial; the first is vertex {j}, at the position of vertex {i}, at {_vertex_coordinates(cortex, i)}:"
            f" the surface is torn there. Merge vertices that have the same position.{attempt}"
        )


def remarks(cortex: Cortex, mask: Bools, original: Cortex | None = None) -> dict[str, str]:
    """Notes ``mesh``, ``crossing`` and ``pair``.

    ``mesh``: unused vertices, pieces, borders, rounding, thin triangles. ``crossing``: white lies outside pial.
    ``pair``: so many vertices lie outside, or pial is shifted so far, that the two are hardly of one cortex.
    ``original``: the cortex with the vertices that no triangle uses, if these were left out.
    """
    sentences, n_cortex = list(_mesh_problems(cortex, original or cortex)), np.count_nonzero(mask)
    notes = {"mesh": " ".join(dict.fromkeys(sentences))} if sentences else {}  # each once if it is one surface
    if len(outside := np.flatnonzero(mask & cortex_checks.outside(cortex))):
        place_text = _vertex_coordinates(cortex, outside[0])
        notes |= note("crossing", count=len(outside), whole=n_cortex, first=outside[0], where=place_text)
    if len(outside) > LARGEST_OUTSIDE_SHARE * n_cortex:
        notes["pair"] = (
            f"White lies outside pial at {len(outside) / n_cortex:.1%} of the cortex: the two probably "
            "do not belong together. Take both from one reconstruction, in one coordinate frame."
        )
    elif geometry.is_closed(cortex.faces):
        shift = cortex_checks.shift(cortex, mask)
        shift_length = float(np.linalg.norm(shift))
        median_distance = float(np.median(geometry.norms(cortex.pial.verts - cortex.white.verts)[mask]))
        if shift_length > LARGEST_SHIFT_OVER_DISTANCE * median_distance:
            notes["pair"] = (
                f"Pial as a whole is shifted from white by about {shift_length:.2g} {cortex.units} "
                f"({' '.join(f'{x:+.2g}' for x in shift)}); the two are {median_distance:.2g} apart. Take both from "
                "one reconstruction, in one coordinate frame."
            )
    return notes


def _mesh_problems(cortex: Cortex, original: Cortex) -> Iterator[str]:
    """Sentences of the note ``mesh``; ``original``: the cortex with the vertices that no triangle uses."""
    n_pieces, piece = geometry.components(cortex.n_vertices, cortex.faces)
    if n_unused := np.count_nonzero(~geometry.used(original.n_vertices, original.faces)):
        yield (
            f"{n_unused} of {original.n_vertices} vertices belong to no triangle and have no values. Vertex numbers in "
            "other notes do not count them."
        )
    for surface in (original.white, original.pial):
        if surface.unknown:
            yield f"{surface.unknown} vertices of {surface.name} are NaN."
    is_closed = geometry.is_closed(cortex.faces)
    n_handles = n_pieces - (np.count_nonzero(piece >= 0) - len(cortex.faces) // 2) // 2 if is_closed else 0
    if n_handles:
        yield f"The surface has {n_handles} handle{'' if n_handles == 1 else 's'}, which a cortex does not have."
    if n_pieces > 1:
        sizes = np.sort(np.bincount(piece[piece >= 0]))[::-1].tolist()
        sizes_text = ", ".join(map(str, sizes[:3])) + (", ..." if n_pieces > 3 else "")
        n_cavities = len(cortex_checks.cavities(cortex)) if is_closed else 0
        sizes_text += f" vertices ({n_cavities} of them walls of cavities)" if n_cavities else " vertices"
        yield f"The surface is in {n_pieces} pieces, of {sizes_text}. The numbers describe all of them together."
    if len(border_edges := geometry.border_edges(cortex.faces)):
        yield (
            f"The surface has a border of {len(border_edges)} edges, one at vertex {border_edges[0, 0]}, "
            f"{_vertex_coordinates(cortex, border_edges[0, 0])}. Holes have no area, and crests end there."
        )
    for surface in (cortex.white, cortex.pial):
        verts, mean_edge = surface.verts, geometry.mean_edge_length(surface.verts, surface.faces)
        rounding = float(np.spacing(np.abs(verts).max().astype(np.float32)))
        if rounding > LARGEST_ROUNDING_IN_EDGES * mean_edge and np.array_equal(verts, verts.astype(np.float32)):
            yield (
                f"The coordinates of {surface.name} are rounded to {rounding:.2g} (float32, far from the origin), "
                f"which is {rounding / mean_edge:.0%} of the mean edge, so the curvature shows the rounding. Move the "
                "surface to the origin before you write it."
            )
        longest_side = np.sqrt(geometry.triangles(verts, surface.faces)[2].max(axis=1))
        heights = 2 * geometry.face_areas(verts, surface.faces) / np.maximum(longest_side, 1e-300)
        if len(sliver := np.flatnonzero(heights < LEAST_HEIGHT_IN_EDGES * mean_edge)):
            place_text = cortex_checks.place_of(verts[surface.faces[sliver[0], 0]])
            yield (
                f"{len(sliver)} of {len(surface.faces)} triangles of {surface.name} are needles or caps of almost zero "
                f"area; the first is triangle {sliver[0]}, at {place_text}. The measures here allow them; other tools "
                "may not."
            )


def self_crossings(cortex: Cortex, mask: Bools) -> tuple[dict[str, str], float]:
    """Notes ``self_crossing`` and ``many_self_crossings``, and the share of white's triangles that others cross.

    The note gives how many triangles of white or pial are crossed by others of the same surface, and the deepest place.
    Only crossings and triangles with a vertex in the cortex, ``mask`` (N,), count: thickness and curvature are maps of
    the cortex, and FreeSurfer does not avoid crossings where it closes the medial wall.
    """
    share_texts, crossing_texts, white_share = list[str](), [], 0.0
    for surface in (cortex.white,) if cortex.is_one_surface else (cortex.white, cortex.pial):
        in_cortex = np.any(mask[surface.faces], axis=1)
        crossings = self_intersections(surface, vertices=False)
        crossings = crossings.only(np.flatnonzero(mask[crossings.edge].any(axis=1) | in_cortex[crossings.face]))
        if len(crossings):
            deepest, n_triangles = int(crossings.depth.argmax()), np.count_nonzero(in_cortex)
            n_crossed = np.count_nonzero(in_cortex[crossings.crossed_faces(surface.faces)])
            share = float(n_crossed / n_triangles)
            white_share = share if surface is cortex.white else white_share
            if share > LARGEST_CROSSED_SHARE:
                share_texts.append(f"{share:.1%} of the triangles of {surface.name}")
            crossing_texts.append(
                f"{surface.name} intersects itself: {n_crossed} of {n_triangles} triangles of the cortex, deepest at "
                f"{cortex_checks.place_of(crossings.point[deepest])}, by {crossings.depth[deepest]:.2g} {cortex.units}"
            )
    many = {"shares": " and ".join(share_texts), "usual": USUAL_CROSSED_SHARE}
    notes = note("many_self_crossings", **many) if share_texts else {}
    return notes | (note("self_crossing", places="; ".join(crossing_texts)) if crossing_texts else {}), white_share


def given_thickness(cortex: Cortex, mask: Bools) -> tuple[PerVertex, dict[str, str]]:
    """The thickness (N,) [mm] that came with the surfaces, and the note ``thickness_file`` on its gaps.

    It is NaN outside the cortex, and where it is not a positive number. FreeSurfer writes 0 where nothing was measured,
    and the mask holds no vertex where white and pial coincide.
    """
    thickness = np.asarray(cortex.maps["thickness"], dtype=np.float64)
    is_positive = np.isfinite(thickness) & (thickness > 0)
    notes, known_thickness = {}, np.where(mask & is_positive, thickness, np.nan)
    if len(gaps := np.flatnonzero(mask & ~is_positive)):
        n_gaps, n_cortex, first_gap = len(gaps), np.count_nonzero(mask), gaps[0]
        counts = {"count": n_gaps, "whole": n_cortex, "share": n_gaps / n_cortex, "zeros": np.sum(thickness[gaps] == 0)}
        notes = note("thickness_file", first=first_gap, where=_vertex_coordinates(cortex, first_gap), **counts)
    return known_thickness, notes


def _vertex_coordinates(cortex: Cortex, vertex: int) -> str:
    return cortex_checks.place_of(cortex.white.verts[vertex])


# [mm^2] of white: human hemispheres have 60,000 to 130,000; smaller ones may be of an animal
LARGEST_WHITE_AREA_MM2 = 150_000.0
# of the radius of the sphere of equal area: mean x of a surface on one side (people 0.4)
LEAST_SIDE_OFFSET_IN_RADII = 0.15
LARGEST_USUAL_HOLES = 110  # that FreeSurfer repaired; the Euler number of such a surface is 2 - 2 * 110
LEAST_LABELLED_SHARE = 0.5  # of the vertices: FreeSurfer's cortex labels hold 0.9
LARGEST_CAPPED_SHARE = 0.02  # of the cortex: people have 0.002 at FreeSurfer's cap of 5 mm
# ratio to the measured thickness, and correlation with it; fsaverage has 1.00 and 0.9
LARGEST_THICKNESS_RATIO, LEAST_THICKNESS_CORRELATION = 2.0, 0.3


def input_remarks(cortex: Cortex) -> dict[str, str]:
    """Notes ``size`` (too large for a person), ``side`` (left named right), ``holes`` (many were repaired) and
    ``cortex_label`` (less than half).

    For reconstructed cortices only: a simulated one may have any size and position.
    """
    if cortex.origin == "simulation":
        return {}
    holes = cortex.info.get("surface_holes", 0)
    notes = note("holes", holes=holes, usual=LARGEST_USUAL_HOLES) if holes > LARGEST_USUAL_HOLES else {}
    area = float(geometry.face_areas(cortex.white.verts, cortex.faces).sum())
    radius = (area / (4 * np.pi)) ** 0.5
    if cortex.units == "mm" and area > LARGEST_WHITE_AREA_MM2:
        notes |= note("size", area=area / 100, radius=radius)
    mean_x, is_right = float(cortex.white.verts[:, 0].mean()), cortex.hemi == "rh"
    if LEAST_SIDE_OFFSET_IN_RADII * radius < abs(mean_x) < radius and (mean_x > 0) != is_right:
        notes |= note("side", cortex=cortex, x=mean_x, side="left" if is_right else "right")
    if cortex.cortex is not None and (labelled_share := float(np.mean(cortex.cortex))) < LEAST_LABELLED_SHARE:
        notes |= note("cortex_label", share=labelled_share)
    return notes


def at_cap(thickness: PerVertex, cap: float | None) -> dict[str, str]:
    """Note ``thickness_cap``: much of the cortex is as thick as the cap allows."""
    known = thickness[np.isfinite(thickness)]
    if cap is None or not len(known) or (capped := float(np.mean(known >= cap * (1 - 1e-9)))) <= LARGEST_CAPPED_SHARE:
        return {}
    return note("thickness_cap", share=capped, cap=cap)


def against_file(file_thickness: PerVertex, measured: PerVertex) -> dict[str, str]:
    """Note ``thickness_unlike``: the thickness that came with the surfaces, NaN where unknown, does not match them."""
    both_known: Bools = np.isfinite(file_thickness) & np.isfinite(measured)
    if not both_known.any():
        return {}
    known_pair = file_thickness[both_known], measured[both_known]
    median_ratio = float(np.median(known_pair[0]) / np.median(known_pair[1]))
    varies = all(values.std() / values.mean() > 0.01 for values in known_pair)  # else the correlation is that of noise
    r = float(np.corrcoef(*known_pair)[0, 1]) if varies else 1.0
    if 1 / LARGEST_THICKNESS_RATIO <= median_ratio <= LARGEST_THICKNESS_RATIO and r >= LEAST_THICKNESS_CORRELATION:
        return {}
    return note("thickness_unlike", ratio=median_ratio, r=r)
