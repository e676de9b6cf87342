"""The experiment of Fig. 8: slopes and their null, parcels, the pairs of bodies, its figure; no body is grown."""

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from morphofold.errors import MissingPart
from morphofold.geometry import unit
from morphofold.io import sample_path
from morphofold.shapes import even_directions, icosphere
from morphofold.sim.scene.scene_files import load_scene
from morphofold.spheres.spins import rotations
from morphofold.studies.markdown import health, read_rows
from morphofold.studies.paper.paper_figures import PARTS, WORDS, Image, read_tables
from morphofold.studies.paper.verdicts import VERDICTS
from morphofold.studies.person import ferret, meshes, pairs, parcels, person_figure
from morphofold.studies.person.slopes import interval, paired_slope, spin_p
from morphofold.surface import Cortex, Surface

pytestmark = pytest.mark.slow  # studies are not shipped: run them when they change

EXPONENT = 0.4


# --- slopes


def test_a_power_law_is_found_with_its_exponent():
    x = np.linspace(-0.3, 0.3, 20)
    found = paired_slope(x, EXPONENT * x + 0.1)
    assert found.slope == pytest.approx(EXPONENT)
    assert found.r == pytest.approx(1)
    assert found.n == 20


def test_parcels_without_a_value_do_not_count():
    x, y = np.linspace(0, 1, 10), np.linspace(0, 2, 10)
    y[3] = np.nan
    x[7] = np.nan
    assert paired_slope(x, y).n == 8
    assert paired_slope(x, y).slope == pytest.approx(2)
    assert np.isnan(paired_slope(x[:2], y[:2]).slope)


def test_the_bounds_over_runs_are_those_of_students_t():
    """Of 1, 2, 3: mean 2, standard error 1 / sqrt 3, t(0.975, 2) = 4.3027."""
    found = interval([1.0, 2.0, 3.0])
    assert found.high - found.mean == pytest.approx(4.3027 / 3**0.5, rel=1e-4)
    assert found.low == pytest.approx(2 * found.mean - found.high)
    assert np.isnan(interval([1.0]).low)


def field_of(coefficients, points):
    """A field of degree 2 with 6 coefficients."""
    x, y, z = points.T
    return np.column_stack([x, y, z, x * y, y * z, z * x]) @ coefficients


def test_rotations_call_about_one_in_twenty_unrelated_maps_significant(rng):
    """Regression would call a third of them so: parcels of smooth maps are not independent."""
    places, small, by_regression = even_directions(40), 0, 0
    turned = [places @ turn.T for turn in rotations(200, 1)]
    for _ in range(200):
        thickness, width = rng.standard_normal((2, 6))
        found = paired_slope(field_of(thickness, places), field_of(width, places))
        spun = np.array([field_of(thickness, points) for points in turned])
        small += spin_p(spun, field_of(width, places), found) <= 0.05
        by_regression += abs(found.slope) > 2.02 * found.standard_error
    assert 3 <= small <= 20  # of 200; 10 are expected, with a standard deviation of 3
    assert by_regression > 30


def test_a_map_that_makes_the_widths_is_found_by_rotations(rng):
    places, coefficients = even_directions(40), rng.standard_normal(6)
    thickness = field_of(coefficients, places)
    spun = np.array([field_of(coefficients, places @ turn.T) for turn in rotations(200, 0)])
    width = EXPONENT * thickness + 0.01 * rng.standard_normal(40)
    assert spin_p(spun, width, paired_slope(thickness, width)) < 0.02


# --- parcels


def test_parcels_cover_the_sphere_evenly():
    s, _ = icosphere(5)
    count = np.bincount(parcels.parcel_of(s), minlength=parcels.PARCELS)
    assert count.min() > 0.75 * count.mean()
    assert count.max() < 1.25 * count.mean()


def test_means_of_parcels_are_weighted():
    means = parcels.parcel_means(np.array([1.0, 3.0, 7.0]), np.array([0, 0, 2]), np.array([3.0, 1.0, 2.0]))
    assert means[0] == pytest.approx(1.5)
    assert np.isnan(means[1])
    assert means[2] == 7


# --- the experiment, with bodies whose widths are given


@dataclass
class Grown:
    """A simulation that was not grown."""

    path: Path
    scene: Any

    @property
    def health(self):
        return {"elements": 1, "steps": 2, "seconds": 3.0, "healthy": True, "warnings": []}

    def cortex(self, g=None):
        s, faces = icosphere(4)
        sphere = Surface(100 * s, faces)
        return Cortex(Surface(45 * s, faces), Surface(50 * s, faces), sphere=sphere, name=self.path.name)


class NoRuns:
    """Loads scenes instead of growing them."""

    draft = False

    def grow(self, name, scene, settings):
        return Grown(Path(name), load_scene(scene, settings))

    def once(self, words, work):
        return work(lambda share, text: None)


