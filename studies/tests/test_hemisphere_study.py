"""The experiment of Fig. 8: slopes and their null, parcels, pairs of bodies, its figure; no body is grown."""

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from morphofold.errors import MissingPart
from morphofold.geometry import unit
from morphofold.io import sample_path
from morphofold.shapes import even_directions, icosphere
from morphofold.sim.scene.scene_files import load_scene
from morphofold.spheres.spins import rotations
from morphofold.studies.markdown import read_rows
from morphofold.studies.paper.figure_parts import PART_MAKERS, TEXT_COLUMNS, Image, read_tables
from morphofold.studies.paper.verdicts import VERDICT_MAKERS
from morphofold.studies.person import equal_area_parcels, ferret, meshes, thickness_pair_figure, thickness_pairs
from morphofold.studies.person.hemisphere_study import MESH_COLUMNS, SHOWN_THICKNESS, THICKNESSES, write_page
from morphofold.studies.person.slope_intervals import paired_slope, spin_p
from morphofold.surface import Cortex, Surface
from morphofold.tables import write_table

EXPONENT = 0.4

# slopes -------------------------------------------------------------------------------------------------------


def test_a_power_law_has_its_exponent_and_parcels_without_a_value_do_not_count():
    x = np.linspace(-0.3, 0.3, 20)
    y = EXPONENT * x + 0.1
    y[3] = x[7] = np.nan
    slope = paired_slope(x, y)
    assert (slope.slope, slope.r, slope.n) == (pytest.approx(EXPONENT), pytest.approx(1), 18)
    assert np.isnan(paired_slope(x[:2], y[:2]).slope)


def field_of(coefficients, points):
    """A field of degree 2 with 6 coefficients."""
    x, y, z = points.T
    return np.column_stack([x, y, z, x * y, y * z, z * x]) @ coefficients


def test_rotations_call_about_one_in_twenty_unrelated_maps_significant_and_a_related_one(rng):
    """Regression would call a third of them so: parcels of smooth maps are not independent."""
    centres, small, by_regression = even_directions(40), 0, 0
    rotated = [centres @ turn.T for turn in rotations(200, 1)]
    for _ in range(200):
        thickness, width = rng.standard_normal((2, 6))
        slope = paired_slope(field_of(thickness, centres), field_of(width, centres))
        spun = np.array([field_of(thickness, points) for points in rotated])
        small += spin_p(spun, field_of(width, centres), slope) <= 0.05
        by_regression += abs(slope.slope) > 2.02 * slope.standard_error
    assert 3 <= small <= 20  # of 200; 10 are expected, with a standard deviation of 3
    assert by_regression > 30
    width = EXPONENT * field_of(thickness, centres) + 0.01 * rng.standard_normal(40)
    assert spin_p(spun, width, paired_slope(field_of(thickness, centres), width)) < 0.02


def test_parcels_cover_the_sphere_evenly():
    count = np.bincount(equal_area_parcels.parcel_of(icosphere(5)[0]), minlength=equal_area_parcels.N_PARCELS)
    assert 0.75 * count.mean() < count.min() < count.max() < 1.25 * count.mean()


# the experiment, with bodies whose widths are given -----------------------------------------------------------


@dataclass
class Grown:
    """A simulation that was not run."""

    path: Path
    scene: Any
    health = {"elements": 1, "steps": 2, "seconds": 3.0, "healthy": True, "warnings": []}

    def cortex(self, g=None):
        s, faces = icosphere(4)
        sphere = Surface(100 * s, faces)
        return Cortex(Surface(45 * s, faces), Surface(50 * s, faces), sphere=sphere, name=self.path.name)


class NoRuns:
    """Loads scenes instead of growing them."""

    draft = False

    def grow(self, name, scene, settings):
        return Grown(Path(name), load_scene(scene, settings))

    def once(self, label, work):
        return work(lambda fraction, text: None)


@pytest.fixture
def widths(monkeypatch):
    """Gyral widths: those of a seed, with the map times the thickness to the power of EXPONENT."""
    factors = {}
    for hemi in ("lh", "rh"):
        scene = load_scene("hemisphere", [*thickness_pairs.SETTINGS, thickness_pairs.WITH_MAP, f"geometry.hemi={hemi}"])
        (factors[hemi],) = thickness_pairs.thickness_factors(Grown(Path("map"), scene))

    def made_widths(cortex):
        seed, factor = int(cortex.name[-1]), factors["rh" if "-rh-" in cortex.name else "lh"]
        even = 8 + np.random.default_rng(seed).uniform(-1, 1, equal_area_parcels.N_PARCELS)
        return equal_area_parcels.Widths(even * (factor**EXPONENT if "-map-" in cortex.name else 1), 8.0)

    monkeypatch.setattr(thickness_pairs, "gyral_widths", made_widths)
    monkeypatch.setattr(thickness_pairs, "N_SPINS", 40)
    return factors


