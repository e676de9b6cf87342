import json
import math

import numpy as np
import pytest
from made_simulations import harmonic, made_simulation

from morphofold import analysis
from morphofold.errors import DoesNotApply
from morphofold.shapes import even_directions, icosphere
from morphofold.sim import theory
from morphofold.studies.folds import fold_tables
from morphofold.surface import Cortex, Surface

pytestmark = pytest.mark.slow  # studies are not shipped: run them when they change

STAGES = ["output.stages=[1.0, 1.2, 1.5, 2.0]"]
RMS = {1.0: 0.0, 1.2: 0.19, 1.5: 0.21, 2.0: 2.0}


def waves(g, verts):
    """Degree 8 and order 4, on a sphere that grows."""
    return g - 1 + RMS[g] * harmonic(verts, 8, 4)


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """Waves whose rms grows; T = 2."""
    folder = tmp_path_factory.mktemp("folds") / "fig5"
    return fold_tables.fold_rows(made_simulation(folder, "fig5", STAGES, height=waves))


def test_a_row_per_stage_says_which_body_it_is_of(rows):
    assert [row["growth"] for row in rows] == [1.2, 1.5, 2.0]
    for row in rows:
        assert (row["scene"], row["thickness_mm"], row["mu_ratio"], row["law"]) == ("fig5", 2.0, 2.0, "isotropic")


def test_rms_degree_and_wavelength_are_those_of_the_waves(rows):
    for row in rows:
        assert row["height_rms_mm"] == pytest.approx(RMS[row["growth"]], rel=0.01)
    for row in rows[1:]:
        assert row["degree"] == pytest.approx(8, abs=0.05)
        assert row["wavelength_mm"] == pytest.approx(2 * math.pi * 50 / math.sqrt(72), rel=0.01)
        assert row["height_skewness"] == pytest.approx(0, abs=0.01)


def test_waves_have_as_many_gyri_as_they_have_peaks(rows):
    """cos(4 phi) P_8^4: between its zeros in latitude lie five bands, eight peaks and pits in each pair."""
    for row in rows[1:]:
        assert row["gyri"] == row["sulci"] == 20


def test_narrow_furrows_make_the_height_skew(tmp_path):
    """Seven of them, between which nothing stands out."""

    def furrows(g, verts):
        away = np.linalg.norm(verts[:, None] / 50 - even_directions(7), axis=2)
        return -10 * (g - 1) * np.exp(-8 * away**2).sum(axis=1)

    *_, row = fold_tables.fold_rows(made_simulation(tmp_path / "s", "fig5", STAGES, height=furrows))
    assert row["height_skewness"] < -1
    assert row["sulci"] == 7
    assert row["gyri"] < 7


def test_what_is_not_folded_has_no_folds_and_says_so(rows):
    first, second, _ = rows
    assert first["note"].startswith("not folded: height rms 0.19 mm is below 0.1 T")
    assert {first[name] for name in ("sulci", "gyri", "degree", "wavelength_mm", "gyral_thickness_mm")} == {None}
    assert first["gyrification_index"] == pytest.approx(1, abs=0.01)
    assert second["wavelength_mm"] is not None


def test_numbers_of_the_surface_are_those_of_the_measuring_room(rows, tmp_path):
    last = made_simulation(tmp_path / "s", "fig5", STAGES, height=waves).cortex(2.0)
    assert rows[-1]["gyrification_index"] == analysis.gyrification_index(last.pial.verts, last.faces)
    assert rows[-1]["cortical_thickness_mm"] == pytest.approx(3)
    across = analysis.gyral_thickness(last)
    assert rows[-1]["gyral_thickness_mm"] == across.median or rows[-1]["note"] == across.reason


