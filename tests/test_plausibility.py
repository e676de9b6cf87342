"""Remarks on what is hardly the cortex that it is said to be: size, side, pair, label, thickness."""

import re
from dataclasses import replace

import numpy as np
import pytest
from commands import refused

from morphofold import shapes
from morphofold.analysis import measure
from morphofold.errors import UnlikeSurfaces
from morphofold.io import read_cortex, sample_path, write_surface
from morphofold.mesh_quality import cortex_checks, defects
from morphofold.mesh_quality.cortex_checks import check_pair, cortex_mask
from morphofold.note_texts import verdict
from morphofold.surface import Cortex, Surface

OWN = {"size", "side", "pair", "cortex_label", "thickness_cap", "thickness_unlike"}


@pytest.fixture(scope="module")
def average():
    return read_cortex(sample_path("fsaverage5"))


@pytest.fixture(scope="module")
def person():
    return read_cortex(sample_path("S1"))


def moved(cortex, move, which=("white", "pial")):
    return replace(cortex, **{name: replace(s, verts=move(s.verts)) for name in which if (s := getattr(cortex, name))})


def remark_keys(cortex):
    return OWN & (defects.input_remarks(cortex).keys() | defects.remarks(cortex, cortex_mask(cortex)).keys())


def rotation(degrees):
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


@pytest.mark.parametrize("name", ["fsaverage5", "S1", "simulated"])
@pytest.mark.parametrize("size", [0.1, 1.0])
def test_nothing_is_said_of_people_averages_models_and_smaller_animals(name, size):
    assert remark_keys(moved(read_cortex(sample_path(name)), lambda v: size * v)) == set()


@pytest.mark.parametrize("times", [2, 12])
def test_a_hemisphere_larger_than_a_persons_is_told_and_a_simulated_one_is_not(person, times):
    large = moved(person, lambda v: times * v)
    assert remark_keys(large) == {"size"}
    area = float(re.search(r"([\d,]+) cm\^2", defects.input_remarks(large)["size"])[1].replace(",", ""))
    assert area == pytest.approx(914.7 * times**2, rel=1e-3)
    assert defects.input_remarks(replace(large, origin="simulation")) == {}


def test_a_right_hemisphere_that_is_called_left_is_told(average):
    right = read_cortex(sample_path("fsaverage5"), "rh")
    assert remark_keys(replace(right, hemi="lh")) == {"side"} == remark_keys(replace(average, hemi="rh"))
    assert remark_keys(right) == set()
    assert remark_keys(moved(average, lambda v: v + [500, 0, 0])) == set()  # a frame that says nothing of sides


@pytest.mark.parametrize("labelled", [True, False])
@pytest.mark.parametrize(
    "move", [lambda v: v + [3, 0, 0], lambda v: (v - v.mean(0)) @ rotation(3).T + v.mean(0)], ids=["shifted", "turned"]
)
def test_white_and_pial_that_do_not_belong_together_are_told(average, labelled, move):
    cortex = average if labelled else replace(average, cortex=None, regions=None, maps={})
    assert remark_keys(cortex) == set()
    assert remark_keys(moved(cortex, move, ["pial"])) == {"pair"}


@pytest.mark.parametrize("shift", [(2, 0, 0), (0, 0, -2)])
def test_a_shift_of_two_millimetres_is_told(average, person, shift):
    for cortex in (average, person):
        assert remark_keys(moved(cortex, lambda v: v + shift, ["pial"])) == {"pair"}


def test_the_shift_of_pial_is_found_and_an_uneven_thickness_is_none(average):
    shifted = moved(average, lambda v: v + [1, 2, -3], ["pial"])
    moves = [cortex_checks.shift(c, cortex_mask(average)) for c in (average, shifted)]
    np.testing.assert_allclose(moves[1] - moves[0], [1, 2, -3], atol=0.05)
    verts, faces = shapes.icosphere(4)
    thick = Cortex(Surface(40 * verts, faces), Surface((45 + 4 * verts[:, :1]) * verts, faces))
    assert np.linalg.norm(cortex_checks.shift(thick, np.ones(len(verts), dtype=bool))) < 0.05 * 5


def test_one_surface_given_twice_is_refused_whatever_its_rounding(average):
    for gap in (1e-6, 1e-3):
        pial = replace(average.white, verts=(1 + gap / 70) * average.white.verts)
        with pytest.raises(UnlikeSurfaces, match=r"\(lh\.white\).*\(lh\.white\)"):
            check_pair(replace(average, pial=pial))
    check_pair(average)


@pytest.mark.parametrize("size", [0, 10])
def test_a_cortex_label_of_a_few_vertices_is_refused_by_its_file(cwd, capsys, size):
    sphere, faces = shapes.icosphere(4)
    for folder in ("surf", "label"):
        (cwd / "bert" / folder).mkdir(parents=True)
    for name, radius in (("white", 47.0), ("pial", 50.0)):
        write_surface(cwd / f"bert/surf/lh.{name}", Surface(radius * sphere, faces))
    rows = "".join(f"{vertex} 0 0 0 0\n" for vertex in range(size))
    (cwd / "bert/label/lh.cortex.label").write_text(f"#!ascii label\n{size}\n{rows}")
    refused(capsys, ["analyze", "bert", "-q", "--no-report"], "lh.cortex.label: ", f" {size} of 2562 ", "[no-cortex]")
    assert [path.name for path in cwd.iterdir()] == ["bert"]


