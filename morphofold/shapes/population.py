"""A made population: a template deformed by random smooth fields, with an effect of age planted in it."""

import math
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphofold.errors import OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.geometry import ratio
from morphofold.io import atomic_folder, read_surface, sample_path, write_surface
from morphofold.progress_callbacks import Progress, logged
from morphofold.surface import Surface
from morphofold.tables import write_table
from morphofold.threads import one_blas_thread

HEMIS = ("lh", "rh")
LABEL_FILES = ("cortex.label", "aparc.annot")
N_WAVES = 256  # in a random field
AGES = (20.0, 80.0)
MOST_SUBJECTS = 10_000  # 3 MB each
EFFECT_CENTRE = (-0.24, 0.25, 0.94)  # on the unit sphere of the left hemisphere: in the precentral gyrus


@dataclass(frozen=True)
class Population:
    """How the subjects of a made population differ.

    Attributes
    ----------
    thinning : float
        Cortical thickness that the left hemisphere loses in a year at the centre of the effect [mm]; 0: no effect.
    extent : float
        Standard deviation of the effect's Gaussian on the sphere [degrees].
    size : float
        Relative standard deviation of the length of each axis.
    bend, bend_length : float
        Standard deviation of the displacement of both surfaces [mm], and its correlation length [degrees].
    thickness, thickness_length : float
        Relative standard deviation of cortical thickness, and its correlation length [degrees].
    registration : float
        Standard deviation of the error of the registered sphere, in each direction [degrees].
    """

    thinning: float = 0.02
    extent: float = 12.0
    size: float = 0.04
    bend: float = 1.5
    bend_length: float = 25.0
    thickness: float = 0.05
    thickness_length: float = 10.0
    registration: float = 0.6

    def effect(self, points: Array, hemi: str) -> Array:
        """Change of cortical thickness in a year (N,) [mm] at points (N, 3) of the unit sphere."""
        centre = np.array(EFFECT_CENTRE) / np.linalg.norm(EFFECT_CENTRE)
        angle = np.degrees(np.arccos(np.clip(points @ centre, -1, 1)))
        change: Array = -self.thinning * (hemi == "lh") * np.exp(-((angle / self.extent) ** 2) / 2)
        return change


@one_blas_thread()
def random_field(points: Array, length: float, rng: np.random.Generator, n_fields: int = 1) -> Array:
    """Normal random fields (N, columns) of variance 1 at points (N, 3) of the unit sphere.

    Their covariance is exp(-d^2 / 2 length^2) of the distance d through the sphere: sums of waves with normal wave
    vectors (Rahimi, Recht 2007). They are functions of the place, so a mesh and its refinement have the same field.
    """
    waves = rng.standard_normal((N_WAVES, 3)) / length
    phases, amplitudes = rng.uniform(0, 2 * math.pi, N_WAVES), rng.standard_normal((N_WAVES, n_fields))
    field: Array = np.cos(points @ waves.T + phases) @ amplitudes * math.sqrt(2 / N_WAVES)
    return field


def write_population(
    out: str | Path, subjects: int = 30, *, seed: int = 0, like: Population = Population(), progress: Progress = logged
) -> Path:
    """Write a folder of made FreeSurfer subjects with ``participants.tsv``: age and sex at random.

    Parameters
    ----------
    out : str or path
        Folder to write, completely or not at all.
    subjects : int
    seed : int
    like : Population
        How they differ; by default as people roughly do, with a loss of thickness in the left precentral gyrus that is
        as fast as in a disease.
    progress : callable

    Raises
    ------
    OutOfRange
        If ``subjects`` is not 1 to 10,000, or the seed is negative.

    Notes
    -----
    Each subject is the template, stretched along its axes and bent by a smooth field; pial is moved along the line from
    white. So every subject has the template's folds: the differences between people's folding patterns are missing.
    """
    if not 1 <= subjects <= MOST_SUBJECTS:
        raise OutOfRange(f"a population has 1 to {MOST_SUBJECTS:,} subjects, got {subjects}.")
    if seed < 0:
        raise OutOfRange(f"the seed must not be negative, got {seed}.")
    sample_folder = sample_path("fsaverage5")
    meshes = {
        hemi: {kind: read_surface(sample_folder / "surf" / f"{hemi}.{kind}") for kind in ("white", "pial", "sphere")}
        for hemi in HEMIS
    }
    n_digits, rows = len(str(subjects)), []
    with atomic_folder(out) as folder:
        for k in range(subjects):
            rng = np.random.default_rng([seed, k])
            name = f"sub-{k + 1:0{max(n_digits, 2)}d}"
            age, sex = round(float(rng.uniform(*AGES)), 1), str(rng.choice(["F", "M"]))
            stretch = 1 + like.size * rng.standard_normal(3)
            surf_folder, label_folder = ((folder / name / kind) for kind in ("surf", "label"))
            surf_folder.mkdir(parents=True)
            label_folder.mkdir()
            for hemi in HEMIS:
                for kind, surface in _deformed(meshes[hemi], hemi, age - sum(AGES) / 2, stretch, like, rng).items():
                    write_surface(surf_folder / f"{hemi}.{kind}", surface)
                for kind in LABEL_FILES:
                    shutil.copyfile(sample_folder / "label" / f"{hemi}.{kind}", label_folder / f"{hemi}.{kind}")
            rows.append({"participant_id": name, "age": age, "sex": sex})
            progress((k + 1) / subjects, name)
        write_table(folder / "participants.tsv", ("participant_id", "age", "sex"), rows)
    return Path(out)


def _deformed(
    template: dict[str, Surface], hemi: str, years: float, stretch: Array, like: Population, rng: np.random.Generator
) -> dict[str, Surface]:
    """White, pial and registered sphere of one subject; ``years`` from the middle age."""
    white, pial, sphere = template["white"], template["pial"], template["sphere"]
    points = sphere.verts / np.linalg.norm(sphere.verts, axis=1, keepdims=True)
    thickness = np.linalg.norm(pial.verts - white.verts, axis=1)
    thickening = like.thickness * random_field(points, math.radians(like.thickness_length), rng)[:, 0]
    thickening += ratio(years * like.effect(points, hemi), thickness)
    displacement = like.bend * random_field(points, math.radians(like.bend_length), rng, 3)
    sphere_error = math.radians(like.registration) * random_field(points, math.radians(like.bend_length), rng, 3)
    registered = points + sphere_error
    radii = np.linalg.norm(registered, axis=1, keepdims=True)
    registered *= np.linalg.norm(sphere.verts, axis=1, keepdims=True) / radii
    pial_verts = white.verts + np.maximum(1 + thickening, 0.0)[:, None] * (pial.verts - white.verts)
    return {
        "white": Surface(white.verts * stretch + displacement, white.faces),
        "pial": Surface(pial_verts * stretch + displacement, white.faces),
        "sphere.reg": Surface(registered, white.faces),
    }
