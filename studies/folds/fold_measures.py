"""Numbers of simulated folds, one row per scene and growth stage, with the theory of the same body beside them.

Height is the distance of the pial surface from the centre, as a function of the position before growth, so walls may
overhang or touch. All numbers are for the whole sphere, including the mirrored part.
"""

import json
import math
from functools import lru_cache
from typing import Any

import numpy as np

from morphofold import analysis
from morphofold.errors import DoesNotApply
from morphofold.io.files import decoding, existing_file
from morphofold.progress_callbacks import Progress, logged
from morphofold.sim.output.run_inputs import AND_GROW_AGAIN
from morphofold.sim.run import Simulation
from morphofold.sim.scene import Scene
from morphofold.sim.theory import Bifurcation, bifurcation
from morphofold.studies.folds.prominent_peaks import prominent_peaks
from morphofold.surface import Cortex

Row = dict[str, Any]

#: a surface is called folded from this rms of the height, over the cortical thickness of the scene
FOLDED_RMS = 0.1
#: least prominence of a gyrus or sulcus over the rms of the height
PROMINENCE = 0.25
#: meaning of the columns, for an index
COLUMN_TEXTS = {
    "gyrification_index": "area of the pial surface over that of its convex hull",
    "height_rms_mm": "root mean square of the height about its mean",
    "height_skewness": "mean cube of the height about its mean over rms^3: near 0 for waves, below 0 for narrow "
    "furrows between broad gyri",
    "sulci": f"pits of the height that lie {PROMINENCE:g} rms or more below the pass to a deeper one",
    "gyri": f"peaks of the height that rise {PROMINENCE:g} rms or more above the pass to a higher one; a winding gyrus "
    "without such a pass counts once",
    "degree": "degree l of spherical harmonics, mean over the spectrum of the height, weighted by power",
    "wavelength_mm": "2 pi C / sqrt(l (l + 1)), on the sphere of radius C before growth",
    "gyral_thickness_mm": "median width of gyri from wall to wall at mid-height, on the folded surface",
    "cortical_thickness_mm": "mean over the vertices, as FreeSurfer defines thickness",
    "theory_g": "growth at which the smooth sphere first wrinkles, at the kappa/mu of the scene",
    "theory_degree": "degree of those first wrinkles",
    "theory_wavelength_mm": "their wavelength, defined as wavelength_mm",
    "film_wavelength_mm": "2 pi T (mu ratio / 3)^(1/3), of a stiff film on a soft flat ground (Sec. IV of the paper)",
    "first_contact_g": "growth at which walls of folds first touched, to 0.01; n/a: never",
    "crossings": "edges and vertices that cross the pial surface by more than health allows",
}


def fold_rows(simulation: Simulation, progress: Progress = logged) -> list[Row]:
    """Numbers of every stage beyond g = 1. The stage g = 1 must exist: it is the reference of the height.

    Keys are those of :data:`COLUMN_TEXTS` and those of the body. Numbers that a surface without folds lacks are None,
    and ``note`` gives the reason.
    """
    scene = simulation.scene
    reference, theory_row = simulation.cortex(1.0), {**expected(scene), "first_contact_g": first_contact(simulation)}
    stages = [g for g in simulation.stages if g > 1]
    rows = []
    for stage_index, g in enumerate(stages):
        progress(stage_index / len(stages), f"g = {g:.2f}")
        rows.append({**_body(scene), "growth": g, **fold_measures(reference, simulation.cortex(g)), **theory_row})
    progress(1.0, "done")
    return rows


