"""Fig. 8 of Razavi et al. (2015) as an experiment: the same body, with its own thickness map and with an even cortex.

Both bodies of a pair have the same mesh directions, imperfection and mean thickness. So what differs between them is
what the map does: in each parcel of the sphere, the gyral thickness of one over that of the other, against the
thickness of one over that of the other before growth. Even bodies of two seeds give the control: their widths differ
too, but the map has no part in it.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from morphofold.errors import MissingPart
from morphofold.geometry import unit
from morphofold.io import read_cortex, write_annotation, write_label, write_morph, write_surface
from morphofold.progress_callbacks import Progress
from morphofold.shapes import even_directions
from morphofold.sim.hemisphere.subject_maps import thickness_factor
from morphofold.sim.run import Simulation
from morphofold.sim.scene.geometries import path_or_sample
from morphofold.spheres.spins import rotations
from morphofold.studies.person import BODY_SETTINGS
from morphofold.studies.person.equal_area_parcels import N_PARCELS, Widths, gyral_widths, parcel_means, parcel_of
from morphofold.studies.person.slope_intervals import Slope, paired_slope, spin_p
from morphofold.studies.runs import Runs
from morphofold.surface import Surface

SCENE = "hemisphere"
SETTINGS = ("geometry.unfold=0.06", *BODY_SETTINGS, "growth.final=1.8", "output.stages=[]", "output.volume=false")
WITH_MAP = "geometry.thickness_map={file='thickness'}"
KIND_SETTINGS = {"even": (), "map": (WITH_MAP,)}
N_SPINS, N_POINTS = 2000, 5000


class Hemisphere(NamedTuple):
    """A hemisphere of a subject: ``folder`` is a path or a sample."""

    subject: str
    folder: str
    hemi: str

    @property
    def name(self) -> str:
        return f"{self.subject}-{self.hemi}"


def hemispheres(subjects: Sequence[str]) -> list[Hemisphere]:
    """Left and right hemispheres of subjects with a white surface and a thickness; raises if one has neither."""
    hemisphere_list = []
    for subject in subjects:
        subject_path = path_or_sample(subject)
        hemis = [
            hemi
            for hemi in ("lh", "rh")
            if all((subject_path / "surf" / f"{hemi}.{name}").is_file() for name in ("white", "thickness"))
        ]
        if not hemis:
            raise MissingPart(
                f"{subject}: has no hemisphere with surf/?h.white and surf/?h.thickness. Name a FreeSurfer subject."
            )
        hemisphere_list += [Hemisphere(Path(subject).resolve().name, subject, hemi) for hemi in hemis]
    return hemisphere_list


def grow_pair(hemisphere: Hemisphere, seed: int, runs: Runs) -> dict[str, Simulation]:
    """The body with an even cortex and the one with the map."""
    pair_settings = (
        *SETTINGS,
        f"geometry.subject={hemisphere.folder}",
        f"geometry.hemi={hemisphere.hemi}",
        f"effects.perturbation.seed={seed}",
    )
    return {
        kind: runs.grow(f"{hemisphere.name}-{kind}-seed{seed}", SCENE, [*pair_settings, *kind_settings])
        for kind, kind_settings in KIND_SETTINGS.items()
    }


def pair_rows(hemisphere: Hemisphere, seed: int, runs: Runs) -> list[dict[str, Any]]:
    """One row per parcel: gyral thickness of both bodies [mm], and the thickness factor of the map before growth."""
    simulation_of_kind = grow_pair(hemisphere, seed, runs)
    widths_of_kind: dict[str, Widths] = {}
    for kind, simulation in simulation_of_kind.items():
        work_label = f"gyral thickness of {simulation.path.name}"
        widths_of_kind[kind] = runs.once(work_label, partial(_widths, simulation))
    (parcel_factors,) = thickness_factors(simulation_of_kind["map"])
    return [
        {
            "subject": hemisphere.subject,
            "hemi": hemisphere.hemi,
            "seed": seed,
            "parcel": parcel,
            "thickness_factor": parcel_factors[parcel],
            "width_even_mm": widths_of_kind["even"].of_parcel[parcel],
            "width_map_mm": widths_of_kind["map"].of_parcel[parcel],
        }
        for parcel in range(N_PARCELS)
    ]


def _widths(simulation: Simulation, progress: Progress) -> Widths:
    return gyral_widths(simulation.cortex())


def thickness_factors(simulation: Simulation, rotation_list: Sequence[np.ndarray] = (np.eye(3),)) -> np.ndarray:
    """Mean thickness of each parcel before growth over that of the body, (rotations, N_PARCELS), the map rotated first.

    Parcels have the same weights for all rotations: even places on the sphere, where the body is cortex.
    """
    cortex, geometry = simulation.cortex(), simulation.scene.geometry
    assert cortex.sphere is not None
    directions = even_directions(N_POINTS)
    if cortex.cortex is not None:
        directions = directions[cortex.cortex[cKDTree(unit(cortex.sphere.verts)).query(directions)[1]]]
    factor_at = thickness_factor(geometry.thickness_map, geometry)  # type: ignore[union-attr, arg-type]
    parcel_index, weights = parcel_of(directions), np.ones(len(directions))
    rotated_points = (np.ascontiguousarray(directions @ rotation.T) for rotation in rotation_list)
    return np.array([parcel_means(factor_at(points), parcel_index, weights) for points in rotated_points])


def slope_rows(
    hemisphere: Hemisphere, seeds: Sequence[int], parcel_rows: Sequence[dict[str, Any]], runs: Runs
) -> list[dict[str, Any]]:
    """Slopes of log width on log thickness: of each seed's pair, of each control, and of the means over seeds."""

    def column(name: str, seed: int) -> np.ndarray:
        return np.array([row[name] for row in parcel_rows if row["seed"] == seed], dtype=float)

    log_T = np.log(column("thickness_factor", seeds[0]))
    log_even, log_map = (np.log([column(f"width_{kind}_mm", seed) for seed in seeds]) for kind in KIND_SETTINGS)
    keys = {"subject": hemisphere.subject, "hemi": hemisphere.hemi}
    slopes = []
    for k, seed in enumerate(seeds):
        next_index = (k + 1) % len(seeds)
        slopes.append({**keys, "kind": "pair", "seed": seed, **paired_slope(log_T, log_map[k] - log_even[k])._asdict()})
        if next_index != k:
            control_slope = paired_slope(log_T, log_even[next_index] - log_even[k])
            slopes.append({**keys, "kind": "control", "seed": seed, **control_slope._asdict()})
    map_run = grow_pair(hemisphere, seeds[0], runs)["map"]
    spun_T = np.log(thickness_factors(map_run, list(rotations(N_SPINS, 0))))
    with np.errstate(all="ignore"):
        log_change = np.nanmean(log_map - log_even, axis=0)
    slope: Slope = paired_slope(log_T, log_change)
    slopes.append(
        {**keys, "kind": "mean of seeds", "seed": None, **slope._asdict(), "spin_p": spin_p(spun_T, log_change, slope)}
    )
    return slopes


