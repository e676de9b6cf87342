"""A simulated cortex compared with its person: pairs, known answers, refusals, files and the page."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_people import LEVEL, made_person, measures_of, random_folds, source
from scipy.spatial.transform import Rotation

from morphofold.comparison import compare
from morphofold.comparison.person.common_sphere import bodies_of
from morphofold.comparison.person.compare_person import CONTROLS, compare_with_person, find_pairs
from morphofold.errors import MissingPart, NotReadable, OutOfRange, UnlikeSurfaces
from morphofold.io import read_morph
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


def simulated(folds, **options):
    """A cortex with folds that says it grew from the person."""
    return made_person(folds, **{"name": "simulated", "grown_from": source(), **options})


@pytest.fixture(scope="module")
def with_itself(person):
    return compare_with_person(person, person, LEVEL, spins=SPINS)


def test_a_body_that_is_the_person_agrees_everywhere_and_more_than_the_smooth_one(with_itself):
    assert [row.what for row in with_itself.agreements] == [*CONTROLS][: len(with_itself.agreements)]
    for row in with_itself.agreements:
        assert row.tested.value == pytest.approx(1, abs=1e-9)
        assert row.tested.p == pytest.approx(1 / (1 + SPINS))
        assert row.tested.control < 0.9
        assert row.tested.low > 0
        assert row.verdict == "above control"
        assert row.tested.control < row.deepened.control < 1
    assert with_itself.scale == pytest.approx(1)
    assert with_itself.verdict == "above control"
    for row in with_itself.correlations:
        assert row.tested.value == pytest.approx(1)
        assert row.n == 24
    assert {row.what for row in with_itself.correlations} >= {"cortical_thickness_mm", "area_expansion"}


def test_the_same_folds_on_another_mesh_and_in_another_size_agree(folds, person):
    points, faces = icosphere(4)
    mesh = points @ Rotation.random(rng=9).as_matrix().T, faces
    other = made_person(folds[0], mesh=mesh, size=90.0)
    result = compare_with_person(person, other, LEVEL, spins=SPINS)
    assert result.scale == pytest.approx(2 / 3, rel=5e-3)
    found = {what: row.tested.value for what, row in by_name(result).items()}
    least = {"folds": 0.96, "valleys": 0.95, "depth": 0.9, "curvature": 0.9, "axes": 0.8}
    assert all(found[what] > value for what, value in least.items()), found  # nearest vertices of a coarse mesh
    of = lambda key: [[row[f"{body}_{key}"] for row in result.regions] for body in ("person", "grown")]
    assert np.corrcoef(of("sulcal_depth_mm"))[0, 1] > 0.98
    np.testing.assert_allclose(*of("area_expansion"), rtol=0.05)


def test_the_opposite_folds_agree_less_than_by_chance(folds, person):
    """Not nowhere, because the ellipsoid below them is the same."""
    agreements = by_name(compare_with_person(person, made_person(-folds[0]), LEVEL, spins=SPINS))
    for what in ("folds", "depth"):
        tested = agreements[what].tested
        assert tested.value < tested.null_mean - 5 * tested.null_sd
        assert tested.p == 1
    assert {agreements[what].verdict for what in ("folds", "valleys", "depth", "curvature")} == {"none"}


def test_other_folds_agree_as_much_as_by_chance(folds, person):
    agreements = by_name(compare_with_person(person, made_person(folds[1]), LEVEL, spins=SPINS))
    for row in (agreements[what] for what in ("folds", "valleys", "curvature", "axes")):
        assert abs(row.tested.value - row.tested.null_mean) < 4 * row.tested.null_sd
        assert row.verdict == "none"


def by_name(result):
    return {row.what: row for row in result.agreements}


def of_pial(person, pial):
    """Measures of a cortex with another pial surface, and a white one below it."""
    white = Surface(0.95 * pial.verts, pial.faces)
    return measures_of(replace(person.cortex, white=white, pial=pial))


@pytest.mark.slow
def test_a_body_that_has_not_grown_is_no_better_than_its_control(person):
    """What it agrees is the leak of unfolding, and no result, however small its p."""
    bodies = bodies_of(person, person, LEVEL)
    smooth = bodies.controls["smooth"].cortex.pial
    agreements = by_name(compare_with_person(person, of_pial(person, smooth), LEVEL, spins=SPINS))
    for what in ("folds", "depth"):
        assert agreements[what].tested.value <= agreements[what].tested.control + 1e-9
    assert {row.verdict for row in agreements.values()} == {"none"}


@pytest.mark.slow
def test_a_body_whose_dents_are_only_deepened_is_above_the_smooth_one_and_no_result(person):
    bodies = bodies_of(person, person, LEVEL)
    deep = Surface(bodies.deepened(bodies.grown.points), person.cortex.faces)
    agreements = by_name(compare_with_person(person, of_pial(person, deep), LEVEL, spins=SPINS))
    depth, bent, axes = (agreements[what] for what in ("depth", "curvature", "axes"))
    assert agreements["folds"].deepened.value <= agreements["folds"].deepened.control + 1e-9
    assert depth.tested.value > depth.tested.control + 0.02
    assert depth.deepened.value <= depth.deepened.control + 1e-9
    assert (axes.verdict, bent.verdict) == ("deepened", "deepened")
    assert depth.verdict in ("deepened", "none")


def test_results_are_the_same_again_plain_json_and_carry_values_both_ways(person, with_itself):
    again = compare_with_person(person, person, LEVEL, spins=SPINS)
    assert again.to_dict() == with_itself.to_dict()
    json.dumps(again.to_dict(), allow_nan=False)
    carried = with_itself.carried()
    for direction in ("to_grown", "to_person"):
        np.testing.assert_allclose(carried[direction, "H"], person.maps["H"], atol=1e-9)
        np.testing.assert_allclose(carried[direction, "sulc"], person.cortex.maps["sulc"], atol=1e-9)


@pytest.mark.slow
def test_a_thickness_that_was_given_is_no_result_and_without_regions_there_is_no_table_of_them(person, folds):
    of_map = {**source(), "maps": ["thickness_map", "growth_map", "stiffness_map"]}
    with_maps = replace(person, cortex=replace(person.cortex, info={"grown_from": of_map}))
    rows = compare_with_person(person, with_maps, LEVEL, spins=9).correlations
    assert {row.what for row in rows if row.verdict == "given"} == {"cortical_thickness_mm", "area_expansion"}
    bare = replace(person, cortex=replace(person.cortex, regions=None))
    result = compare_with_person(bare, bare, LEVEL, spins=9)
    assert (result.correlations, result.regions) == ((), ())


def test_pairs_are_recognised_by_the_bytes_of_the_white_surface_and_the_side(folds, person):
    assert find_pairs({"P": person, "G": simulated(folds[1])}) == ([("P", "G", LEVEL)], [])
    for other in (simulated(folds[1], grown_from=source("someone")), simulated(folds[1], hemi="rh")):
        pairs, (remark,) = find_pairs({"P": person, "G": other})
        assert pairs == []
        assert remark.startswith("G ")
    assert find_pairs({"P": person, "Q": made_person(folds[1], name="other")}) == ([], [])
    pair = {"P lh": person, "P rh": made_person(folds[0], hemi="rh"), "G": simulated(folds[1])}
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


def test_compare_goes_on_without_a_pair_and_with_a_person_who_has_no_sphere(folds, person, tmp_path):
    cortex = simulated(folds[1])
    lonely = compare({"G": cortex})
    assert lonely.people == ()
    assert "people" not in lonely.to_dict()
    assert sum("G grew from lh of person" in caution for caution in lonely.cautions) == 1
    without = compare({"P": made_person(folds[0], sphere=False), "G": cortex})
    assert without.people == ()
    assert sum("lh.sphere" in caution for caution in without.cautions) == 1
    unrelated = compare({"P": person, "Q": person})
    assert unrelated.people == ()
    out = unrelated.report(tmp_path / "out").parent
    text = (out / "report.html").read_text(encoding="utf-8")
    assert ('id="person"' in text, "relief_height" in text) == (False, False)
    names = {"comparison.json", "comparison.tsv", "figures", "report.html"}
    assert {p.name for p in out.iterdir()} - {".morphofold"} == names


@pytest.fixture(scope="module")
def written(folds, person, tmp_path_factory):
    result = compare({"P<b>": person, "G": simulated(folds[1], size=90.0)}, spins=9)
    return result, result.report(tmp_path_factory.mktemp("compare") / "out").parent


def test_tables_maps_and_the_page_of_person_smooth_body_and_simulated_cortex_are_written(written):
    result, out = written
    assert sum("0.67" in caution for caution in result.cautions) == 1  # the other size is remarked on
    (pair,) = result.people
    rows = read_table(out / "person.tsv", {"person", "grown", "hemi", "over", "what", "control_map", "verdict"})
    assert [row["what"] for row in rows][:5] == ["folds", "valleys", "depth", "curvature", "axes"]
    assert rows[0]["value"] == pytest.approx(pair.agreements[0].tested.value, rel=1e-6)
    regions = read_table(out / "person_regions.tsv", {"person", "grown", "hemi", "region"})
    assert len(regions) == 24
    assert {row["person"] for row in regions} == {"P<b>"}
    content = json.loads((out / "comparison.json").read_text(encoding="utf-8"))
    assert content["people"][0]["verdict"] == pair.verdict
    for direction in ("to_grown", "to_person"):
        values = read_morph(out / "carried" / "1" / direction / "lh.H.shape.gii")
        np.testing.assert_allclose(values, pair.carried()[direction, "H"], rtol=1e-5)
    text = (out / "report.html").read_text(encoding="utf-8")
    assert '<section id="person">' in text
    assert text.count('class="panel"') == 3
    assert "P<b>" not in text
    assert (out / "figures" / "person-1.png").is_file()
    config = json.loads(text.split('id="viewer-config">')[1].split("</script>")[0])
    assert [s["name"] for s in config["surfaces"]][::2] == ["P<b>", "G"]
    assert config["maps"][0]["key"] == "relief_height"
    assert all("relief_height" in s["maps"] for s in config["surfaces"])


def test_a_pair_is_recognised_from_analyses_on_disk(folds, person, tmp_path):
    measures, read = {"P": person, "G": simulated(folds[1])}, {}
    for name, m in measures.items():
        write_analysis([m], tmp_path / name)
        (read[name],) = read_analysis(tmp_path / name)
    assert find_pairs(read) == ([("P", "G", LEVEL)], [])
    (pair,) = compare(read, spins=9).people
    expected = compare_with_person(*measures.values(), LEVEL, spins=9)
    value = expected.agreements[0].tested.value
    assert pair.agreements[0].tested.value == pytest.approx(value, abs=2e-3)  # float32
