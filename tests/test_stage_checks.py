import json
import re

import numpy as np
import pytest
from made_folds import joined, pressed_sphere

from morphofold.errors import InsideOut, OpenSurface
from morphofold.shapes import even_directions, icosphere
from morphofold.sim.effects.contact import GAP_IN_CELLS
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.stage_checks import (
    BOUNDS,
    CROSSING_TOLERANCE,
    LEAST_J,
    along_rays,
    bending,
    broken_bounds,
    check_surface,
    cover,
    cures,
    not_at_rest,
)
from morphofold.surface import Surface

SOUND = {
    "growth": 1.5,
    "lowest_J": 0.3,
    "kinetic_over_strain": 1e-3,
    "volume_drift": 0.01,
    "overlap": 0.0,
    "winding_max": 1,
    "crossings": 0,
    "deepest_crossing": 0.02,
    "mean_edge_mm": 1.5,
}
BEYOND = {name: bound + 1 if isinstance(bound, int) else 2 * bound for name, (bound, _) in BOUNDS.items()}

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
SQUARES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
CUBE_FACES = np.concatenate([SQUARES[:, [0, 1, 2]], SQUARES[:, [0, 2, 3]]])


def brute_force(verts, faces, direction):
    """Length of a ray from the origin inside the surface twice and at all, and the largest winding number."""
    a, b, c = (verts[faces[:, k]] for k in range(3))
    weights = np.stack([np.cross(b, c) @ direction, np.cross(c, a) @ direction, np.cross(a, b) @ direction])
    through = (weights > 0).all(axis=0) | (weights < 0).all(axis=0)
    total = weights[:, through].sum(axis=0)
    at = np.einsum("kf,kfi,i->f", weights[:, through], np.stack([a, b, c])[:, through], direction) / total
    outwards = np.sign(total)[at > 0]
    at = at[at > 0]
    order = np.argsort(-at)
    winding = np.cumsum(outwards[order])
    length = at[order] - np.append(at[order][1:], 0.0)
    return length[winding >= 2].sum(), length[winding >= 1].sum(), winding.max()


def test_a_sound_stage_breaks_no_bound():
    assert broken_bounds(SOUND) == []
    assert broken_bounds({**SOUND, "unstable_modes": None}) == []  # not measured
    assert broken_bounds({**SOUND, **{name: bound for name, (bound, _) in BOUNDS.items()}}) == []


@pytest.mark.parametrize("name", BOUNDS)
def test_each_bound_is_told_with_its_value_and_a_cure(name):
    sentences = broken_bounds({**SOUND, name: BEYOND[name]})
    assert len(sentences) == 1
    shown = BEYOND[name] if isinstance(BEYOND[name], int) else f"{BEYOND[name]:.2g}"
    assert re.match(
        rf"{name} {re.escape(str(shown))} .*\bg = 1\.50 .* {re.escape(f'{BOUNDS[name][0]:g}')}:", sentences[0]
    )
    assert all(cures()[key] in sentences[0] for key in BOUNDS[name][1])
    assert len(broken_bounds({**SOUND, name: float("nan")})) == 1


def test_stages_that_are_not_at_rest_are_told_and_others_are_not():
    stages = [{"growth": 1.5, "at_rest": at_rest, "distance_over_T": 0.3} for at_rest in (True, None)]
    assert not_at_rest([*stages, SOUND]) == []
    (text,) = not_at_rest([*stages, {"growth": 1.75, "at_rest": False, "distance_over_T": 0.4}])
    assert "1.75 (0.40 T)" in text
    assert "1.50" not in text


def test_a_cure_is_one_that_the_scene_takes():
    """No advice to add contact that is there, nor of accuracy for the mesh of a file, which refuses it."""
    deep = {**SOUND, "deepest_crossing": 0.5}
    contact, finer = cures()["contact"], cures()["finer"]
    assert contact in broken_bounds(deep)[0]
    (sentence,) = broken_bounds(deep, load_scene("fig5"))
    assert contact not in sentence
    assert finer in sentence
    (sentence,) = broken_bounds(deep, load_scene("mesh"))
    assert "accuracy" not in sentence
    assert "geometry.file" in sentence
    for name, cure in (("mesh", "held"), ("hemisphere", "effects.midline"), ("hemisphere-thick", "cortex_thickness")):
        (sentence,) = broken_bounds({**SOUND, "bending": 0.5}, load_scene(name))
        assert "portion" not in sentence
        assert cure in sentence
    (sentence,) = broken_bounds({**SOUND, "bending": 0.5}, load_scene("hemisphere", ["geometry.held=hole"]))
    assert "midline" not in sentence  # the surface has no medial wall


def test_the_barrier_at_corners_is_advised_where_contact_is_there_and_bricks_are():
    advice = lambda scene, *settings: " ".join(broken_bounds({**SOUND, "crossings": 3}, load_scene(scene, settings)))
    assert "corner_barrier" in advice("hemisphere")
    assert "corner_barrier" not in advice("hemisphere", "effects.corner_barrier={}")
    assert "corner_barrier" not in advice("mesh")


def test_bending_is_that_of_the_body_as_a_whole(rng):
    """Nothing of affine maps or of folds; a ball bent like a beam is as far off as its bow."""
    verts, _ = icosphere(5, radius=50.0)
    assert bending(verts, verts @ rng.standard_normal((3, 3)) + 7.0) < 1e-12
    folds = 5.0 * np.cos(0.3 * verts[:, [0]]) * np.cos(0.3 * verts[:, [1]]) * np.cos(0.3 * verts[:, [2]])
    assert bending(verts, verts * (1 + folds / 50)) < 0.01
    bow = 1 / 200.0  # curvature of what was the x axis [1/mm]
    bent = verts + np.outer(0.5 * bow * verts[:, 0] ** 2, [0.0, 0.0, 1.0])
    x2 = 50.0**2 * np.sqrt(4 / 45)  # spread of x^2 on the sphere: 1/5 - 1/9
    assert bending(verts, bent) == pytest.approx(0.5 * bow * x2 / 50, rel=0.03)


