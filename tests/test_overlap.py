"""Hinges and crests that the subjects of a study share."""

import json

import numpy as np
import pytest
from commands import refused
from made_spaces import FACES, RADIUS, VERTS, write_space

from morphofold.cli import main
from morphofold.errors import DoesNotApply
from morphofold.geometry import vertex_areas
from morphofold.group.overlap import COLUMNS, WHOLE, Landmarks, common, common_by_chance, overlap
from morphofold.group.spaces import find_space
from morphofold.io import read_morph
from morphofold.report.pictures.pixel_canvas import read_png
from morphofold.shapes import icosphere
from morphofold.tables import read_table
from morphofold.threads import using_threads

CORTEX, AREAS, UNIT = VERTS[:, 2] > -40, vertex_areas(VERTS, FACES), VERTS / RADIUS
SUBJECTS, HINGES, WIDTH = 6, 10, 8.0


def arcs(sources, targets):
    """Distances along the ball [mm] between vertices."""
    return RADIUS * np.arccos(np.clip(UNIT[sources] @ UNIT[targets].T, -1, 1))


def maps_of(hinges):
    """Maps of subjects with a hinge at vertices (S, H); a crest of 2 mm at each."""
    counts = np.array([np.bincount(vertices, minlength=len(VERTS)) for vertices in hinges], dtype=float)
    away = np.array([arcs(slice(None), vertices).min(axis=1) for vertices in hinges])
    areas = np.tile(AREAS, (len(hinges), 1))
    maps = {"hinges": counts, "crest_length": 2 * counts, "hinge_distance": away, "crest_distance": away, "area": areas}
    return {f"lh.{name}": values for name, values in maps.items()}


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """The folder and hinges of six subjects who share five hinges in the north; five more are anywhere."""
    random = np.random.default_rng(0)
    same = random.choice(np.flatnonzero(VERTS[:, 2] > 30), 5, replace=False)
    anywhere = [random.choice(np.flatnonzero(CORTEX), 5, replace=False) for _ in range(SUBJECTS)]
    hinges = [np.unique(np.r_[same, others]) for others in anywhere]
    study = tmp_path_factory.mktemp("shared") / "study"
    write_space(study, maps_of(hinges), graph_width_mm=WIDTH)
    return study, hinges


@pytest.fixture(scope="module")
def result(shared):
    """What they share, of hinges and of crests."""
    return overlap(find_space(shared[0]), hemis=["lh"], spins=99)


def scattered(folder, rng, subjects=SUBJECTS, without_graph=()):
    """A study whose subjects share no hinges."""
    maps = maps_of([rng.choice(np.flatnonzero(CORTEX), HINGES, replace=False) for _ in range(subjects)])
    for name in set(maps) - {"lh.area"}:
        maps[name][list(without_graph)] = np.nan
    write_space(folder, maps, graph_width_mm=WIDTH)
    return find_space(folder)


def row_of(kind, region=WHOLE):
    return next(row for row in kind.rows if row["region"] == region)


def test_the_share_is_that_of_all_pairs_counted_one_by_one(shared, result):
    hinges, crests = result
    assert hinges.radius == WIDTH / 2
    pairs = [(arcs(a, b) <= WIDTH / 2).any(axis=1).sum() for a in shared[1] for b in shared[1] if a is not b]
    total = sum(map(len, shared[1]))
    for kind in result:
        assert row_of(kind)["share"] == pytest.approx(sum(pairs) / (SUBJECTS - 1) / total, rel=1e-6)
    assert row_of(hinges)["amount"] == pytest.approx(total / SUBJECTS, rel=1e-6)
    assert row_of(crests)["amount"] == pytest.approx(2 * row_of(hinges)["amount"], rel=1e-6)
    regions = [row_of(hinges, region)["amount"] for region in ("north", "south")]
    assert sum(regions) == pytest.approx(row_of(hinges)["amount"])


def test_shared_hinges_stand_out_in_their_region(result):
    hinges, _ = result
    north, south = row_of(hinges, "north"), row_of(hinges, "south")
    assert north["p"] == pytest.approx(1 / 100)
    assert north["p_corrected"] <= 0.02
    assert south["p_corrected"] > 0.05
    assert north["chance_low"] < north["chance"] < north["chance_high"] < north["share"]


