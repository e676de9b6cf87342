"""Which vertices are cortex, by the first sign of the medial wall that there is, on fsaverage5 and on spheres."""

from dataclasses import replace

import numpy as np
import pytest

from morphofold import shapes
from morphofold.analysis import measure
from morphofold.analysis.notes import of_input
from morphofold.io import read_cortex, sample_path
from morphofold.mesh_quality.checks import cortex_label, cortex_mask, wall_of_geometry, wall_of_thickness
from morphofold.mesh_quality.repair import measurable
from morphofold.surface import Cortex, Surface

NOISE = 0.1  # mm, of every coordinate


@pytest.fixture(scope="module")
def average():
    return read_cortex(sample_path("fsaverage5"))


def closed(share, *, apart=0.0, level=4, **more):
    """Spheres of 47 and 50 mm, but ``apart`` [mm] on a polar cap with so large a share of the area."""
    verts, faces = shapes.icosphere(level)
    away = np.where(verts[:, 2] > 1 - 2 * share, 50.0 - apart, 47.0)
    white, pial = Surface(away[:, None] * verts, faces, "lh.white"), Surface(50 * verts, faces, "lh.pial")
    return Cortex(white, pial, **more)


def noisy(cortex, rng, size=NOISE):
    moved = {
        name: replace(s, verts=s.verts + rng.normal(0, size, s.verts.shape))
        for name, s in (("white", cortex.white), ("pial", cortex.pial))
    }
    return replace(cortex, **moved)


def dice(one, other):
    return 2 * np.sum(one & other) / (one.sum() + other.sum())


def test_the_first_sign_that_there_is_says_where_cortex_is(average):
    words, cortex = [], average
    for missing in ({}, {"cortex": None}, {"regions": None}, {"maps": {}}):
        cortex = replace(cortex, **missing)
        label, word = cortex_label(cortex)
        words.append(word)
        assert not label.all()
        assert ("cortex_mask" in of_input(cortex)) == (word != "label")
    assert words == ["label", "annotation", "thickness", "geometry"]


@pytest.mark.parametrize("hemi", ["rh"])
def test_the_label_of_the_template_comes_over_by_the_registered_sphere(hemi):
    """fsaverage5 gets its own label back, and a coarser mesh of the same sphere the label of its vertices."""
    cortex = read_cortex(sample_path("fsaverage5"), hemi)
    bare = replace(cortex, cortex=None, regions=None, registered=cortex.sphere)
    label, word = cortex_label(bare)
    assert word == "template"
    assert np.array_equal(label, cortex.cortex)
    assert "cortex_mask" in of_input(bare)
    one, other = measurable(bare), measurable(cortex)
    assert np.array_equal(cortex_mask(one.cortex), cortex_mask(other.cortex))
    assert cortex_label(one.cortex)[1] == "template"


def test_a_sphere_registered_to_another_template_carries_no_label(average):
    turned = replace(average.sphere, verts=average.sphere.verts @ np.diag([-1.0, -1.0, 1.0]))
    bare = replace(average, cortex=None, regions=None, maps={}, registered=turned)
    assert cortex_label(bare)[1] == "geometry"
    assert np.array_equal(cortex_label(bare)[0], ~wall_of_geometry(bare))


@pytest.mark.parametrize("hemi", ["lh", "rh"])
def test_the_wall_that_geometry_finds_lies_within_that_of_the_label(hemi):
    cortex = read_cortex(sample_path("fsaverage5"), hemi)
    wall = wall_of_geometry(cortex)
    assert wall[cortex.cortex].sum() < 0.01 * wall.sum()  # of rh one vertex, on the rim
    coincident = np.all(cortex.white.verts == cortex.pial.verts, axis=1)
    assert dice(wall, ~cortex.cortex) > 0.68 > 0.55 > dice(coincident, ~cortex.cortex)
    # the rest is the hippocampus and what is near it, where FreeSurfer's white and pial are millimetres apart


@pytest.mark.parametrize("size", [0.05, 0.2])
def test_noise_of_the_vertices_does_not_tear_the_wall(average, rng, size):
    bare = replace(average, cortex=None, regions=None, maps={})
    rough = noisy(bare, rng, size)
    assert not np.all(rough.white.verts == rough.pial.verts, axis=1).any()
    assert dice(wall_of_geometry(rough), wall_of_geometry(bare)) > 0.97
    assert not wall_of_geometry(rough)[average.cortex].any()


def test_thickness_holds_under_noise_as_the_mask_does(rng):
    name, cortices = "mean_cortical_thickness_mm", (closed(0.06), noisy(closed(0.06), rng))
    clean, rough = (measure(cortex, only=[name]).scalars[name] for cortex in cortices)
    assert clean == pytest.approx(3, rel=5e-3)  # to pial beyond the rim it is less
    assert rough == pytest.approx(clean, rel=0.02)  # -5 % where the wall counts as cortex


@pytest.mark.parametrize("unit", [1e-3, 25.4])
def test_the_wall_is_the_same_in_any_unit(average, unit):
    white, pial = (replace(s, verts=unit * s.verts) for s in (average.white, average.pial))
    assert np.array_equal(wall_of_geometry(replace(average, white=white, pial=pial)), wall_of_geometry(average))


@pytest.mark.parametrize(
    "cortex",
    [
        closed(0.0),
        closed(0.06, apart=1.5),
        closed(0.005, apart=0.1),
        closed(0.3, apart=0.1),
        closed(0.06, apart=0.1, origin="simulation"),
        replace(closed(0.0), white=replace(closed(0.0).white, verts=49.9 / 47 * closed(0.0).white.verts)),
    ],
    ids=["none", "half as thick", "too small", "too large", "simulated", "thin everywhere"],
)
def test_what_does_not_look_like_a_wall_is_cortex(cortex):
    label, word = cortex_label(cortex)
    assert word == ""
    assert label.all()


@pytest.mark.parametrize("origin", ["simulation", "files"])
def test_a_simulated_body_has_no_wall_even_as_mere_files(origin):
    cortex = replace(read_cortex(sample_path("simulated")), origin=origin, maps={})
    assert cortex_label(cortex)[1] == ""
    assert wall_of_geometry(cortex).sum() == 0


def test_a_patch_of_zeros_in_the_thickness_is_the_wall_and_scattered_zeros_are_not(rng):
    cortex = closed(0.0)
    patch, few = cortex.pial.verts[:, 2] > 44, rng.random(cortex.n_vertices) < 0.02
    for given in (0.0, np.nan):
        thickness = np.where(patch, given, 3.0)
        patched = replace(cortex, maps={"thickness": thickness})
        label, word = cortex_label(patched)
        assert word == "thickness"
        assert np.array_equal(~label, patch)
        gaps = replace(cortex, maps={"thickness": np.where(few, given, 3.0)})
        assert wall_of_thickness(gaps).sum() == 0