def prepare(source: str, out: str) -> None:
    """Write what the experiment needs of a subject with white and pial surfaces only: label of the cortex, thickness.

    The medial wall is where white and pial nearly meet; the thickness is FreeSurfer's.
    """
    from morphofold.analysis import cortical_thickness
    from morphofold.mesh_quality.cortex_checks import wall_of_geometry
    from morphofold.unfolding.spheres import sphere_of

    for hemi in ("lh", "rh"):
        cortex, out_folder = read_cortex(source, hemi), Path(out)
        for subfolder in ("surf", "label"):
            (out_folder / subfolder).mkdir(parents=True, exist_ok=True)
        is_cortex = ~wall_of_geometry(cortex)
        sphere_verts = 100 * sphere_of(cortex.white).verts
        write_surface(out_folder / "surf" / f"{hemi}.white", cortex.white)
        write_surface(out_folder / "surf" / f"{hemi}.pial", cortex.pial)
        write_surface(out_folder / "surf" / f"{hemi}.sphere", Surface(sphere_verts, cortex.faces))
        write_morph(out_folder / "surf" / f"{hemi}.thickness", cortical_thickness(cortex.white, cortex.pial), nan=0.0)
        write_label(out_folder / "label" / f"{hemi}.cortex.label", is_cortex, cortex.white.verts)
        if cortex.regions is not None:
            write_annotation(out_folder / "label" / f"{hemi}.aparc.annot", cortex.regions)