def test_densities_keep_the_number_of_hinges_and_chance_spreads_them_evenly(result):
    hinges, _ = result
    for density in (hinges.density["lh"], hinges.chance_density["lh"]):
        assert np.isnan(density[~CORTEX]).all()
        assert AREAS[CORTEX] @ density[CORTEX] / 100 == pytest.approx(row_of(hinges)["amount"], rel=0.05)
    assert np.nanstd(hinges.chance_density["lh"]) < 0.25 * np.nanmean(hinges.chance_density["lh"])
    assert VERTS[np.nanargmax(hinges.density["lh"]), 2] > 0


def test_subjects_who_share_nothing_and_one_without_a_gyral_graph(tmp_path, rng):
    hinges, _ = overlap(scattered(tmp_path / "study", rng, without_graph=[1]), hemis=["lh"], spins=49, seed=1)
    assert row_of(hinges)["p"] > 0.01
    assert row_of(hinges)["subjects"] == SUBJECTS - 1
    assert row_of(hinges)["amount"] == HINGES


def test_threads_do_not_change_the_numbers(shared, result):
    with using_threads(1):
        alone = overlap(find_space(shared[0]), hemis=["lh"], spins=99)
    assert [kind.rows for kind in alone] == [kind.rows for kind in result]


def test_one_side_a_single_subject_an_unknown_width_and_wrong_numbers_are_refused(shared, tmp_path, rng):
    study = find_space(shared[0])
    with pytest.raises(DoesNotApply, match="--hemi"):
        overlap(study, spins=5)
    with pytest.raises(DoesNotApply):
        overlap(scattered(tmp_path / "one", rng, 1), hemis=["lh"])
    write_space(tmp_path / "two", maps_of(shared[1][:2]))
    with pytest.raises(DoesNotApply):
        overlap(find_space(tmp_path / "two"), hemis=["lh"])
    for options in ({"radius": np.nan}, {"radius": -1.0}, {"fwhm": np.inf}, {"spins": 0}, {"seed": -1}):
        with pytest.raises(ValueError):
            overlap(study, hemis=["lh"], **options)


