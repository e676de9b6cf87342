"""The page: what it says, that names are escaped, and that it asks for nothing outside itself."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from made_measures import large_pair, made_measures
from made_surfaces import area
from matplotlib.image import imread
from page_text import Page, assert_closed

from morphofold.comparison import compare
from morphofold.report.pages import cortex_pages, page_entries
from morphofold.report.pages.cortex_pages import analysis_report
from morphofold.report.plots import charts

NASTY = '<script>alert("x")</script>&"\'\x1b[31m\x9b\u202e'


@pytest.fixture(scope="module")
def nasty_pages(tmp_path_factory):
    """A comparison and an analysis of what has a script in all its names, as text."""
    m = made_measures(name=NASTY, info={NASTY: NASTY})
    m.maps[NASTY] = m.maps["H"]
    m.regions[0]["region"] = NASTY
    m.notes["n_crests"] = NASTY
    folder = tmp_path_factory.mktemp("page")
    result = compare({NASTY: m, "other": made_measures("rh", regions=False)})
    analysis_report([m], folder / "a.html", inputs=[{"path": NASTY, "sha256": "0"}])
    page = result.report(folder / "c")
    names = {p.name for p in (folder / "c/figures").iterdir()}
    assert names == {"H.png", "cortical_thickness.png", "gyral_thickness.png", "sulcal_depth.png"}
    assert imread(folder / "c/figures/H.png").std() > 0.02
    assert (folder / "c/comparison.json").is_file()
    assert (folder / "c/comparison.tsv").read_text(encoding="utf-8").startswith("measure\t")
    return [path.read_text(encoding="utf-8") for path in (page, folder / "a.html")]


def test_only_earlier_stages_of_the_same_body_are_shown_growing():
    m = made_measures(info={"g": 1.5, "name": "body"})
    stage_of = lambda **info: made_measures(info={"name": "body", **info})
    assert page_entries.is_earlier_stage(stage_of(g=1.2), m)
    for other in (
        stage_of(g=1.5),
        stage_of(g=2.0),
        stage_of(),
        stage_of(g=1.2, name="another"),
        made_measures(level=2, info={"g": 1.2}),
    ):
        assert not page_entries.is_earlier_stage(other, m)


def test_names_are_escaped_and_a_page_runs_its_one_script_and_points_at_nothing_outside_itself(nasty_pages):
    for text in nasty_pages:
        assert not re.search("[\x1b\x9b\u202e]", text)
        assert_closed(text)


def config(text):
    """What the page tells its viewer."""
    return json.loads(next(s for a, s in Page(text).scripts if a.get("id") == "viewer-config"))


@pytest.fixture
def draw_page(monkeypatch, tmp_path):
    """Write a comparison or analysis page; its text, the rows of its pictures and the series of its charts."""
    rows, series = [], []
    histograms, blank = charts.histograms, np.full((4, 4, 3), 255, np.uint8)
    monkeypatch.setattr(cortex_pages, "figure", lambda r, *a, **k: (rows.extend(r), blank)[1])
    monkeypatch.setattr(charts, "histograms", lambda s, *a: (series.append(s), histograms(s, *a))[1])

    def draw(measures):
        path = tmp_path / "report.html"
        if isinstance(measures, dict):
            cortex_pages.comparison_report(compare(measures), tmp_path)
        else:
            analysis_report(measures, path)
        return path.read_text(encoding="utf-8"), rows, series

    return draw


def test_each_hemisphere_is_drawn_as_the_side_it_is_and_weighed_by_its_pial_area(draw_page):
    pair = {"right": made_measures("rh"), "left": made_measures("lh")}
    text, rows, series = draw_page(pair)
    assert [s["hemi"] for s in config(text)["surfaces"]] == ["rh", "lh"]
    assert [(r.name, r.hemi) for r in rows] == [("right", "rh"), ("left", "lh")] * 4
    pial = area(pair["left"].cortex.pial)
    assert abs(area(pair["left"].cortex.white) / pial - 1) > 0.1
    for surface, _, weights in series[0]:
        assert weights.sum() == pytest.approx(pial, rel=1e-9), surface.name


def test_a_surface_keeps_its_dash_where_another_lacks_the_map(draw_page):
    several = {name: made_measures(name=name) for name in ("a", "b", "c")}
    del several["b"].maps["sulcal_depth"]
    text, _, series = draw_page(several)
    assert [[(s[0].name, s[0].dash) for s in chart] for chart in series] == [
        *[list(zip("abc", charts.DASHES))] * 3,
        [("a", charts.DASHES[0]), ("c", charts.DASHES[2])],
        list(zip("abc", charts.DASHES)),  # gyral over cortical thickness
    ]
    keys = re.findall(r'class="key-line".*?stroke-dasharray="([^"]*)"', text)
    assert keys == [*charts.DASHES[:3]] * 2  # in the legends of fits and of curves


THINNED = {"accuracy": "draft", "accuracy_vertices": 50001, "local_gyrification_voxel_mm": 2.5}
USUAL = {"accuracy": "standard", "accuracy_vertices": 642, "local_gyrification_voxel_mm": 1.25}


@pytest.mark.parametrize(
    ("parameters", "present", "absent"),
    [
        ([{"curvature_scale_mm": 9.4}, {"curvature_scale_mm": 3.901}], ["within 3.90 or 9.40 mm"], []),
        ([{"cortical_thickness_cap_mm": 5.0}], ["each 5 mm at most (Fischl"], ["grown", "Chen", "in some"]),
        ([{"cortex_mask": "label, where white and pial differ"}], ["?h.cortex.label"], ["every vertex"]),
        ([THINNED, USUAL], [" 50,001 vertices", "on voxels of 1.25 or 2.5 mm"], []),
        ([USUAL], [], ["resampled", "voxels"]),
    ],
)
def test_the_methods_have_the_lengths_and_meshes_that_were_used(draw_page, parameters, present, absent):
    surfaces = {str(k): replace(made_measures(), parameters=p) for k, p in enumerate(parameters)}
    for m in surfaces.values():
        m.scalars["n_hinges"] = 7
    methods = draw_page(surfaces)[0].split('<textarea id="methods"')[1].split("</textarea>")[0]
    assert [text for text in present if text not in methods] == []
    assert [text for text in absent if text in methods] == []


def test_the_methods_cite_an_atlas_and_a_law_of_growth_once(draw_page):
    info = {"g": 2.0, "law": "isotropic", "mu_ratio": 4.0}
    model = made_measures(origin="simulation", info=info)
    m = made_measures()
    regions = replace(m.cortex.regions, name="aparc.a2009s.fsaverage6")
    carried = replace(m, cortex=replace(m.cortex, regions=regions, info={"annotation_from": "fsaverage6"}))
    methods = draw_page({"model": model, "MRI": carried})[0].split('<textarea id="methods"')[1].split("</textarea>")[0]
    assert "template fsaverage6" in methods
    assert "4.00 times as stiff" in methods
    assert methods.count("Destrieux C") == methods.count("Chen X, Hutchinson JW") == 1


def test_a_simulation_is_named_with_its_growth_once_if_it_is_known(draw_page):
    kind = lambda m: re.search('class="kind">([^<]*)<', draw_page([m])[0])[1]
    silent = made_measures(origin="simulation", info={"g": None, "law": "isotropic", "mu_ratio": None})
    assert kind(silent) == "simulation · bump"
    simulated = lambda g: made_measures(origin="simulation", name="body g1.50", info={"g": g})
    assert kind(simulated(1.5)) == "simulation · body g1.50"
    assert kind(simulated(1.6)) == "simulation · body g1.50 · growth 1.6"


def test_warnings_come_before_cautions_and_remarks_each_once_and_lead_to_their_vertex(draw_page):
    model, other = made_measures(origin="simulation"), made_measures("rh", regions=False)
    x, y, z = model.cortex.white.verts[17]
    coarse = f"mesh is coarse at ({x:.6g}, {y:.6g}, {z:.6g})."
    model.notes.update(simulation="the energy grew.", curvature_scale=coarse, n_crests="none here.")
    other.notes.update(cortex_mask="label was lost.", parcellation="of no person.")
    text = draw_page({"model": model, "MRI": replace(other, parameters={"curvature_scale_mm": 9.5})})[0]
    rows = re.findall(
        r'<tr class="\w+"><th scope="row">([\w ]+)</th><td>[^<]*<details><summary>Details <code>(\w+)</code>', text
    )
    assert rows == [
        ("leave out", "simulation"),
        ("check", "cortex_mask"),
        ("check", "curvature_scale"),
        ("note", "parcellation"),
    ]
    (advice,) = re.findall(r'<p class="verdict">.*?</p>', text)
    assert re.findall(r"<strong>([^<]*)</strong> \((\d)", advice) == [("leave out", "2"), ("check before use", "1")]
    assert re.findall(r'data-panel="(\d+)" data-vertex="\d+">vertex (\d+)<', text) == [("0", "17")]
    for once in ("the energy grew", "mesh is coarse", "label was lost", "of no person", "none here"):
        assert text.count(once) == 1


def test_the_surface_shown_first_is_inflated_if_every_surface_has_it(draw_page):
    first = lambda measures: re.search(r'name="surface" value="(\w+)" checked', draw_page(measures)[0])[1]
    both, folded = [made_measures("lh"), made_measures("rh")], made_measures(origin="simulation")
    folded = replace(folded, cortex=replace(folded.cortex, inflated=None))
    assert first(both) == "inflated"
    assert first([folded]) == "pial"
    assert first({"a": both, "model": folded}) == "pial"  # beside each other in one shape


def test_numbers_of_freesurfer_are_measures_with_units(draw_page):
    text = draw_page([made_measures(info={"etiv_mm3": 1149123.4, "surface_holes": 23, "voxels": 2e6})])[0]
    row = lambda key: re.search(
        rf'data-v="{key}">.*?<td class="unit" data-v="([^"]*)">.*?<td data-v="([^"]*)">(.*?)</td>', text
    )
    assert row("etiv_mm3").groups() == ("mm³", "1149123.4", "1\u202f149\u202f123")
    assert row("surface_holes").groups() == ("", "23", "23")
    assert text.count("etiv_mm3") == 2  # its row and its key; not among the facts, too
    assert "e+0" not in re.sub(r"<script.*?</script>", "", text, flags=re.S)


@pytest.mark.slow
def test_a_page_of_two_large_hemispheres_is_below_15_megabytes(tmp_path, rng, monkeypatch):
    monkeypatch.setattr(cortex_pages, "_write_pictures", lambda *args: [])  # about half a megabyte each, seen elsewhere
    path = analysis_report(large_pair(rng), tmp_path / "report.html")
    assert 4e6 < path.stat().st_size < 15e6 - 5 * 0.7e6  # of room for five pictures