def test_walls_touch_first_where_the_log_has_a_pair_or_a_node_at_a_plane(rows, tmp_path):
    def seen(name, *lines):
        log = [{"growth": g, "effects": effects} for g, effects in lines]
        made = made_simulation(tmp_path / name, "fig5", ["output.stages=[1.0, 1.1]", "growth.final=1.1"], log=log)
        return fold_tables.fold_rows(made)[0]["first_contact_g"]

    apart = {"contact": {"pairs": 0}, "symmetry": {"pressed": 0}}
    assert rows[0]["first_contact_g"] is None
    assert seen("free", (1.01, {}), (1.02, apart)) is None
    assert seen("pair", (1.01, apart), (1.02, {"contact": {"pairs": 2}}), (1.03, {"contact": {"pairs": 3}})) == 1.02
    assert seen("plane", (1.01, apart), (1.04, {**apart, "symmetry": {"pressed": 1}})) == 1.04


def test_theory_stands_beside_at_the_compressibility_of_the_scene(rows):
    found = theory.bifurcation(2 / 50, 2.0, "isotropic", 50.0)
    for row in rows:
        assert row["theory_g"] == found.g_crit
        assert row["theory_degree"] == found.mode
        assert row["theory_wavelength_mm"] == pytest.approx(50 * found.wavelength)
        assert row["film_wavelength_mm"] == pytest.approx(2 * math.pi * 2 * (2 / 3) ** (1 / 3))


def test_theory_is_of_a_body_with_the_hole_of_the_scene(rows, tmp_path):
    settings = ["output.stages=[1.0, 1.1]", "growth.final=1.1", "geometry.hole_radius=46"]
    (row,) = fold_tables.fold_rows(made_simulation(tmp_path / "s", "fig5", settings))
    found = theory.bifurcation(2 / 50, 2.0, "isotropic", 50.0, A_over_C=46 / 50)
    assert row["theory_g"] == found.g_crit != rows[0]["theory_g"]
    assert row["theory_degree"] == found.mode


@pytest.fixture(scope="module")
def egg():
    """Height 2 P_2(cos) on meshes as even as can be, and with three times finer triangles around one pole."""

    def measured(offset):
        verts, faces = icosphere(4)
        verts = verts + [0.0, 0.0, offset]
        direction = verts / np.linalg.norm(verts, axis=1, keepdims=True)
        pial = direction * (50 + 3 * direction[:, 2:] ** 2 - 1)
        sphere, egg = (
            Cortex(
                Surface(0.96 * at, faces),
                Surface(at, faces),
                maps={"thickness": np.full(len(at), 2.0)},
                info={"reference_thickness": 2.0, "health": {"crossings": 0, "deepest_crossing": 0.0}},
            )
            for at in (50 * direction, pial)
        )
        return fold_tables.measured(sphere, egg)

    return {offset: measured(offset) for offset in (0.0, 0.5)}


@pytest.mark.parametrize("offset", [0.0, 0.5])
def test_height_is_weighed_by_area_wherever_the_vertices_are(egg, offset):
    """The mean of P_2 over the sphere is 0, of its square 1/5, of its cube 2/35."""
    assert egg[offset]["height_rms_mm"] == pytest.approx(2 / 5**0.5, rel=0.01)
    assert egg[offset]["height_skewness"] == pytest.approx(2 / 35 * 5**1.5, rel=0.02)


def test_what_a_surface_does_not_have_is_null_in_strict_json(egg):
    row = egg[0.0]
    assert row["gyral_thickness_mm"] is None
    assert row["note"]
    assert json.loads(json.dumps(row, allow_nan=False)) == row


def test_every_column_is_explained_or_says_of_which_body_it_is(rows):
    body = {"scene", "level", "portion", "thickness_mm", "T_over_C", "mu_ratio", "kappa_ratio", "law", "growth"}
    assert set(rows[0]) - body - {"note", "deepest_crossing_edges"} == set(fold_tables.COLUMNS)


def test_a_body_that_is_no_sphere_is_refused(tmp_path):
    simulation = made_simulation(tmp_path / "s", "fig3", ["output.stages=[1.0, 1.5]", "growth.final=1.5"])
    with pytest.raises(DoesNotApply, match=r"fig3: .*\bradial\b"):
        fold_tables.fold_rows(simulation)
