"""A grown cortex beside its person: pairs, known answers, refusals, files and the page."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_people import LEVEL, made_person, measures_of, random_folds, source
from scipy.spatial.transform import Rotation

from morphofold.comparison import compare
from morphofold.comparison.person.bodies import bodies_of
from morphofold.comparison.person.compare_person import compare_with_person, find_pairs
from morphofold.errors import MissingPart, NotReadable, OutOfRange, UnlikeSurfaces
from morphofold.results import read_analysis, write_analysis
from morphofold.shapes import icosphere
from morphofold.surface import Surface
from morphofold.tables import read_table

SPINS = 60


@pytest.fixture(scope="module")
def folds():
    rng = np.random.default_rng(4)
    return [random_folds(rng) for _ in range(2)]


@pytest.fixture(scope="module")
def person(folds):
    return made_person(folds[0])


@pytest.fixture(scope="module")
def beside_itself(person):
    return compare_with_person(person, person, LEVEL, spins=SPINS)


def test_a_body_that_is_the_person_agrees_everywhere_and_more_than_the_smooth_one(beside_itself):
    assert [row.what for row in beside_itself.agreements] == ["depth", "curvature", "axes"]
    for row in beside_itself.agreements:
        assert row.tested.value == pytest.approx(1, abs=1e-9)
        assert row.tested.p == pytest.approx(1 / (1 + SPINS))
        assert row.tested.control < 0.9
        assert row.tested.low > 0
        assert row.verdict == "above control"
        assert row.tested.control < row.deepened.control < 1
    assert beside_itself.scale == pytest.approx(1)
    assert beside_itself.verdict == "above control"
    for row in beside_itself.correlations:
        assert row.tested.value == pytest.approx(1)
        assert row.n == 24
    assert {row.what for row in beside_itself.correlations} >= {"cortical_thickness_mm", "area_expansion"}


def test_the_same_folds_on_another_mesh_and_in_another_size_agree(folds, person):
    points, faces = icosphere(4)
    mesh = points @ Rotation.random(rng=9).as_matrix().T, faces
    other = made_person(folds[0], mesh=mesh, size=90.0)
    found = compare_with_person(person, other, LEVEL, spins=SPINS)
    assert found.scale == pytest.approx(2 / 3, rel=5e-3)
    assert found.agreements[0].tested.value > 0.9  # nearest vertices of a coarse mesh
    assert found.agreements[1].tested.value > 0.9
    assert found.agreements[2].tested.value > 0.8
    by_region = [[row[f"{body}_sulcal_depth_mm"] for row in found.regions] for body in ("person", "grown")]
    assert np.corrcoef(by_region)[0, 1] > 0.98
    expansion = [[row[f"{body}_area_expansion"] for row in found.regions] for body in ("person", "grown")]
    np.testing.assert_allclose(*expansion, rtol=0.05)


def test_the_opposite_folds_agree_less_than_by_chance(folds, person):
    """Not nowhere, because the ellipsoid below them is the same."""
    found = compare_with_person(person, made_person(-folds[0]), LEVEL, spins=SPINS)
    depth = found.agreements[0].tested
    assert depth.value < depth.null_mean - 5 * depth.null_sd
    assert depth.p == 1
    assert [row.verdict for row in found.agreements[:2]] == ["none", "none"]


def test_other_folds_agree_as_much_as_by_chance(folds, person):
    found = compare_with_person(person, made_person(folds[1]), LEVEL, spins=SPINS)
    for row in found.agreements[1:]:
        assert abs(row.tested.value - row.tested.null_mean) < 4 * row.tested.null_sd
        assert row.verdict == "none"


def test_a_body_that_has_not_grown_is_no_better_than_its_control(person):
    """What it agrees is the leak of unfolding, and no result, however small its p."""
    bodies = bodies_of(person, person, LEVEL)
    smooth = bodies.controls["smooth"].cortex.pial
    inner = Surface(0.95 * smooth.verts, smooth.faces)
    grown = measures_of(replace(person.cortex, white=inner, pial=smooth))
    found = compare_with_person(person, grown, LEVEL, spins=SPINS)
    depth = found.agreements[0].tested
    assert depth.value <= depth.control + 1e-9
    assert {row.verdict for row in found.agreements} == {"none"}


def test_a_body_whose_dents_are_only_deepened_is_above_the_smooth_one_and_no_result(person):
    bodies = bodies_of(person, person, LEVEL)
    deep = Surface(bodies.deepened(bodies.grown.points), person.cortex.faces)
    grown = measures_of(replace(person.cortex, white=Surface(0.95 * deep.verts, deep.faces), pial=deep))
    depth, bent, axes = compare_with_person(person, grown, LEVEL, spins=SPINS).agreements
    assert depth.tested.value > depth.tested.control + 0.02
    assert depth.deepened.value <= depth.deepened.control + 1e-9
    assert (axes.verdict, bent.verdict) == ("deepened", "deepened")
    assert depth.verdict in ("deepened", "none")


def test_results_are_the_same_again_and_plain_json(person, beside_itself):
    again = compare_with_person(person, person, LEVEL, spins=SPINS)
    assert again.to_dict() == beside_itself.to_dict()
    assert compare_with_person(person, person, LEVEL, spins=SPINS, seed=1).to_dict() != again.to_dict()
    json.dumps(again.to_dict(), allow_nan=False)


def test_a_thickness_that_was_given_is_no_result(person):
    of_map = {**source(), "maps": ["thickness_map", "growth_map", "stiffness_map"]}
    given = replace(person, cortex=replace(person.cortex, info={"grown_from": of_map}))
    rows = compare_with_person(person, given, LEVEL, spins=SPINS).correlations
    verdicts = {row.what: row.verdict for row in rows}
    assert {what for what, verdict in verdicts.items() if verdict == "given"} == {
        "cortical_thickness_mm",
        "area_expansion",
    }


def test_without_regions_there_is_no_table_of_them(folds):
    bare = made_person(folds[0], regions=False)
    found = compare_with_person(bare, bare, LEVEL, spins=9)
    assert (found.correlations, found.regions) == ((), ())


def test_values_are_carried_both_ways(person, beside_itself):
    carried = beside_itself.carried()
    for where in ("to_grown", "to_person"):
        np.testing.assert_allclose(carried[where, "H"], person.maps["H"], atol=1e-9)
        np.testing.assert_allclose(carried[where, "sulc"], person.cortex.maps["sulc"], atol=1e-9)


def test_pairs_are_known_by_the_bytes_of_the_white_surface_and_the_side(folds, person):
    of = lambda **more: made_person(folds[1], name="grown", grown_from=source(**more))
    assert find_pairs({"P": person, "G": of()}) == ([("P", "G", LEVEL)], [])
    for other in (of(name="someone"), made_person(folds[1], name="grown", hemi="rh", grown_from=source())):
        pairs, remarks = find_pairs({"P": person, "G": other})
        assert pairs == []
        assert len(remarks) == 1
        assert remarks[0].startswith("G ")
    assert find_pairs({"P": person, "Q": made_person(folds[1], name="other")}) == ([], [])
    pair = {"P lh": person, "P rh": made_person(folds[0], hemi="rh"), "G": of()}
    assert find_pairs(pair)[0] == [("P lh", "G", LEVEL)]


def test_an_incomplete_record_of_the_person_is_refused_where_it_is_read(folds, tmp_path):
    write_analysis([made_person(folds[1], grown_from={"subject": "person", "unfold": LEVEL})], tmp_path)
    with pytest.raises(NotReadable, match=r"summary\.json: .*grown_from\.sha256.*Analyze"):
        read_analysis(tmp_path)


def test_cortices_that_cannot_be_compared_are_refused(folds, person):
    with pytest.raises(MissingPart, match=r"lh\.sphere"):
        compare_with_person(made_person(folds[0], sphere=False), person, LEVEL)
    with pytest.raises(MissingPart, match=r"\(H\)"):
        compare_with_person(person, replace(person, maps={}), LEVEL)
    with pytest.raises(UnlikeSurfaces, match="rh"):
        compare_with_person(person, made_person(folds[0], hemi="rh"), LEVEL)
    with pytest.raises(OutOfRange):
        compare_with_person(person, person, 7.0)
    with pytest.raises(OutOfRange, match="spins"):
        compare({"a": person}, spins=0)


def test_compare_goes_on_without_a_person_and_with_one_who_has_no_sphere(folds, person):
    grown = made_person(folds[1], name="grown", grown_from=source())
    alone = compare({"G": grown})
    assert alone.people == ()
    assert "people" not in alone.to_dict()
    assert sum("G grew from lh of person" in said for said in alone.cautions) == 1
    without = compare({"P": made_person(folds[0], sphere=False), "G": grown})
    assert without.people == ()
    assert sum("lh.sphere" in said for said in without.cautions) == 1
    assert compare({"P": person, "Q": person}).people == ()


def test_a_cortex_of_another_size_is_remarked_on(folds, person):
    large = made_person(folds[1], name="grown", grown_from=source(), size=90.0)
    result = compare({"P": person, "G": large}, spins=9)
    assert sum("0.67" in said for said in result.cautions) == 1


@pytest.fixture(scope="module")
def written(folds, person, tmp_path_factory):
    grown = made_person(folds[1], name="grown", grown_from=source())
    result = compare({"P<b>": person, "G": grown}, spins=SPINS)
    return result, result.report(tmp_path_factory.mktemp("compare") / "out").parent


def test_tables_and_maps_are_written(written):
    result, out = written
    (found,) = result.people
    rows = read_table(out / "person.tsv", {"person", "grown", "hemi", "over", "what", "control_map", "verdict"})
    assert [row["what"] for row in rows][:3] == ["depth", "curvature", "axes"]
    assert rows[0]["value"] == pytest.approx(found.agreements[0].tested.value, rel=1e-6)
    regions = read_table(out / "person_regions.tsv", {"person", "grown", "hemi", "region"})
    assert len(regions) == 24
    assert {row["person"] for row in regions} == {"P<b>"}
    content = json.loads((out / "comparison.json").read_text(encoding="utf-8"))
    assert content["people"][0]["verdict"] == found.verdict
    from morphofold.io import read_morph

    for where in ("to_grown", "to_person"):
        values = read_morph(out / "carried" / "1" / where / "lh.H.shape.gii")
        np.testing.assert_allclose(values, found.carried()[where, "H"], rtol=1e-5)


def test_the_page_shows_person_smooth_body_and_grown_cortex(written):
    _, out = written
    text = (out / "report.html").read_text(encoding="utf-8")
    assert '<section id="person">' in text
    assert text.count('class="panel"') == 3
    assert "P<b>" not in text
    assert (out / "figures" / "person-1.png").is_file()
    config = json.loads(text.split('id="viewer-config">')[1].split("</script>")[0])
    assert [s["name"] for s in config["surfaces"]][::2] == ["P<b>", "G"]
    assert config["maps"][0]["key"] == "relief_height"
    assert all("relief_height" in s["maps"] for s in config["surfaces"])


def test_a_page_without_a_pair_has_no_section_on_people(folds, person, tmp_path):
    out = compare({"P": person}).report(tmp_path / "out").parent
    text = (out / "report.html").read_text(encoding="utf-8")
    assert 'id="person"' not in text
    assert "relief_height" not in text
    assert {p.name for p in out.iterdir()} == {
        ".morphofold",
        "comparison.json",
        "comparison.tsv",
        "figures",
        "report.html",
    }


def test_a_pair_is_known_again_from_analyses_on_disk(folds, person, tmp_path):
    grown = made_person(folds[1], name="grown", grown_from=source())
    named = {}
    for name, m in (("P", person), ("G", grown)):
        write_analysis([m], tmp_path / name)
        (named[name],) = read_analysis(tmp_path / name)
    assert find_pairs(named) == ([("P", "G", LEVEL)], [])
    (found,) = compare(named, spins=9).people
    cwd = compare_with_person(person, grown, LEVEL, spins=9)
    assert found.agreements[0].tested.value == pytest.approx(cwd.agreements[0].tested.value, abs=2e-3)  # float32
