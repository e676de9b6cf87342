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
from morphofold.studies.person import ONE_MODULUS
from morphofold.studies.person.equal_area_parcels import PARCELS, Widths, gyral_widths, parcel_means, parcel_of
from morphofold.studies.person.slope_intervals import Slope, paired_slope, spin_p
from morphofold.studies.runs import Runs
from morphofold.surface import Surface

SCENE = "hemisphere"
SETTINGS = ("geometry.unfold=0.06", *ONE_MODULUS, "growth.final=1.8", "output.stages=[]", "output.volume=false")
MAP = "geometry.thickness_map={file='thickness'}"
KINDS = {"even": (), "map": (MAP,)}
SPINS, PLACES = 2000, 5000


class Hemisphere(NamedTuple):
    """A hemisphere of a subject: ``folder`` is a path or a sample."""

    subject: str
    folder: str
    hemi: str

    @property
    def name(self) -> str:
        return f"{self.subject}-{self.hemi}"


def hemispheres(folders: Sequence[str]) -> list[Hemisphere]:
    """Left and right hemispheres of subjects with a white surface and a thickness; raises if one has neither."""
    result = []
    for folder in folders:
        path = path_or_sample(folder)
        sides = [
            hemi
            for hemi in ("lh", "rh")
            if all((path / "surf" / f"{hemi}.{name}").is_file() for name in ("white", "thickness"))
        ]
        if not sides:
            raise MissingPart(
                f"{folder}: has no hemisphere with surf/?h.white and surf/?h.thickness. Name a FreeSurfer subject."
            )
        result += [Hemisphere(Path(folder).resolve().name, folder, hemi) for hemi in sides]
    return result


def grow_pair(hemisphere: Hemisphere, seed: int, runs: Runs) -> dict[str, Simulation]:
    """The body with an even cortex and the one with the map."""
    settings = (
        *SETTINGS,
        f"geometry.subject={hemisphere.folder}",
        f"geometry.hemi={hemisphere.hemi}",
        f"effects.perturbation.seed={seed}",
    )
    return {
        kind: runs.grow(f"{hemisphere.name}-{kind}-seed{seed}", SCENE, [*settings, *more_settings])
        for kind, more_settings in KINDS.items()
    }


def pair_rows(hemisphere: Hemisphere, seed: int, runs: Runs) -> list[dict[str, Any]]:
    """One row per parcel: gyral thickness of both bodies [mm], and the thickness factor of the map before growth."""
    simulation_of_kind = grow_pair(hemisphere, seed, runs)
    widths: dict[str, Widths] = {}
    for kind, simulation in simulation_of_kind.items():
        name = f"gyral thickness of {simulation.path.name}"
        widths[kind] = runs.once(name, partial(_widths, simulation))
    (factors,) = thickness_factors(simulation_of_kind["map"])
    return [
        {
            "subject": hemisphere.subject,
            "hemi": hemisphere.hemi,
            "seed": seed,
            "parcel": k,
            "thickness_factor": factors[k],
            "width_even_mm": widths["even"].of_parcel[k],
            "width_map_mm": widths["map"].of_parcel[k],
        }
        for k in range(PARCELS)
    ]


def _widths(simulation: Simulation, show: Progress) -> Widths:
    return gyral_widths(simulation.cortex())


def thickness_factors(simulation: Simulation, turns: Sequence[np.ndarray] = (np.eye(3),)) -> np.ndarray:
    """Mean thickness of each parcel before growth over the mean of the body, (turns, PARCELS); the map is turned first.

    Parcels have the same weights for all turns: even places on the sphere, where the body is cortex.
    """
    cortex, geometry = simulation.cortex(), simulation.scene.geometry
    assert cortex.sphere is not None
    places = even_directions(PLACES)
    if cortex.cortex is not None:
        places = places[cortex.cortex[cKDTree(unit(cortex.sphere.verts)).query(places)[1]]]
    factor_at = thickness_factor(geometry.thickness_map, geometry)  # type: ignore[union-attr, arg-type]
    parcel, weights = parcel_of(places), np.ones(len(places))
    rotated_places = (np.ascontiguousarray(places @ turn.T) for turn in turns)
    return np.array([parcel_means(factor_at(points), parcel, weights) for points in rotated_places])


def slope_rows(
    hemisphere: Hemisphere, seeds: Sequence[int], rows: Sequence[dict[str, Any]], runs: Runs
) -> list[dict[str, Any]]:
    """Slopes of log width on log thickness: of each seed's pair, of each control, and of the means over seeds."""

    def column(name: str, seed: int) -> np.ndarray:
        return np.array([row[name] for row in rows if row["seed"] == seed], dtype=float)

    thickness = np.log(column("thickness_factor", seeds[0]))
    even, mapped = (np.log([column(f"width_{kind}_mm", seed) for seed in seeds]) for kind in KINDS)
    head = {"subject": hemisphere.subject, "hemi": hemisphere.hemi}
    slopes = []
    for k, seed in enumerate(seeds):
        next_seed = (k + 1) % len(seeds)
        slopes.append({**head, "kind": "pair", "seed": seed, **paired_slope(thickness, mapped[k] - even[k])._asdict()})
        if next_seed != k:
            control = paired_slope(thickness, even[next_seed] - even[k])
            slopes.append({**head, "kind": "control", "seed": seed, **control._asdict()})
    mapped_run = grow_pair(hemisphere, seeds[0], runs)["map"]
    spun = np.log(thickness_factors(mapped_run, list(rotations(SPINS, 0))))
    with np.errstate(all="ignore"):
        change = np.nanmean(mapped - even, axis=0)
    whole: Slope = paired_slope(thickness, change)
    slopes.append(
        {**head, "kind": "mean of seeds", "seed": None, **whole._asdict(), "spin_p": spin_p(spun, change, whole)}
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
        cortex, folder = read_cortex(source, hemi), Path(out)
        for name in ("surf", "label"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        mask = ~wall_of_geometry(cortex)
        points = 100 * sphere_of(cortex.white).verts
        write_surface(folder / "surf" / f"{hemi}.white", cortex.white)
        write_surface(folder / "surf" / f"{hemi}.pial", cortex.pial)
        write_surface(folder / "surf" / f"{hemi}.sphere", Surface(points, cortex.faces))
        write_morph(folder / "surf" / f"{hemi}.thickness", cortical_thickness(cortex.white, cortex.pial), nan=0.0)
        write_label(folder / "label" / f"{hemi}.cortex.label", mask, cortex.white.verts)
        if cortex.regions is not None:
            write_annotation(folder / "label" / f"{hemi}.aparc.annot", cortex.regions)