def fold_measures(reference: Cortex, cortex: Cortex) -> Row:
    """Numbers of one stage; ``reference`` is the same cortex before growth."""
    thickness = float(cortex.info["reference_thickness"])
    vertex_height = np.linalg.norm(cortex.pial.verts, axis=1)
    spectrum = analysis.power_spectrum(reference.pial.verts, reference.faces, vertex_height)
    vertex_area = analysis.vertex_areas(reference.pial.verts, reference.faces)
    centred_height = vertex_height - np.average(vertex_height, weights=vertex_area)
    health = cortex.info["health"]
    row: Row = {
        "gyrification_index": analysis.gyrification_index(cortex.pial.verts, cortex.faces),
        "height_rms_mm": spectrum.rms,
        "cortical_thickness_mm": float(np.mean(cortex.maps["thickness"])),
        **dict.fromkeys(("sulci", "gyri", "degree", "wavelength_mm", "gyral_thickness_mm", "height_skewness")),
        "crossings": health["crossings"],
        "deepest_crossing_edges": health["deepest_crossing"],
        "note": None,
    }
    if spectrum.rms < FOLDED_RMS * thickness:
        return {**row, "note": f"not folded: height rms {spectrum.rms:.2g} mm is below {FOLDED_RMS:g} T"}
    gyral_widths = analysis.gyral_thickness(cortex)
    return {
        **row,
        "sulci": len(prominent_peaks(cortex.faces, -vertex_height, PROMINENCE * spectrum.rms)),
        "gyri": len(prominent_peaks(cortex.faces, vertex_height, PROMINENCE * spectrum.rms)),
        "degree": spectrum.degree,
        "wavelength_mm": spectrum.wavelength,
        "gyral_thickness_mm": gyral_widths.median if np.isfinite(gyral_widths.median) else None,
        "height_skewness": float(np.average((centred_height / spectrum.rms) ** 3, weights=vertex_area)),
        "note": gyral_widths.reason or None,
    }


def first_contact(simulation: Simulation) -> float | None:
    """Growth at which walls of the pial surface, or one and its mirror image, first touched; None if never."""
    path = simulation.path / "log.jsonl"
    with decoding(path, "the log of a run", f"Delete {simulation.path} {AND_GROW_AGAIN}."):
        for log_entry in map(json.loads, existing_file(path, "log").read_text("utf-8").splitlines()):
            effects = log_entry["effects"]
            if effects.get("contact", {}).get("pairs") or effects.get("symmetry", {}).get("pressed"):
                return float(log_entry["growth"])
    return None


def _body(scene: Scene) -> Row:
    geometry, material = sphere(scene), scene.material
    return {
        "scene": scene.name,
        "level": scene.accuracy.level,
        "portion": geometry.portion,
        "thickness_mm": geometry.cortex_thickness,
        "T_over_C": geometry.cortex_thickness / geometry.radius,
        "mu_ratio": material.mu_ratio,
        "kappa_ratio": material.kappa_ratio,
        "law": scene.growth.law,
    }


def expected(scene: Scene) -> Row:
    """First wrinkles by linear stability of the smooth sphere, and by the formula for a stiff film."""
    geometry, material = sphere(scene), scene.material
    T, C = geometry.cortex_thickness, geometry.radius
    if not material.theory:
        raise DoesNotApply(
            f"{scene.name}: the theory is for a neo-Hookean material, not for {material.model}; leave it out."
        )
    first_wrinkles = _first_wrinkles(
        T / C, material.mu_ratio, scene.growth.law, material.kappa_ratio, geometry.hole_radius / C
    )
    return {
        "theory_g": first_wrinkles.g_crit,
        "theory_degree": first_wrinkles.mode,
        "theory_wavelength_mm": first_wrinkles.wavelength * C,
        "film_wavelength_mm": film_wavelength(T, material.mu_ratio),
    }


@lru_cache  # one body is in several figures
def _first_wrinkles(T_over_C: float, mu_ratio: float, law: str, kappa_ratio: float, A_over_C: float) -> Bifurcation:
    return bifurcation(T_over_C, mu_ratio, law, kappa_ratio, A_over_C=A_over_C)


def film_wavelength(thickness: float, mu_ratio: float) -> float:
    """2 pi t (mu_f / 3 mu_s)^(1/3), in the unit of the thickness (Razavi et al. 2015, Sec. IV, after their [47])."""
    return 2 * math.pi * thickness * (mu_ratio / 3) ** (1 / 3)


def sphere(scene: Scene) -> Any:
    """The sphere of a scene; raises ``DoesNotApply`` if it has another body."""
    if scene.geometry.shape != "sphere":
        raise DoesNotApply(f"{scene.name}: is a {scene.geometry.shape}; folds can be counted only on a sphere.")
    return scene.geometry