def test_pairs_differ_in_the_map_alone():
    pair = thickness_pairs.grow_pair(thickness_pairs.Hemisphere("fsaverage5", "fsaverage5", "rh"), 3, NoRuns())
    even, mapped = pair["even"].scene, pair["map"].scene
    assert even.geometry.thickness_map is None
    assert mapped.geometry.thickness_map.file == "thickness"
    assert mapped.model_copy(update={"geometry": even.geometry}) == even
    assert mapped.geometry.model_copy(update={"thickness_map": None}) == even.geometry
    assert (even.effects["perturbation"].seed, even.geometry.hemi) == (3, "rh")


def test_hemispheres_are_those_with_a_white_surface_and_a_thickness():
    hemispheres = thickness_pairs.hemispheres(["fsaverage5", str(sample_path("fsaverage5"))])
    assert [hemisphere.name for hemisphere in hemispheres] == ["fsaverage5-lh", "fsaverage5-rh"] * 2
    for other in ("S1", "nobody"):
        with pytest.raises(MissingPart):
            thickness_pairs.hemispheres(["fsaverage5", other])


@pytest.mark.slow
def test_the_experiment_recovers_the_exponent_that_was_put_in_and_draws_it(widths, tmp_path):
    assert np.nanmin(widths["lh"]) < 0.9 < 1.1 < np.nanmax(widths["lh"])
    entry = thickness_pair_figure.reproduce_pairs(tmp_path, NoRuns())
    assert {path.name for path in tmp_path.iterdir()} == set(entry["files"])
    slopes = {}
    for row in read_rows(tmp_path / "fig8-grown.tsv", TEXT_COLUMNS):
        slopes.setdefault(row["kind"], []).append(row)
    n = 2 * len(thickness_pair_figure.SEEDS) + 1  # and one over all
    assert [row["slope"] for row in slopes["pair"]] == pytest.approx(n * [EXPONENT])
    assert len(slopes["control"]) == n
    assert [row["spin_p"] for row in slopes["mean of seeds"]] == pytest.approx([1 / 41] * 2)
    tables = read_tables(tmp_path, entry["files"])
    assert f"{EXPONENT:.2f}" in VERDICT_MAKERS["fig8-grown"](tables)
    image, table = PART_MAKERS["fig8-grown"](tables)
    assert isinstance(image, Image)
    assert len(table.rows) == 4


# ferret and meshes --------------------------------------------------------------------------------------------


def test_gyrification_is_area_over_hull_in_units_of_the_first_hull(tmp_path):
    s, faces = icosphere(4)
    dented = s * (1 - 0.3 * (s[:, 2] > 0.9))[:, None]
    files = [tmp_path / "first.off", tmp_path / "second.off"]
    for file, verts in zip(files, (2 * s, 3 * dented)):
        trimesh.Trimesh(verts, faces, process=False).export(file)
    first, second = ferret.published_rows(files)
    assert (first["area_over_first_hull"], first["gyrification_index"]) == pytest.approx((1, 1), abs=1e-6)
    assert second["gyrification_index"] > 1.02
    assert second["area_over_first_hull"] > 2.2


def test_heights_of_a_body_agree_with_themselves_on_a_finer_mesh_and_not_with_others():
    def body(level, waves):
        s, faces = icosphere(level)
        radius = 50 + 3 * np.sin(waves * s[:, 0]) * np.sin(waves * s[:, 1])
        pial = Surface(radius[:, None] * s, faces)
        return SimpleNamespace(pial=pial, faces=faces, sphere=Surface(100 * unit(s), faces), cortex=None)

    assert meshes.height_correlation(body(5, 9.0), body(6, 9.0)) > 0.98
    assert abs(meshes.height_correlation(body(5, 9.0), body(5, 13.0))) < 0.3


def test_the_page_has_the_meshes_of_one_thickness_and_the_table_beside_it_all(tmp_path):
    columns = [column for column, _ in MESH_COLUMNS.values()]
    rows = [
        {**dict.fromkeys(columns, 1.0), "thickness_mm": T, "level": level}
        for T in THICKNESSES
        for level in ("draft", "fine")
    ]
    write_table(tmp_path / "meshes.tsv", columns, rows)
    page = tmp_path / "person.md"
    page.write_text("<!-- meshes -->\n<!-- /meshes -->\n")
    write_page(tmp_path, page)
    text, beside = page.read_text("utf-8"), (tmp_path / "person-meshes.tsv").read_text("utf-8").splitlines()
    assert [text.count(f"| {T:g} | draft | 1 |") for T in THICKNESSES] == [T == SHOWN_THICKNESS for T in THICKNESSES]
    assert beside[0].split("\t") == list(MESH_COLUMNS)
    assert [line.split("\t")[:2] for line in beside[1::2]] == [[f"{T:g}", "draft"] for T in THICKNESSES]
    assert "All 6 rows: [person-meshes.tsv](person-meshes.tsv)." in text
