"""Faults of a mesh: those that no measure can bear are refused, the others are told beside the numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from morphofold import geometry
from morphofold.analysis.mesh_quality import checks
from morphofold.errors import BadMesh
from morphofold.intersections.intersection import self_intersections
from morphofold.surface import Cortex, PerVertex, check_mesh

#: notes that a command tells, too, by their code: what they say and what to do (docs/messages.md)
WARNINGS = {
    "simulation": ("The stage broke bounds of health; their names come first.", "See the table of bounds below."),
    "repair": (
        "Faults of the mesh were mended, so that triangles or vertices differ from the file's.",
        "Look at the places that are named; --no-repair refuses instead.",
    ),
    "cortex_mask": (
        "No cortex label came with the surfaces, so the medial wall was found otherwise.",
        "Put label/?h.cortex.label beside them.",
    ),
    "parcellation": (
        "No annotation came with the surfaces, so there is no table of regions.",
        "Put label/?h.aparc.annot beside them, or name one with --annot.",
    ),
    "cortex_label": (
        "The cortex label holds far fewer vertices than FreeSurfer's.",
        "Check that it is the cortex, not its medial wall.",
    ),
    "size": ("The surface is not of the size of a brain.", "Check that its unit is mm."),
    "side": ("The surface lies where the other hemisphere does.", "Check --hemi and the name of the file."),
    "mesh": (
        "Unused vertices, pieces, borders, rounded coordinates, or triangles of next to no area.",
        "Read which; measures bear them, other tools may not.",
    ),
    "crossing": ("White lies outside pial at some vertices.", "Thickness there is a distance without sign."),
    "pair": (
        "White and pial probably do not belong together, or one was moved.",
        "Take both from one reconstruction, in one frame.",
    ),
    "self_crossing": ("A surface passes through itself.", "Doubt curvature and thickness at the places named."),
    "thickness_file": ("The thickness that came with the surfaces has gaps in the cortex.", "Compute it anew."),
    "thickness_unlike": (
        "The thickness that came with the surfaces is not what lies between them.",
        "Check its unit, and that it is of these surfaces.",
    ),
    "thickness_cap": (
        "Much of the cortex is as thick as the cap lets it be, so means are too low.",
        "Raise --thickness-cap, or leave it out.",
    ),
    "curvature_scale": (
        "The mesh is too coarse, or the body too small, for the usual scale of curvature.",
        "Compare curvature only at equal scales (--curvature-scale).",
    ),
    "gyral_width": (
        "The gyral net is of a width that does not go with the gyral thickness.",
        "Look at the white surface, or give --gyral-width.",
    ),
}
THIN = 1e-4  # of the mean edge: height below which a triangle is a needle or a cap
OUTSIDE = 0.01  # of the cortex: people have 0.0002 at most outside pial
SHIFTED = 0.3  # of the distance of white and pial, that pial is moved by; people have 0.07, by 2 mm 0.56
ROUGH = 0.005  # of the mean edge, above which rounding is remarked on: noise of 1 % of an edge is a lot


def check_edges(cortex: Cortex, why_not: str = "") -> None:
    """Refuse triangles that are no surface: more than two at an edge, flipped on both or one, or torn from neighbours.

    ``why_not`` is why they could not be repaired, if that was tried.

    Raises
    ------
    ValueError
        With the number of edges or vertices, the first of them and its place on white, and the cure.
    """
    tried = f" Repair leaves it so: {why_not}." if why_not else ""
    check_mesh(cortex.white.verts, cortex.faces, cortex.called)
    if len(unlike := np.flatnonzero(np.any(cortex.white.faces != cortex.pial.faces, axis=1))):
        raise BadMesh(
            f"{cortex.called}: {len(unlike)} of {len(cortex.faces)} triangles run one way round on white and the other "
            f"on pial; the first is triangle {unlike[0]}, at {_place(cortex, int(cortex.faces[unlike[0], 0]))}. Turn "
            f"those of one surface.{tried}"
        )
    pair, count = geometry.edges_and_counts(cortex.faces)
    if len(crowded := pair[count > 2]):
        i, j = crowded[0].tolist()
        raise BadMesh(
            f"{cortex.called}: {len(crowded)} edges have more than two triangles; the first is that of vertices {i} "
            f"and {j}, at {_place(cortex, i)}, with {count[count > 2][0]}. The surface branches there, or holds "
            f"triangles twice: remove those that do not belong to it.{tried}"
        )
    n = cortex.n_vertices
    ways = np.sort((cortex.faces * n + np.roll(cortex.faces, -1, axis=1)).ravel())
    if len(same := ways[1:][ways[1:] == ways[:-1]]):
        i, j = divmod(int(same[0]), n)
        one, two = np.flatnonzero(((cortex.faces == i) & (np.roll(cortex.faces, -1, axis=1) == j)).any(axis=1)).tolist()
        raise BadMesh(
            f"{cortex.called}: {len(same)} edges are run the same way by both of their triangles; the first is that "
            f"from vertex {i} to {j}, at {_place(cortex, i)}, of triangles {one} and {two}: one of the two is flipped. "
            f"Turn it, so that all run counter-clockwise seen from outside (trimesh.repair.fix_winding does).{tried}"
        )
    border, source = checks.border_duplicates(cortex, cortex.faces)
    if len(torn := np.flatnonzero(source != border)):
        i, j = source[torn[0]], border[torn[0]]
        raise BadMesh(
            f"{cortex.called}: {len(torn)} vertices on a border lie where another one does, on white and on pial; the "
            f"first is vertex {j}, in the place of vertex {i}, at {_place(cortex, i)}: the surface is torn there. Make "
            f"one vertex of those at the same place.{tried}"
        )


def remarks(cortex: Cortex, mask: NDArray[np.bool_], given: Cortex | None = None) -> dict[str, str]:
    """Notes ``mesh`` (vertices, pieces, borders, rounding, thin triangles), ``crossing``: white lies outside pial, and
    ``pair``: at so many vertices, or so far moved off it, that the two are hardly of one cortex.

    ``given``: the cortex with the vertices that no triangle uses, if these were left out.
    """
    problems = []
    pieces, piece = geometry.components(cortex.n_vertices, cortex.faces)
    whole = given or cortex
    if unused := np.count_nonzero(~geometry.used(whole.n_vertices, whole.faces)):
        problems.append(
            f"{unused} of {whole.n_vertices} vertices belong to no triangle, and have no values; vertices are numbered "
            "without them in other remarks."
        )
    if pieces > 1:
        sizes = np.sort(np.bincount(piece[piece >= 0]))[::-1].tolist()
        most = ", ".join(map(str, sizes[:3])) + (", ..." if pieces > 3 else "")
        hollow = len(checks.cavities(cortex)) if geometry.is_closed(cortex.faces) else 0
        most += f" vertices ({hollow} of them walls of cavities)" if hollow else " vertices"
        problems.append(f"The surface is in {pieces} pieces, of {most}: numbers are of all of them together.")
    if len(border := geometry.border_edges(cortex.faces)):
        problems.append(
            f"The surface has a border of {len(border)} edges, one at vertex {border[0, 0]}, "
            f"{_place(cortex, border[0, 0])}: holes have no area, and crests end there."
        )
    for surface in (cortex.white, cortex.pial):
        verts = surface.verts
        step = float(np.spacing(np.abs(verts).max().astype(np.float32)))
        edge = geometry.mean_edge_length(surface.verts, surface.faces)
        if step > ROUGH * edge and np.array_equal(verts, verts.astype(np.float32)):
            problems.append(
                f"The coordinates of {surface.name} are rounded to {step:.2g} (float32, so far from the origin), which "
                f"is {step / edge:.0%} of the mean edge: curvature is that of the steps. Move the surface to the "
                "origin before it is written."
            )
        corner = surface.verts[surface.faces]
        longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
        height = 2 * geometry.face_areas(surface.verts, surface.faces) / np.maximum(longest, 1e-300)
        if len(thin := np.flatnonzero(height < THIN * edge)):
            problems.append(
                f"{len(thin)} of {len(surface.faces)} triangles of {surface.name} are needles or caps, of next to no "
                f"area, the first of them triangle {thin[0]}, at {checks.place_of(corner[thin[0], 0])}: measures bear "
                "them, other tools may not."
            )
    notes = {"mesh": " ".join(problems)} if problems else {}
    if len(crossed := np.flatnonzero(mask & checks.outside(cortex))):
        notes["crossing"] = (
            f"White lies outside pial at {len(crossed)} of {np.count_nonzero(mask)} vertices of the cortex, the first "
            f"of them vertex {crossed[0]}, at {_place(cortex, crossed[0])}: thickness there is a distance without sign."
        )
    if len(crossed) > OUTSIDE * np.count_nonzero(mask):
        notes["pair"] = (
            f"White lies outside pial at {len(crossed) / np.count_nonzero(mask):.1%} of the cortex: the two probably "
            "do not belong together. Take both from one reconstruction, in one frame."
        )
    elif geometry.is_closed(cortex.faces):
        moved = checks.shift(cortex, mask)
        far = float(np.linalg.norm(moved))
        apart = float(np.median(np.linalg.norm(cortex.pial.verts - cortex.white.verts, axis=1)[mask]))
        if far > SHIFTED * apart:
            notes["pair"] = (
                f"Pial is moved off white by about {far:.2g} {cortex.units} as a whole, by {checks.place_of(moved)}, "
                f"where the two are {apart:.2g} apart. Take both from one reconstruction, in one frame."
            )
    return notes


def self_crossings(cortex: Cortex, mask: NDArray[np.bool_]) -> tuple[dict[str, str], float]:
    """Note ``self_crossing``: how many triangles of white or pial others of the same surface cross, and where most.

    Also the share of white's triangles that others cross.

    Of crossings and triangles, those with a vertex in the cortex, ``mask`` (N,): thickness and curvature are maps of
    it, and FreeSurfer closes the medial wall without care for them.
    """
    problems, of_white = [], 0.0
    for surface in (cortex.white, cortex.pial):
        inside = np.any(mask[surface.faces], axis=1)
        found = self_intersections(surface, vertices=False)
        found = found.at(np.flatnonzero(mask[found.edge].any(axis=1) | inside[found.face]))
        if len(found):
            deepest, among = int(found.depth.argmax()), np.count_nonzero(inside[found.crossed_faces(surface.faces)])
            if surface is cortex.white:
                of_white = float(among / np.count_nonzero(inside))
            problems.append(
                f"{surface.name} crosses itself: {among} of {np.count_nonzero(inside)} triangles of the cortex, "
                f"deepest at {checks.place_of(found.point[deepest])}, by {found.depth[deepest]:.2g} {cortex.units}"
            )
    if not problems:
        return {}, 0.0
    return {"self_crossing": f"{'; '.join(problems)}. Curvature and thickness are in doubt there."}, of_white


def given_thickness(cortex: Cortex, mask: NDArray[np.bool_]) -> tuple[PerVertex, dict[str, str]]:
    """The thickness (N,) [mm] that came with the surfaces, and the note ``thickness_file`` on its gaps.

    NaN outside the cortex, and where it is no positive number: FreeSurfer writes 0 where nothing was measured, and the
    mask holds no vertex at which white and pial coincide.
    """
    given = np.asarray(cortex.maps["thickness"], dtype=np.float64)
    known = np.isfinite(given) & (given > 0)
    notes = {}
    if len(gaps := np.flatnonzero(mask & ~known)):
        zeros, within = np.count_nonzero(given[gaps] == 0), np.count_nonzero(mask)
        notes["thickness_file"] = (
            f"The thickness that came with the surfaces is no positive number at {len(gaps)} of {within} vertices of "
            f"the cortex ({len(gaps) / within:.1%}), {zeros} of them 0, the first of them vertex {gaps[0]}, at "
            f"{_place(cortex, gaps[0])}: the means of it leave them out."
        )
    return np.where(mask & known, given, np.nan), notes


def _place(cortex: Cortex, vertex: int) -> str:
    return checks.place_of(cortex.white.verts[vertex])
