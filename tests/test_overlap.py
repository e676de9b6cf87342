"""Hinges and crests that the subjects of a study share."""

import json

import numpy as np
import pytest
from commands import refused
from made_spaces import FACES, RADIUS, VERTS, write_space

from morphofold.cli import main
from morphofold.errors import DoesNotApply, OutOfRange
from morphofold.geometry import vertex_areas
from morphofold.group.overlap import COLUMNS, WHOLE, overlap
from morphofold.group.spaces import find_space
from morphofold.io import read_morph
from morphofold.report.pictures.sheet import read_png
from morphofold.tables import read_table
from morphofold.threads import using_threads

CORTEX = VERTS[:, 2] > -40
SUBJECTS, HINGES = 6, 10


def maps_of(places, hemi="lh"):
    """Maps of subjects with a hinge at vertices (S, H); a crest of 2 mm at each."""
    hinges = np.zeros((len(places), len(VERTS)))
    for row, at in zip(hinges, places):
        row[at] = 1.0
    unit = VERTS / RADIUS
    away = np.array([RADIUS * np.arccos(np.clip(unit @ unit[at].T, -1, 1)).min(axis=1) for at in places])
    areas = np.tile(vertex_areas(VERTS, FACES), (len(places), 1))
    maps = {"hinges": hinges, "crest_length": 2 * hinges, "hinge_distance": away, "crest_distance": away, "area": areas}
    return {f"{hemi}.{name}": values for name, values in maps.items()}


@pytest.fixture(scope="module")
def alike(tmp_path_factory):
    """Six subjects who share five hinges in the north; five more are anywhere."""
    random = np.random.default_rng(0)
    north, anywhere = np.flatnonzero(VERTS[:, 2] > 30), np.flatnonzero(CORTEX)
    same = random.choice(north, 5, replace=False)
    places = [np.unique(np.r_[same, random.choice(anywhere, 5, replace=False)]) for _ in range(SUBJECTS)]
    study = tmp_path_factory.mktemp("alike") / "study"
    write_space(study, maps_of(places), graph_width_mm=8.0)
    return study, places


def scattered(folder, rng, subjects=SUBJECTS):
    """A study whose subjects share no hinges."""
    places = [rng.choice(np.flatnonzero(CORTEX), HINGES, replace=False) for _ in range(subjects)]
    write_space(folder, maps_of(places), graph_width_mm=8.0)
    return find_space(folder)


def row_of(kind, region=WHOLE):
    return next(row for row in kind.rows if row["region"] == region)


def test_the_share_is_that_of_all_pairs_counted_one_by_one(alike):
    study, places = alike
    hinges, crests = overlap(find_space(study), hemis=["lh"], spins=20)
    assert hinges.radius == 4.0
    unit = VERTS / RADIUS
    pairs = [
        np.mean([(RADIUS * np.arccos(np.clip(unit[i] @ unit[b].T, -1, 1)) <= 4.0).any() for i in a]) * len(a)
        for a in places
        for b in places
        if a is not b
    ]
    expected = sum(pairs) / (SUBJECTS - 1) / sum(map(len, places))
    assert row_of(hinges)["share"] == pytest.approx(expected, rel=1e-6)
    assert row_of(crests)["share"] == pytest.approx(expected, rel=1e-6)
    assert row_of(hinges)["amount"] == pytest.approx(sum(map(len, places)) / SUBJECTS, rel=1e-6)
    assert row_of(crests)["amount"] == pytest.approx(2 * row_of(hinges)["amount"], rel=1e-6)
    regions = [row_of(hinges, region)["amount"] for region in ("north", "south")]
    assert sum(regions) == pytest.approx(row_of(hinges)["amount"])


def test_what_is_shared_stands_out_where_it_is(alike):
    study, _ = alike
    hinges, _ = overlap(find_space(study), hemis=["lh"], spins=199)
    north, south = row_of(hinges, "north"), row_of(hinges, "south")
    assert north["p"] == pytest.approx(1 / 200)
    assert north["p_corrected"] <= 0.01
    assert south["p_corrected"] > 0.05
    assert north["chance_low"] < north["chance"] < north["chance_high"] < north["share"]
    density, p = hinges.density["lh"], hinges.p["lh"]
    assert np.isnan(density[~CORTEX]).all()
    areas = vertex_areas(VERTS, FACES)
    assert areas[CORTEX] @ density[CORTEX] / 100 == pytest.approx(row_of(hinges)["amount"], rel=0.05)
    assert VERTS[np.nanargmin(p), 2] > 0
    assert np.nanmin(p) <= 0.05