def test_the_command_writes_table_maps_and_page(shared, tmp_path, capsys):
    out = tmp_path / "shared"
    argv = ["overlap", str(shared[0]), "--hemi", "lh", "--rotations", "9", "-o", str(out), "-q"]
    assert main([*argv, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["radius_mm"], summary["rotations"]) == (WIDTH / 2, 9)
    rows = read_table(out / "overlap.tsv", text_columns=("hemi", "kind", "region"))
    assert tuple(rows[0]) == COLUMNS
    assert [row["region"] for row in rows] == 2 * ["south", "north", WHOLE]
    for name in ("hinge_density", "crest_density"):
        assert np.nanmax(read_morph(out / "maps" / f"lh.{name}_chance.shape.gii")) > 0
        assert read_png(out / "figures" / f"{name}.png").any()
    assert "<svg" in (out / "report.html").read_text()
    assert main([*argv, "--no-report"]) == 0
    assert not (out / "report.html").exists()


def test_a_study_without_hinges_on_the_template_is_refused_and_nothing_is_written(tmp_path, capsys):
    write_space(tmp_path / "study", {"lh.H": np.zeros((3, len(VERTS)))}, graph_width_mm=WIDTH)
    out = tmp_path / "shared"
    refused(capsys, ["overlap", str(tmp_path / "study"), "--hemi", "lh", "-o", str(out)], "hinges")
    assert not out.exists()


# chance ------------------------------------------------------------------------------------------------------

POINTS = icosphere(4)[0]
ON_SPHERE = vertex_areas(*icosphere(4))
POLE = np.array([[0.0, 0.0, 1.0]])


def landmarks(directions, radius, areas=ON_SPHERE, kinds=1):
    """Of subjects with hinges in directions (S, H, 3), near within an angle."""
    amounts, near = (np.zeros((kinds, len(directions), len(POINTS)), dtype) for dtype in (float, bool))
    for s, of_subject in enumerate(directions):
        vertices = np.argmax(of_subject @ POINTS.T, axis=1)
        np.add.at(amounts[:, s], (slice(None), vertices), 1.0)
        near[:, s] = (POINTS @ POINTS[vertices].T >= np.cos(radius)).any(axis=1)
    return Landmarks(np.where(areas > 0, amounts, 0.0), near, POINTS, ON_SPHERE, areas)


def random_directions(random, subjects, hinges):
    directions = random.standard_normal((subjects, hinges, 3))
    return directions / np.linalg.norm(directions, axis=2, keepdims=True)


def share(sums):
    return sums[..., 1, :].sum(axis=-1) / sums[..., 2, :].sum(axis=-1)


def by_chance(marks, spins, seed):
    return np.concatenate(list(common_by_chance(marks, spins, seed)))


def test_the_share_is_one_for_the_same_hinges_and_a_third_where_two_of_three_agree(rng):
    same = np.repeat(random_directions(rng, 1, 20), 3, axis=0)
    for directions, expected in ((same, 1), (np.stack([POLE, -POLE]), 0), (np.stack([POLE, POLE, -POLE]), 1 / 3)):
        assert share(common(landmarks(directions, 0.1))) == pytest.approx(expected)


def test_chance_is_the_share_of_the_sphere_that_is_near():
    """One hinge each: another is within an angle r by chance in (1 - cos r) / 2 of all rotations."""
    marks = landmarks(np.stack([POLE] * 4), 0.5)
    near = ON_SPHERE[marks.is_near[0, 0]].sum() / ON_SPHERE.sum()
    assert near == pytest.approx((1 - np.cos(0.5)) / 2, rel=0.1)
    assert share(by_chance(marks, 1500, 0)).mean() == pytest.approx(near, rel=0.1)


def test_every_subject_keeps_its_amount_in_the_cortex(rng):
    areas = np.where(POINTS[:, 2] > -0.6, ON_SPHERE, 0.0)
    marks = landmarks(random_directions(rng, 5, 30), 0.1, areas)
    sums = by_chance(marks, 50, 1)
    np.testing.assert_allclose(sums[:, 0, 0].sum(axis=1), marks.amounts.sum(), rtol=1e-5)
    assert not sums[..., areas == 0].any()


def test_by_chance_density_follows_the_area_of_the_cortex_not_that_of_the_sphere(rng):
    wide = POINTS[:, 0] > 0
    areas = ON_SPHERE * np.where(wide, 3.0, 1.0)
    amounts = by_chance(landmarks(random_directions(rng, 6, 40), 0.1, areas), 400, 2)[:, 0, 0].sum(axis=0)
    assert amounts[wide].sum() / amounts.sum() == pytest.approx(areas[wide].sum() / areas.sum(), abs=0.012)
    assert areas[wide].sum() / areas.sum() > 0.7


@pytest.mark.slow
@pytest.mark.parametrize("wall", [-1.1, -0.6], ids=["no wall", "a wall"])
def test_p_is_even_for_subjects_that_have_nothing_in_common(wall):
    """60 studies of 6 independent subjects: the rank of the study's share among its rotations is uniform."""
    random = np.random.default_rng(3)
    areas = np.where(POINTS[:, 2] > wall, ON_SPHERE, 0.0)
    ranks = []
    for study in range(60):
        inside = [each[each[:, 2] > wall + 0.05][:25] for each in random_directions(random, 6, 60)]
        marks = landmarks(inside, 0.2, areas)
        null = share(by_chance(marks, 99, study))[:, 0]
        ranks.append((np.sum(null >= share(common(marks))[0]) + 1) / 100)
    assert 0 <= np.sum(np.array(ranks) <= 0.1) <= 14  # 6 expected; above 14: once in a thousand
    assert 16 <= np.sum(np.array(ranks) <= 0.5) <= 44
    assert np.std(ranks) == pytest.approx(np.sqrt(1 / 12), abs=0.07)


def test_kinds_are_rotated_together(rng):
    sums = by_chance(landmarks(random_directions(rng, 4, 10), 0.2, kinds=2), 30, 5)
    np.testing.assert_array_equal(sums[:, 0], sums[:, 1])