def test_a_crushed_element_is_told_even_if_it_recovered():
    assert broken_bounds({**SOUND, "lowest_J": 0.5 * LEAST_J})[0].startswith(f"lowest J {0.5 * LEAST_J:g} ")


def test_kinetic_energy_of_early_growth_is_held_against_the_strain_energy_to_come():
    assert broken_bounds({**SOUND, "growth": 1.02, "kinetic_over_strain": 0.5}) == []
    assert len(broken_bounds({**SOUND, "growth": 1.3, "kinetic_over_strain": 0.5})) == 1


@pytest.mark.parametrize("scales", [(1.0,), (0.5, 1.0), (0.25, 0.5, 1.0), np.linspace(0.1, 1, 100)])
def test_bodies_in_one_another_are_covered_as_often_as_there_are_bodies(scales):
    verts, faces = icosphere(2, radius=10.0)
    inner = scales[-2] if len(scales) > 1 else 0.0  # this share of every ray is covered twice
    assert cover(joined(*(s * verts for s in scales), faces=faces), rays=50) == (pytest.approx(inner), len(scales))


@pytest.mark.parametrize(("hole", "island"), [(0.8, 0.4), (0.5, 0.5)])
def test_a_body_in_a_hole_overlaps_nothing_even_if_it_touches_its_wall(hole, island):
    verts, faces = icosphere(3, radius=10.0)
    shells = Surface(
        np.concatenate([verts, hole * verts, island * verts]),
        np.concatenate([faces, faces[:, ::-1] + len(verts), faces + 2 * len(verts)]),
    )
    assert cover(shells) == (0.0, 1)


@pytest.mark.parametrize("press", [0.0, 0.99, 1.4])
def test_rays_agree_with_brute_force(press):
    surface = pressed_sphere(4, press=press, irregular=True)
    directions = even_directions(500)
    centred = surface.verts - surface.verts.mean(axis=0)
    twice, once, most, _ = along_rays(centred, surface.faces, directions)
    expected = np.array([brute_force(centred, surface.faces, d) for d in directions])
    np.testing.assert_allclose(np.column_stack([twice, once, most]), expected, atol=1e-9)
    assert cover(surface, 500) == (pytest.approx(twice.sum() / once.sum()), 1 + (press > 1))
    assert (press > 1) == (twice.sum() > 0)


def test_rays_through_edges_and_vertices_lose_and_double_nothing():
    everywhere = [[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z]
    directions = np.array(everywhere, float)  # corners, edges and diagonals of the cube
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for faces in (CUBE_FACES, np.roll(CUBE_FACES, 1, axis=1), CUBE_FACES[::-1]):
        cubes = joined(CUBE, 2 * CUBE, faces=faces)
        twice, once, most, centre = along_rays(cubes.verts, cubes.faces, directions)
        assert (centre == 2).all()
        assert (most == 2).all()
        np.testing.assert_allclose(twice, 1 / np.abs(directions).max(axis=1))
        np.testing.assert_allclose(once, 2 * twice)


@pytest.mark.parametrize("aside", [0, 1])
def test_a_ray_within_a_face_or_along_an_edge_keeps_the_winding_number(aside):
    """A cube inside a larger one: a side of it, or an edge between two, points at the origin."""
    surface = joined(9 * CUBE, CUBE + [1, 3, aside], faces=CUBE_FACES)
    angle = np.arange(360) * np.pi / 180
    around = np.column_stack([0 * angle, np.cos(angle), np.sin(angle)])
    _, once, most, centre = along_rays(surface.verts, surface.faces, around)
    assert (centre == 1).all()
    assert set(most) <= {1, 2}
    np.testing.assert_allclose(once, 9 / np.abs(around).max(axis=1))


def test_a_surface_with_a_hole_or_turned_inside_out_is_refused():
    verts, faces = icosphere(3)
    with pytest.raises(OpenSurface, match=r"\b0 to 1\b"):
        cover(Surface(verts, faces[5:]))
    with pytest.raises(InsideOut, match=r"\b100\b"):
        cover(Surface(verts, faces[:, ::-1]), rays=100)


def test_the_check_of_a_sound_surface_breaks_no_bound():
    checked = check_surface(pressed_sphere(5, press=0.99))
    assert checked["mean_edge_mm"] == pytest.approx(0.39, abs=0.01)
    assert broken_bounds({**SOUND, **checked}) == []
    assert set(checked) == set(SOUND) - {"growth", "lowest_J", "kinetic_over_strain", "volume_drift"}
    assert json.loads(json.dumps(checked)) == checked  # plain numbers


@pytest.mark.parametrize("irregular", [False, True])
def test_the_check_of_a_surface_through_itself_breaks_every_bound_that_tells_it(irregular):
    checked = check_surface(pressed_sphere(5, press=1.4, irregular=irregular))
    assert checked["winding_max"] == 2
    assert checked["crossings"] > 4
    assert checked["deepest_crossing"] > CROSSING_TOLERANCE
    sentences = broken_bounds({**SOUND, **checked, "overlap": 0.0})
    assert [sentence.split()[0] for sentence in sentences] == ["winding_max", "crossings", "deepest_crossing"]


def test_a_crossing_that_counts_is_less_deep_than_the_gap_of_contact():
    assert 0.5 * GAP_IN_CELLS < CROSSING_TOLERANCE < GAP_IN_CELLS