@pytest.fixture
def widths(monkeypatch):
    """Gyral widths: those of a seed, with the map times the thickness to the power of EXPONENT."""
    factors = {}
    for hemi in ("lh", "rh"):
        scene = load_scene("hemisphere", [*pairs.SETTINGS, pairs.MAP, f"geometry.hemi={hemi}"])
        (factors[hemi],) = pairs.thickness_factors(Grown(Path("map"), scene))

    def given(cortex):
        seed, factor = int(cortex.name[-1]), factors["rh" if "-rh-" in cortex.name else "lh"]
        even = 8 + np.random.default_rng(seed).uniform(-1, 1, parcels.PARCELS)
        return parcels.Widths(even * (factor**EXPONENT if "-map-" in cortex.name else 1), 8.0)

    monkeypatch.setattr(pairs, "gyral_widths", given)
    monkeypatch.setattr(pairs, "SPINS", 40)
    return factors


def test_pairs_differ_in_the_map_alone():
    grown = pairs.grow_pair(pairs.Hemisphere("fsaverage5", "fsaverage5", "rh"), 3, NoRuns())
    even, mapped = grown["even"].scene, grown["map"].scene
    assert even.geometry.thickness_map is None
    assert mapped.geometry.thickness_map.file == "thickness"
    assert mapped.model_copy(update={"geometry": even.geometry}) == even
    assert mapped.geometry.model_copy(update={"thickness_map": None}) == even.geometry
    assert even.effects["perturbation"].seed == 3
    assert even.geometry.hemi == "rh"


def test_hemispheres_are_those_with_a_white_surface_and_a_thickness():
    found = pairs.hemispheres(["fsaverage5", str(sample_path("fsaverage5"))])
    assert [one.name for one in found] == ["fsaverage5-lh", "fsaverage5-rh"] * 2
    for other in ("S1", "nobody"):
        with pytest.raises(MissingPart):
            pairs.hemispheres(["fsaverage5", other])


def test_the_experiment_finds_the_exponent_that_was_put_in_and_draws_it(widths, tmp_path):
    assert np.nanmin(widths["lh"]) < 0.9 < 1.1 < np.nanmax(widths["lh"])
    entry = person_figure.reproduce_pairs(tmp_path, NoRuns())
    assert {path.name for path in tmp_path.iterdir()} == set(entry["files"])
    rows = read_rows(tmp_path / "fig8-grown.tsv", WORDS)
    of_pairs = [row["slope"] for row in rows if row["kind"] == "pair"]
    assert len(of_pairs) == 2 * len(person_figure.SEEDS) + 1  # and one over all
    assert of_pairs == pytest.approx([EXPONENT] * len(of_pairs))
    control = [row for row in rows if row["kind"] == "control"]
    assert len(control) == 2 * len(person_figure.SEEDS) + 1
    means = [row for row in rows if row["kind"] == "mean of seeds"]
    assert [row["spin_p"] for row in means] == pytest.approx([1 / 41] * 2)
    tables = read_tables(tmp_path, entry["files"])
    assert f"{EXPONENT:.2f}" in VERDICTS["fig8-grown"](tables)
    image, table = PARTS["fig8-grown"](tables)
    assert isinstance(image, Image)
    assert len(table.rows) == 4


# --- ferret and meshes


def test_gyrification_is_area_over_hull_in_units_of_the_first_hull(tmp_path):
    import trimesh

    s, faces = icosphere(4)
    dented = s * (1 - 0.3 * (s[:, 2] > 0.9))[:, None]
    for name, verts in (("first", 2 * s), ("second", 3 * dented)):
        trimesh.Trimesh(verts, faces, process=False).export(tmp_path / f"{name}.off")
    rows = ferret.published([tmp_path / "first.off", tmp_path / "second.off"])
    assert rows[0]["area_over_first_hull"] == pytest.approx(1, abs=1e-6)
    assert rows[0]["gyrification_index"] == pytest.approx(1, abs=1e-6)
    assert rows[1]["gyrification_index"] > 1.02
    assert rows[1]["area_over_first_hull"] > 2.2


def test_heights_of_a_body_agree_with_themselves_on_a_finer_mesh_and_not_with_others():
    def body(level, waves):
        s, faces = icosphere(level)
        radius = 50 + 3 * np.sin(waves * s[:, 0]) * np.sin(waves * s[:, 1])
        pial = Surface(radius[:, None] * s, faces)
        return SimpleNamespace(pial=pial, faces=faces, sphere=Surface(100 * unit(s), faces), cortex=None)

    assert meshes.height_correlation(body(5, 9.0), body(6, 9.0)) > 0.98
    assert abs(meshes.height_correlation(body(5, 9.0), body(5, 13.0))) < 0.3


def test_of_many_simulations_a_page_lists_those_that_are_not_healthy():
    one = {"folder": "simulations/a", "level": "draft", "elements": 10, "steps": 20, "seconds": 1.0, "healthy": True}
    ill = {**one, "folder": "simulations/b", "healthy": False, "warnings": ["crossings 4 exceeds 0: refine the mesh"]}
    every = [{**one, "warnings": []}] * 13 + [ill]
    lines = health(every).splitlines()
    assert "14 simulations" in lines[0]
    assert "13 are healthy" in lines[0]
    assert [line for line in lines[1:] if line] == ["- `b`: crossings 4 exceeds 0"]
    assert len(health(every[:12]).splitlines()) == 12