def test_subjects_who_share_nothing_do_not_stand_out(tmp_path, rng):
    hinges, _ = overlap(scattered(tmp_path / "study", rng), hemis=["lh"], spins=99, seed=1)
    assert row_of(hinges)["p"] > 0.01
    assert np.nanmin(hinges.p["lh"]) > 0.01


def test_threads_do_not_change_the_numbers(alike):
    results = []
    for threads in (1, 2):
        with using_threads(threads):
            results.append(overlap(find_space(alike[0]), hemis=["lh"], spins=30))
    assert [kind.rows for kind in results[0]] == [kind.rows for kind in results[1]]
    np.testing.assert_array_equal(results[0][0].p["lh"], results[1][0].p["lh"])


def test_noise_has_no_density_unlike_chance_with_few_rotations(tmp_path):
    """20 studies of which 1 should have a corrected p of the density at 1 / 20, the least there can be."""
    random, significant = np.random.default_rng(8), 0
    for study in range(20):
        hinges, _ = overlap(scattered(tmp_path / f"{study}", random, 4), hemis=["lh"], spins=19, seed=study)
        significant += np.nanmin(hinges.p["lh"]) <= 0.05
    assert significant <= 5  # more: once in three hundred


def test_subjects_without_a_gyral_graph_are_left_out(tmp_path, rng):
    places = [rng.choice(np.flatnonzero(CORTEX), HINGES, replace=False) for _ in range(4)]
    maps = maps_of(places)
    for name in ("hinges", "crest_length", "hinge_distance", "crest_distance"):
        maps[f"lh.{name}"][1] = np.nan
    write_space(tmp_path / "study", maps, graph_width_mm=8.0)
    hinges, _ = overlap(find_space(tmp_path / "study"), hemis=["lh"], spins=5)
    assert row_of(hinges)["subjects"] == 3
    assert row_of(hinges)["amount"] == HINGES


def test_one_side_a_single_subject_an_unknown_width_and_wrong_numbers_are_refused(alike, tmp_path, rng):
    study = find_space(alike[0])
    with pytest.raises(DoesNotApply, match="--hemi lh"):
        overlap(study, spins=5)
    with pytest.raises(DoesNotApply):
        overlap(scattered(tmp_path / "one", rng, 1), hemis=["lh"])
    write_space(tmp_path / "two", maps_of(alike[1][:2]))
    with pytest.raises(DoesNotApply):
        overlap(find_space(tmp_path / "two"), hemis=["lh"])
    wrong = [{"radius": x} for x in (0.0, np.nan, -1.0)]
    for options in (*wrong, {"fwhm": 0.0}, {"fwhm": np.inf}, {"spins": 0}, {"seed": -1}):
        with pytest.raises(OutOfRange):
            overlap(study, hemis=["lh"], **options)


def test_the_command_writes_table_maps_and_page(alike, tmp_path, capsys):
    study, _ = alike
    out = tmp_path / "shared"
    words = ["overlap", str(study), "--hemi", "lh", "--rotations", "39", "-o", str(out), "-q"]
    assert main([*words, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["radius_mm"] == 4.0
    assert said["rotations"] == 39
    rows = read_table(out / "overlap.tsv", words=("hemi", "kind", "region"))
    assert tuple(rows[0]) == COLUMNS
    assert [row["region"] for row in rows] == 2 * ["south", "north", WHOLE]
    for name in ("hinge_density", "crest_density"):
        p = read_morph(out / "maps" / f"lh.{name}_p.shape.gii")
        assert np.nanmin(p) >= 1 / 40
        assert read_png(out / "figures" / f"{name}.png").any()
    assert "<svg" in (out / "report.html").read_text()
    assert main([*words, "--no-report"]) == 0
    assert not (out / "report.html").exists()


def test_a_study_without_hinges_on_the_template_is_refused_and_nothing_is_written(tmp_path, capsys):
    write_space(tmp_path / "study", {"lh.H": np.zeros((3, len(VERTS)))}, graph_width_mm=8.0)
    out = tmp_path / "shared"
    refused(capsys, ["overlap", str(tmp_path / "study"), "--hemi", "lh", "-o", str(out)], "hinges")
    assert not out.exists()
