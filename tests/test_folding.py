"""Folding indices against exact integrals, Gauss-Bonnet, and copies of one surface on coarser meshes."""

import numpy as np
import pytest
from fast_simplification import simplify

from morphofold.analysis import folding_indices, vertex_areas
from morphofold.analysis.gyrification.folding import angle_defects
from morphofold.errors import OutOfRange
from morphofold.io import read_cortex, read_surface, sample_path
from morphofold.studies import shapes


def exact(shape):
    """Folding and intrinsic curvature index of the curvatures that a shape comes with."""
    areas = vertex_areas(shape.verts, shape.faces) / (4 * np.pi)
    large, small = (take(np.abs(shape.k1), np.abs(shape.k2)) for take in (np.maximum, np.minimum))
    return np.sum(large * (large - small) * areas), np.sum(np.maximum(shape.K, 0) * areas)


def indices_of(shape, scale):
    indices = folding_indices(shape.verts, shape.faces, scale)
    return indices.folding_index, indices.intrinsic_curvature_index


@pytest.mark.parametrize("seed", [pytest.param(None, marks=pytest.mark.slow), 1], ids=["regular", "irregular"])
def test_indices_of_a_bumpy_sphere_fall_from_the_exact_ones_with_the_square_of_the_scale(seed):
    shape = shapes.bumpy_sphere(6, rng=seed)
    scales = (2.0, 2.8, 4.0)
    off = np.array([1 - np.divide(indices_of(shape, scale), exact(shape)) for scale in scales])
    order = np.polyfit(np.log(scales), np.log(off), 1)[0]
    assert order == pytest.approx([2, 2], abs=0.35)
    assert np.abs(off[0]).max() < 0.05


def test_indices_of_a_sphere_and_a_torus_are_the_exact_integrals():
    assert indices_of(shapes.sphere(5), 5.0) == pytest.approx((0, 1), abs=0.01)
    ring = shapes.torus(240, 96, 40.0, 16.0)
    assert indices_of(ring, 1.5) == pytest.approx(exact(ring), rel=0.01)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_the_total_is_half_the_euler_characteristic_whatever_the_noise(noise, rng):
    for shape, half in ((shapes.bumpy_sphere(5, rng=rng), 1), (shapes.torus(rng=rng), 0)):
        rough = shapes.with_noise(shape, noise, rng=rng)
        assert angle_defects(rough.verts, rough.faces).sum() == pytest.approx(4 * np.pi * half, abs=1e-8)
        indices = folding_indices(rough.verts, rough.faces, 5.0)
        assert indices.total == pytest.approx(half, abs=2e-3)
        assert indices.total == indices.intrinsic_curvature_index + indices.negative_curvature_index


def test_noise_of_a_fiftieth_of_an_edge_moves_the_indices_by_less_than_a_percent_or_two():
    shape = shapes.bumpy_sphere(6, rng=1)
    rough = shapes.with_noise(shape, 0.02)
    assert indices_of(rough, 3.0) == pytest.approx(indices_of(shape, 3.0), rel=0.015)


def test_thinning_a_brain_to_half_its_vertices_hardly_moves_the_indices():
    """A fit within the same radius gains 10 % and more."""
    white = read_surface(sample_path("fsaverage5") / "surf" / "lh.white")
    scale = 6.0  # 1.5 edges of the thin one
    few = simplify(white.verts.astype(np.float32), white.faces.astype(np.int32), 0.5)
    one, other = (folding_indices(v, f, scale) for v, f in ((white.verts, white.faces), few))
    assert other.intrinsic_curvature_index == pytest.approx(one.intrinsic_curvature_index, rel=0.03)
    assert other.folding_index == pytest.approx(one.folding_index, rel=0.06)
    assert (one.total, other.total) == pytest.approx((1, 1), abs=0.02)


@pytest.mark.slow
def test_thinning_a_person_to_a_quarter_of_the_vertices_hardly_moves_the_indices():
    """At 3 mm, 1.7 edges of the thinnest."""
    white = read_cortex(sample_path("S1"), hemi="lh").white
    verts = (white.verts - white.verts.mean(axis=0)).astype(np.float32)
    one = folding_indices(white.verts, white.faces, 3.0)
    for vertices, least in ((80_000, 0.03), (40_000, 0.07)):
        other = folding_indices(*simplify(verts, white.faces.astype(np.int32), 1 - vertices / len(verts)), 3.0)
        assert other.intrinsic_curvature_index == pytest.approx(one.intrinsic_curvature_index, rel=0.03)
        assert other.folding_index == pytest.approx(one.folding_index, rel=least)
        assert other.total == pytest.approx(1, abs=0.02)


@pytest.mark.slow
def test_faces_of_32_bits_as_files_hold_them_are_those_of_64():
    """Keys of the edges of 163,842 vertices need more."""
    verts, faces = shapes.icosphere(7, 50.0)
    one, other = (folding_indices(verts, faces.astype(kind), 2.0) for kind in (np.int32, np.int64))
    assert one == other


def test_a_border_and_an_unused_vertex_have_no_defect():
    verts, faces = shapes.icosphere(3, 10.0)
    half = faces[(verts[faces, 2] >= 0).all(axis=1)]
    defect = angle_defects(np.concatenate([verts, [[50.0, 0, 0]]]), half)
    rim = np.abs(verts[:, 2]) < 1e-9
    assert (defect[:-1][rim] == 0).all()
    assert (defect[:-1][verts[:, 2] < 0] == 0).all()
    assert defect[-1] == 0
    assert np.isfinite(folding_indices(np.concatenate([verts, [[50.0, 0, 0]]]), half, 3.0).folding_index)


def test_a_scale_that_is_no_length_is_refused():
    with pytest.raises(OutOfRange, match=r"\bscale\b.* -1\.0\.$"):
        folding_indices(*shapes.icosphere(1), -1.0)
