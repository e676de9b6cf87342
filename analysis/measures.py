"""All measures of one cortex: ``measure(cortex)``, the same code for simulated and FreeSurfer surfaces."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold.surface import Cortex, Faces, PerVertex, Verts

SCALARS = (
    "n_vertices", "euler_characteristic", "area_pial_mm2", "area_white_mm2", "gyrification_index",
    "folding_index", "intrinsic_curvature_index", "mean_cortical_thickness_mm", "median_gyral_thickness_mm",
    "mean_sulcal_depth_mm", "wavelength_mm", "n_hinges", "n_hinges_3", "n_hinges_4", "n_crests",
    "crest_length_mm", "gyral_to_cortical_slope", "gyral_to_cortical_r",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Measures:
    """What the measuring room says of one cortex.

    ``scalars`` holds every name of ``SCALARS`` (None where a value cannot be had; then ``notes`` says why
    under the same name). ``maps`` are per-vertex arrays (N,), NaN where undefined, convex positive.
    ``regions``, ``crests``, ``hinges`` and ``arms`` are tables: one dict per row. ``parameters`` are the
    scales and options used.
    """

    cortex: Cortex
    scalars: Mapping[str, float | int | None]
    maps: Mapping[str, PerVertex] = field(repr=False)
    regions: list[dict[str, Any]] = field(default_factory=list, repr=False)
    crests: list[dict[str, Any]] = field(default_factory=list, repr=False)
    hinges: list[dict[str, Any]] = field(default_factory=list, repr=False)
    arms: list[dict[str, Any]] = field(default_factory=list, repr=False)
    parameters: Mapping[str, Any] = field(default_factory=dict, repr=False)
    notes: Mapping[str, str] = field(default_factory=dict, repr=False)


CURVATURE_SCALE = 3.0   # [mm], unless the mesh is too coarse for it
COARSE = 2.5            # mean edges that the curvature scale has at least
BROAD = 0.1             # of the radius of the sphere of equal area, above which the curvature scale is remarked on
FREESURFER_CAP = 5.0    # [mm], FreeSurfer's bound on thickness, for its own subjects only
LATER = "Crest lines and hinges are not measured by this version."


def measure(
    cortex: Cortex,
    *,
    curvature_scale: float | None = None,
    gyral: Mapping[str, Any] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Measures:
    """Everything the measuring room says of one cortex, by the same code whatever its origin.

    Parameters
    ----------
    cortex : Cortex
        White and pial surface [mm]; its mask, regions and maps are used where it has them.
    curvature_scale : float, optional
        Radius of the neighbourhoods of curvature [mm]. None: 3, but at least 2.5 mean edges of either surface. Pass
        one number to compare surfaces of different resolution.
    gyral : mapping, optional
        Options for :func:`morphofold.analysis.gyral_thickness`.
    progress : callable, optional
        Called as ``progress(what, share)`` before each step, with the share of steps done, 0 to 1.

    Returns
    -------
    Measures
        Maps ``H K k1 k2 shape_index curvedness`` (pial, convex positive), ``sulcal_depth`` (pial), ``area`` (white),
        ``cortical_thickness``, ``gyral_thickness``; and ``thickness_file`` if the cortex came with a thickness.
        Maps are NaN outside the cortex mask, ``area`` excepted. ``notes`` says how each scalar is defined where its
        name does not, and why it is None where it is; and, under ``curvature_scale``, ``cortex_mask`` and
        ``simulation``, what to know of the input before believing the numbers.

    Raises
    ------
    ValueError
        If a closed surface is inside out, white encloses more than pial or coincides with it, no vertex is cortex,
        the surfaces lie in a plane, or ``curvature_scale`` does not fit the mesh.

    Notes
    -----
    Cortex is what the cortex label says, without vertices where white and pial coincide (FreeSurfer closes the medial
    wall so, and without a label that is the only sign of it). Areas, Euler characteristic, gyrification and folding
    indices are of the whole surfaces, as FreeSurfer's are; means and maps are of the cortex. A surface with a border,
    or of several pieces, has no gyrification index.
    """
    from morphofold.analysis import _mesh, depth, gyrification, regions, thickness
    from morphofold.analysis._curvature import curvature, folding_indices

    tell = progress or (lambda what, share: None)
    white, pial, faces = cortex.white, cortex.pial, cortex.faces
    notes = dict.fromkeys(("n_hinges", "n_hinges_3", "n_hinges_4", "n_crests", "crest_length_mm"), LATER)

    tell("areas", 0.0)
    area_white, area_pial = (_mesh.vertex_areas(s.verts, faces) for s in (white, pial))
    closed, pieces = _mesh.is_closed(faces), _mesh.components(cortex.n_vertices, faces)[0]
    mask = _cortex_mask(cortex)
    if closed:
        _check_sides(cortex)
    sulcal = depth.sulcal_depth(pial.verts, faces)
    scale, remark = _curvature_scale(cortex, curvature_scale, float(min(area_white.sum(), area_pial.sum())))
    if remark:
        notes["curvature_scale"] = remark
    if cortex.cortex is None and cortex.origin != "simulation":
        notes["cortex_mask"] = (
            "No cortex label came with the surfaces: every vertex whose white and pial positions differ counts as "
            "cortex, the medial wall, if there is one, included."
        )
    if warnings := cortex.info.get("warnings"):
        notes["simulation"] = "; ".join(map(str, warnings))

    tell("cortical thickness", 0.05)
    cap = FREESURFER_CAP if cortex.origin == "FreeSurfer" else None
    cortical = thickness.cortical_thickness(white, pial, mode="surface", cap=cap)
    notes["mean_cortical_thickness_mm"] = (
        "Plain mean over the vertices of the cortex of half the sum of both closest distances between white and "
        + (f"pial, each at most {cap:g} mm as in FreeSurfer." if cap else "pial, without an upper bound.")
        + (" The file's own thickness is the map thickness_file." if "thickness" in cortex.maps else "")
    )

    tell("curvature", 0.3)
    bent = curvature(pial.verts, faces, scale)
    folding = folding_indices(curvature(white.verts, faces, scale), area_white)
    notes["folding_index"] = notes["intrinsic_curvature_index"] = (
        f"Of the whole white surface, curvature within {scale:.2f} mm; FreeSurfer's definition, but its curvature is "
        f"of one or two rings, so values differ. They depend on the scale: compare them at equal scale only. The "
        f"integral of K over 4 pi is {folding.total:.2f}"
        + (
            f" where Gauss-Bonnet asks for {_mesh.euler_characteristic(faces) / 2:g}; the excess measures how far the "
            "fit is beyond its range at this scale."
            if closed
            else "."
        )
    )

    notes["mean_sulcal_depth_mm"] = "Mean over the pial area of the cortex of the distance to the convex hull."
    gyrified = gyrification.gyrification_index(pial.verts, faces) if closed and pieces == 1 else None
    notes["gyrification_index"] = "Area of the whole pial surface over the area of its convex hull."
    if gyrified is None:
        what = f"is in {pieces} pieces" if pieces > 1 else "has a border"
        notes["gyrification_index"] = (
            f"The pial surface {what}, so the area of its convex hull is not that of what it would be unfolded. "
            "Sulcal depth is still the distance to that hull."
        )

    tell("gyral thickness", 0.6)
    across = thickness.gyral_thickness(cortex, **(gyral or {}))
    notes["median_gyral_thickness_mm"] = across.reason or (
        f"Wall to wall at mid-height on the pial surface; folds by a smoothing length of {across.scale:.1f} mm; "
        f"{across.coverage:.0%} of the mid-height contour could be measured, quartiles {across.lower:.1f} and "
        f"{across.upper:.1f} mm."
    )
    notes["wavelength_mm"] = across.reason or (
        "Twice the pial area of the cortex over the length of its mid-height contour: the way along the surface from "
        "fundus to fundus."
    )

    def of_cortex(values: PerVertex) -> PerVertex:
        return np.where(mask, values, np.nan)

    maps = {name: of_cortex(getattr(bent, name)) for name in ("H", "K", "k1", "k2", "shape_index", "curvedness")}
    maps["sulcal_depth"] = of_cortex(sulcal)
    maps["cortical_thickness"] = of_cortex(cortical)
    maps["gyral_thickness"] = across.per_vertex           # NaN off the cortex as it is
    maps["area"] = area_white
    if "thickness" in cortex.maps:
        maps["thickness_file"] = of_cortex(np.asarray(cortex.maps["thickness"], dtype=np.float64))

    tell("regions", 0.95)
    rows = regions.region_table(cortex, maps, across)
    slope, r, why = _gyral_on_cortical(rows)
    if rows:
        notes["regions"] = (
            "NumVert, area and thickness as mris_anatomical_stats counts them. n_hinges, crest_length_mm and "
            "gyrification_index of a region are not measured by this version; a region with less measured contour "
            "than two gyral widths has no gyral thickness."
        )
    notes["gyral_to_cortical_slope"] = notes["gyral_to_cortical_r"] = why
    scalars: dict[str, float | int | None] = dict.fromkeys(SCALARS)
    scalars.update(
        n_vertices=cortex.n_vertices,
        euler_characteristic=_mesh.euler_characteristic(faces),
        area_pial_mm2=float(area_pial.sum()),
        area_white_mm2=float(area_white.sum()),
        gyrification_index=gyrified,
        folding_index=folding.folding_index,
        intrinsic_curvature_index=folding.intrinsic_curvature_index,
        mean_cortical_thickness_mm=_mean(maps["cortical_thickness"]),
        mean_sulcal_depth_mm=_mean(maps["sulcal_depth"], area_pial),
        median_gyral_thickness_mm=_number(across.median),
        wavelength_mm=_number(across.wavelength),
        gyral_to_cortical_slope=slope,
        gyral_to_cortical_r=r,
    )
    parameters = {
        "curvature_scale_mm": scale,
        "curvature_map_surface": "pial",
        "folding_index_surface": "white",
        "cortical_thickness_mode": "surface",
        "cortical_thickness_cap_mm": cap,
        "cortex_mask": "label, and white off pial" if cortex.cortex is not None else "white off pial",
        "cortex_vertices": int(np.count_nonzero(mask)),
        "gyral_scale_mm": _number(across.scale),
        "gyral_coverage": _number(across.coverage),
    }
    tell("done", 1.0)
    return Measures(cortex, scalars, maps, rows, parameters=parameters, notes=notes)


def _cortex_mask(cortex: Cortex) -> NDArray[np.bool_]:
    """True (N,) where the vertex is cortex; refused if that is nowhere."""
    off = np.any(cortex.white.verts != cortex.pial.verts, axis=1)
    if not off.any():
        raise ValueError(
            f"{cortex.name}: white ({cortex.white.name}) and pial ({cortex.pial.name}) are the same surface at all "
            f"{cortex.n_vertices} vertices. Pass the two surfaces of one reconstruction."
        )
    label = np.ones_like(off) if cortex.cortex is None else np.asarray(cortex.cortex, dtype=bool)
    mask = off & label
    if not mask.any():
        raise ValueError(
            f"{cortex.name}: no vertex is cortex: the cortex label holds {label.sum()} of "
            f"{cortex.n_vertices} vertices, white and pial differ at {off.sum()}, and the two have none in common. "
            "Check the label, or leave it out."
        )
    return mask


def _check_sides(cortex: Cortex) -> None:
    """Refuse closed surfaces that are inside out, or swapped."""
    faces = cortex.faces
    inner, outer = (_volume(s.verts, faces) for s in (cortex.white, cortex.pial))
    for surface, volume in ((cortex.white, inner), (cortex.pial, outer)):
        if volume < 0:
            raise ValueError(
                f"{cortex.name}: {surface.name} is inside out, its signed volume is {volume:.4g} mm^3: its faces run "
                "clockwise seen from outside. Reverse the triangles (faces[:, ::-1])."
            )
    if inner > outer:
        raise ValueError(
            f"{cortex.name}: white ({cortex.white.name}) encloses {inner:.6g} mm^3, more than the {outer:.6g} mm^3 of "
            f"pial ({cortex.pial.name}). Were white and pial swapped?"
        )


def _volume(verts: Verts, faces: Faces) -> float:
    """Signed volume [mm^3] inside a closed surface, positive if faces run counter-clockwise seen from outside."""
    a, b, c = (verts[faces[:, k]] - verts[faces[0, 0]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _curvature_scale(cortex: Cortex, wanted: float | None, area: float) -> tuple[float, str]:
    """The scale of curvature [mm], and what to remark on it or the unit of length; empty if nothing."""
    from morphofold.analysis import _mesh

    edge = max(_mesh.mean_edge_length(s.verts, cortex.faces) for s in (cortex.white, cortex.pial))
    size = float(np.sqrt(area / (4 * np.pi)))
    usual = CURVATURE_SCALE if CURVATURE_SCALE < size / 2 else 0.0     # else only the mesh can say what is fine
    scale = max(usual, COARSE * edge) if wanted is None else float(wanted)
    say = f"curvature is taken within {scale:.3g}, mean edge {edge:.3g}, radius of the sphere of equal area {size:.3g}."
    if cortex.units != "mm":
        return scale, f"Lengths are in {cortex.units!r}, not mm, whatever the names of the measures say; {say}"
    if wanted is None and (CURVATURE_SCALE > BROAD * size or COARSE * edge > 10 * CURVATURE_SCALE):
        return scale, f"The coordinates do not look like millimetres of a human brain; {say}"
    return scale, ""


def _mean(values: PerVertex, weights: PerVertex | None = None) -> float | None:
    """Mean over the finite values; None if there are none."""
    known = np.isfinite(values)
    if not known.any():
        return None
    return float(np.average(values[known], weights=None if weights is None else weights[known]))


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _gyral_on_cortical(rows: list[dict[str, Any]]) -> tuple[float | None, float | None, str]:
    """Slope and correlation of the regions' median gyral on their mean cortical thickness, and a note."""
    pairs = [(row["cortical_thickness_mm"], row["gyral_thickness_mm"]) for row in rows]
    x, y = np.array([p for p in pairs if None not in p], dtype=np.float64).reshape(-1, 2).T
    if len(x) < 3 or np.ptp(x) == 0 or np.ptp(y) == 0:
        return None, None, f"A line needs three regions with both thicknesses that differ; there are {len(x)}."
    dx, dy = x - x.mean(), y - y.mean()
    slope, r = dx @ dy / (dx @ dx), dx @ dy / np.sqrt((dx @ dx) * (dy @ dy))
    return float(slope), float(r), f"Least squares over {len(x)} regions: median gyral on mean cortical thickness."