def test_an_inverted_label_is_told(average):
    assert "cortex_label" in remark_keys(replace(average, cortex=~average.cortex))
    assert cortex_mask(replace(average, cortex=~average.cortex)).any()


def shell(**more):
    """Spheres, the inner one off its middle: a cortex of 2 to 4 mm."""
    verts, faces = shapes.icosphere(3)
    return Cortex(Surface(47 * verts + [0, 0, 1.0], faces, "lh.white"), Surface(50 * verts, faces, "lh.pial"), **more)


def test_a_thickness_of_other_surfaces_or_units_is_told(rng):
    own = measure(shell()).maps["cortical_thickness"]
    for thickness, expected in ((own, False), (1.5 * own, False), (1e3 * own, True), (rng.permutation(own), True)):
        measures = measure(shell(maps={"thickness": thickness}), only=["cortical_thickness"])
        assert ("thickness_unlike" in measures.notes) == expected
    flat = measure(shell(maps={"thickness": np.full(len(own), 3.0)}))  # one number correlates with nothing
    assert "thickness_unlike" not in flat.notes


def test_a_cap_that_much_of_the_cortex_reaches_is_told():
    thickness = np.array([2.0] * 90 + [5.0] * 10)
    assert "10.0%" in defects.at_cap(thickness, 5.0)["thickness_cap"]
    assert defects.at_cap(np.where(np.arange(100) < 99, thickness[0], 5.0), 5.0) == {}
    assert defects.at_cap(thickness, None) == {}


# advice -----------------------------------------------------------------------------------------------------------


def test_advice_is_that_of_the_worst_warning_and_names_all_that_speak_against_use():
    assert verdict({}) == verdict({"crossing": "", "net": "", "n_hinges": ""}) == ("use", ())
    assert verdict({"self_crossing": "", "holes": "", "mesh": ""}) == ("check", ("mesh", "holes"))
    assert verdict({"mesh": "", "size": "", "crossing": "", "pair": ""}) == ("leave out", ("size", "pair", "mesh"))


@pytest.mark.parametrize(("holes", "codes"), [(110, set()), (111, {"holes"})])
def test_many_repaired_holes_are_noted(person, holes, codes):
    assert defects.input_remarks(replace(person, info={**person.info, "surface_holes": holes})).keys() == codes


def tori(*centres, n=24):
    """Cortices of one torus for each centre: white in a tube of 3, pial in one of 4, around a circle of 10."""
    u, v = np.divmod(np.arange(n * n), n)
    right, up = (u + 1) % n * n + v, u * n + (v + 1) % n
    diagonal = (u + 1) % n * n + (v + 1) % n
    faces = np.vstack([np.column_stack([u * n + v, right, diagonal]), np.column_stack([u * n + v, diagonal, up])])
    u, v = 2 * np.pi * u / n, 2 * np.pi * v / n

    def tube(radius):
        ring = 10 + radius * np.cos(v)
        return np.column_stack([ring * np.cos(u), ring * np.sin(u), radius * np.sin(v)])

    all_faces = np.vstack([faces + k * n * n for k in range(len(centres))])
    surfaces = [np.vstack([tube(radius) + centre for centre in centres]) for radius in (3, 4)]
    return Cortex(*(Surface(verts, all_faces) for verts in surfaces), hemi="lh")


@pytest.mark.parametrize("n", [1, 2])
def test_handles_are_counted_in_each_piece(n):
    cortex = tori(*np.eye(3)[:n] * 100)
    assert f"has {n} handle" in defects.remarks(cortex, cortex_mask(cortex))["mesh"]
    whole = shapes.icosphere(3, 10.0)
    sphere = Cortex(Surface(0.9 * whole[0], whole[1]), Surface(*whole), hemi="lh")
    assert defects.remarks(sphere, cortex_mask(sphere)) == {}


@pytest.mark.parametrize(("noise", "codes"), [(0.0, set()), (1.0, {"self_crossing", "many_self_crossings"})])
def test_a_surface_that_crosses_itself_more_than_those_of_people_is_noted(noise, codes):
    verts, faces = shapes.icosphere(4, 10.0)
    shift = noise * np.random.default_rng(0).standard_normal(verts.shape)
    cortex = Cortex(Surface(0.9 * verts, faces), Surface(verts + shift, faces), hemi="lh")
    assert defects.self_crossings(cortex, np.ones(len(verts), dtype=bool))[0].keys() == codes


def test_surfaces_of_people_cross_themselves_as_often_as_usual(person):
    assert "many_self_crossings" not in defects.self_crossings(person, cortex_mask(person))[0]
