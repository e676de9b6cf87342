"""The page in a real browser: what is drawn, what the controls do, and that nothing is fetched or complained about."""

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from browser import assert_quiet, needs_browser, opened
from made_measures import made_measures
from made_people import made_person, random_folds, source

from morphofold.comparison import compare
from morphofold.report import analysis_report
from morphofold.surface import Surface

pytestmark = needs_browser
SMALL = 0.8
PIXELS_PER_MM = (
    "[...document.querySelectorAll('.ruler')].map(r => r.getBoundingClientRect().width / parseFloat(r.textContent))"
)
NAMES = "[...document.querySelectorAll('.panel .name')].map(p => p.textContent)"
LIMITS = "['bar-low', 'bar-high'].map(i => Number(document.getElementById(i).value))"
LATERAL = 0  # of a hinge whose arms run on the side that a left hemisphere shows laterally
OTHERS = {7: (-20, -28, 10), 8: (-30, 0, -19), 9: (36, 0, 0)}  # hinges by number, mm; the last on the other side


def shrunk(m, g):
    """The same body at an earlier growth, as many times smaller; at 1.0 nothing was measured but thickness."""
    cortex = m.cortex
    shapes = {n: Surface(getattr(cortex, n).verts * g / 2, cortex.faces) for n in ("white", "pial")}
    maps = {"cortical_thickness": m.maps["cortical_thickness"] * g / 2} if g == 1 else m.maps
    return replace(m, cortex=replace(cortex, **shapes, inflated=None, info={"g": g}), maps=maps)


def with_net(m):
    """The same measures with a net of one hinge on the lateral side, three crests long 30 degrees."""
    verts = m.cortex.white.verts
    vertex = int(np.argmin(verts[:, 0]))
    out = verts[vertex] / np.linalg.norm(verts[vertex])
    graph = nx.MultiGraph(edge=4.0, scales=None)
    graph.add_node(LATERAL, position=verts[vertex], normal=out, degree=3, vertex=vertex)
    for k in range(3):
        across = np.array([0, np.cos(2 * np.pi * k / 3), np.sin(2 * np.pi * k / 3)])
        line = np.array([np.cos(a) * out + np.sin(a) * across for a in np.radians(np.arange(0, 31, 3))])
        graph.add_node(k + 1, position=36 * line[-1], normal=out, degree=1, vertex=vertex)
        graph.add_edge(LATERAL, k + 1, polyline=36 * line, number=k)
    x, y, z = verts[vertex]
    hinges = [{**m.hinges[0], "x": x, "y": y, "z": z, "hinge": LATERAL, "blind": 0}]
    for number, (x, y, z) in OTHERS.items():
        hinges.append({**m.hinges[0], "x": x, "y": y, "z": z, "hinge": number, "degree": 4, "blind": 0})
    return replace(m, graph=graph, hinges=hinges)


def small(m):
    """The same measures of a cortex ``SMALL`` times the size."""
    surfaces = {n: getattr(m.cortex, n) for n in ("white", "pial", "inflated")}
    scaled = {n: Surface(s.verts * SMALL, s.faces, s.name) for n, s in surfaces.items()}
    return replace(m, cortex=replace(m.cortex, **scaled))


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    """A comparison of a model and two hemispheres, open in the browser."""
    folder = tmp_path_factory.mktemp("viewer")
    pair = [with_net(made_measures("lh", name="<b>bold</b>")), made_measures("rh")]
    model = small(made_measures(regions=False, origin="simulation", info={"g": 2.0}))
    stages = [*(shrunk(model, g) for g in (1.0, 1.5)), model]
    page = compare({"model": model, "MRI": pair}, growth={"model": stages}).report(folder / "out")
    with opened(page, folder / "profile", "viewer") as tab:
        yield tab


@pytest.fixture
def tab(viewer):
    """The open page, whose controls are put back afterwards."""
    yield viewer
    for layer in ("crests", "hinges", "borders"):
        if viewer.frame()[layer] == "true":
            viewer.press(f"#{layer}")
    for selector in ("input[name=side][value=both]", "input[name=surface][value=pial]", "input[value=H]", "#reset"):
        viewer.press(selector)
    viewer.js("document.activeElement.blur(); scrollTo(0, 0)")


def coloured(pixels):
    """How many of the samples are neither white nor grey."""
    return int((np.ptp(pixels, axis=-1) > 20).sum())


def reading(tab, panel):
    """What a panel tells of the vertex that was clicked, by its heading."""
    heads = f"[...document.querySelectorAll('#{panel} .values dt')]"
    return dict(tab.js(f"{heads}.map(d => [d.textContent, d.nextSibling.textContent])"))


def slide(tab, k, g):
    """Move the slider of growth to its position k, where the first body is shown at growth g."""
    tab.js(f"(s => {{ s.value = {k}; s.dispatchEvent(new Event('input')); }})(document.getElementById('growth'))")
    for _ in range(50):  # a stage is unpacked when it is first needed
        if tab.frame()["growth"].split(",")[0] == g:
            return
    pytest.fail("the stage was not shown")


def test_every_surface_is_drawn_with_its_name_and_the_methods_are_there_to_copy(tab):
    state = tab.frame()
    assert (state["viewer"], int(state["triangles"])) == ("ready", 3 * 1280)
    assert coloured(tab.pixels()) > 300
    assert tab.js(NAMES) == ["model", "MRI lh", "MRI rh"]
    hidden = "[...document.querySelectorAll('.panel')].map(p => p.hidden)"
    for side, gone in (("lh", [False, False, True]), ("rh", [False, True, False]), ("both", [False] * 3)):
        assert int(tab.press(f"input[name=side][value={side}]")["triangles"]) == 1280 * (3 - sum(gone))
        assert tab.js(hidden) == gone
    assert "Fischl and Dale 2000" in tab.js("document.getElementById('methods').value")
    tab.press("[data-copy]")
    assert tab.js("getSelection().toString().length || document.getElementById('methods').selectionEnd") > 500


def test_the_switches_change_surface_colours_unit_and_limits(tab):
    before = tab.pixels()
    assert tab.press("input[name=surface][value=white]")["surface"] == "white"
    assert np.abs(tab.pixels() - before).mean() > 1
    tab.press("input[name=surface][value=pial]")
    assert tab.press("input[value=cortical_thickness]")["map"] == "cortical_thickness"
    assert np.abs(tab.pixels() - before).mean() > 5
    assert tab.js("document.getElementById('bar-title').textContent") == "Cortical thickness [mm]"
    assert tab.js(LIMITS) == [1, 5]
    select = "(m => { m.value = 'none'; m.dispatchEvent(new Event('change')); })"
    tab.js(f"{select}(document.querySelector('select[name=map]'))")
    assert tab.frame()["map"] == ""
    assert coloured(tab.pixels()) < 100
    tab.press("input[value=H]")
    np.testing.assert_allclose(tab.pixels(), before, atol=1)


def test_limits_stay_symmetric_for_a_sign_can_be_reset_and_stay_where_a_field_is_emptied(tab):
    def limits(end, value):
        field = f"document.getElementById('bar-{end}')"
        tab.js(f"{field}.value = '{value}'; {field}.dispatchEvent(new Event('change'))")
        return tab.js(LIMITS)

    assert limits("high", 0.05) == [-0.05, 0.05]
    tab.press("#bar-reset")
    for key, before in (("H", [-0.3, 0.3]), ("cortical_thickness", [1, 5])):
        tab.press(f"input[value={key}]")
        for end in ("low", "high"):
            assert limits(end, "") == before


def test_dragging_and_the_keyboard_turn_every_panel(tab):
    before = tab.pixels()
    x, y = tab.middle_of("#panel-0")
    for kind, step in (("mousePressed", 0), ("mouseMoved", 60), ("mouseMoved", 120), ("mouseReleased", 120)):
        tab.mouse(kind, x + step, y + step / 6, buttons=1)
    assert tab.frame()["view"] == "free"
    change = np.abs(tab.pixels() - before).mean(axis=(0, 2))
    assert all(change[a:b].mean() > 2 for a, b in ((0, 21), (21, 42), (43, 64)))  # all three panels
    assert tab.press("#reset")["view"] == "lateral"
    np.testing.assert_allclose(tab.pixels(), before, atol=1)
    assert tab.key("ArrowLeft")["view"] == "free"
    assert tab.press("[data-look=medial]")["view"] == "medial"
    assert tab.js("document.querySelector('[data-look=medial]').getAttribute('aria-pressed')") == "true"


def test_the_wheel_scrolls_the_page_until_one_clicks_into_the_viewer(tab):
    """The ruler follows the zoom."""
    state = f"[scrollY, {PIXELS_PER_MM}[0]]"

    def wheel(by, modifiers=0):
        """How far the page went and how many times larger the surfaces are."""
        before = after = tab.js(state)
        x, y = tab.middle_of("#panel-0")
        tab.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=by, modifiers=modifiers)
        for _ in range(100):
            tab.frame()
            if (after := tab.js(state)) != before:
                break
        return after[0] - before[0], after[1] / before[1]

    larger = pytest.approx(np.exp(0.15), rel=0.02)
    tab.js("document.activeElement.blur()")
    assert wheel(100) == (100, 1)
    assert wheel(-100) == (-100, 1)
    assert wheel(-100, modifiers=2) == (0, larger)  # with ctrl
    tab.click(*tab.middle_of("#panel-0"))
    assert wheel(-100) == (0, larger)


def test_a_click_reads_the_values_of_the_vertex_under_it(tab):
    m = made_measures("lh")
    tab.click(*tab.middle_of("#panel-1"))
    values = reading(tab, "panel-1")
    vertex = int(values["Vertex"])
    position = m.cortex.pial.verts[vertex]
    middle = (m.cortex.pial.verts.max(axis=0) + m.cortex.pial.verts.min(axis=0)) / 2
    assert position[0] < -30  # lateral side of a left hemisphere
    assert np.linalg.norm((position - middle)[1:]) < 6  # within an edge of the middle
    assert values["Region"] == ("front", "middle", "back")[m.cortex.regions.labels[vertex]]
    thickness = float(values["Cortical thickness"].split()[0])
    assert thickness == pytest.approx(m.maps["cortical_thickness"][vertex], abs=0.006)
    assert tab.js("document.querySelector('#panel-1 .mark').hidden") is False


def test_enter_reads_what_is_visible_and_a_click_off_the_brain_nothing(tab):
    tab.press("#hinges")
    tab.press("input[name=side][value=rh]")
    tab.key("Enter")
    assert "Vertex" in reading(tab, "panel-2")
    assert reading(tab, "panel-1") == {}  # hidden
    tab.press("input[name=side][value=both]")
    panel = tab.box("#panel-1")
    tab.click(panel["left"] + 8, panel["bottom"] - 8)
    assert reading(tab, "panel-1") == {}


def test_the_net_is_drawn_over_the_surface_that_has_one(tab):
    tab.press("input[value=cortical_thickness]")
    for layer, rgb, (low, high) in (("crests", (41, 41, 41), (200, 3000)), ("hinges", (214, 94, 0), (20, 100))):
        assert tab.count(rgb) == [0, 0, 0]
        assert tab.press(f"#{layer}")[layer] == "true"
        model, left, right = tab.count(rgb)
        assert low < left < high
        assert (model, right) == (0, 0)  # they have none
        assert tab.press(f"#{layer}")[layer] == "false"


def test_borders_of_regions_are_drawn_over_the_surfaces_that_have_regions(tab):
    tab.press("input[value=cortical_thickness]")
    rgb = (26, 26, 128)
    assert tab.count(rgb) == [0, 0, 0]
    assert tab.press("#borders")["borders"] == "true"
    model, left, right = tab.count(rgb)
    assert model == 0
    assert min(left, right) > 100
    assert tab.press("#borders")["borders"] == "false"


def test_a_click_on_a_hinge_reads_it(tab):
    verts = made_measures("lh").cortex.pial.verts
    vertex = int(np.argmin(made_measures("lh").cortex.white.verts[:, 0]))
    offset = verts[vertex] - (verts.max(axis=0) + verts.min(axis=0)) / 2
    x, y = tab.middle_of("#panel-1") - tab.js(PIXELS_PER_MM)[1] * offset[1:]  # seen from the left: anterior is left
    tab.click(x, y)
    assert "Hinge" not in reading(tab, "panel-1")  # not visible, not read
    tab.press("#hinges")
    tab.click(x, y)
    hinge = reading(tab, "panel-1")
    assert (hinge["Hinge"], hinge["Angles"]) == ("0, Y", "0°, 120°, 240°")
    assert hinge["Arms"] == "8.00, 8.00, 8.00 mm"


def test_keys_go_from_hinge_to_hinge_in_sight_and_move_the_view(tab):
    def hinge_after(key, shift="false"):
        tab.key(key, shift)
        hinge = reading(tab, "panel-1").get("Hinge")
        return hinge and int(hinge.split(",")[0])

    assert hinge_after("n") is None  # not visible
    tab.press("#hinges")
    assert [hinge_after(key) for key in "nnnN"] == [LATERAL, 8, 7, LATERAL]  # from the middle outwards, around
    assert [hinge_after(key) for key in "pp"] == [7, 8]
    assert tab.js("[...document.querySelectorAll('.mark')].map(m => m.hidden)") == [True, False, True]
    position = "['left', 'top'].map(s => parseFloat(document.querySelector('#panel-1 .mark').style[s]))"
    before = np.array(tab.js(position))
    for key, step in (("ArrowRight", (30, 0)), ("ArrowUp", (30, -30)), ("ArrowLeft", (0, -30)), ("ArrowDown", (0, 0))):
        assert hinge_after(key, shift="true") == 8
        np.testing.assert_allclose(tab.js(position), before + step, atol=0.01)
    assert tab.frame()["view"] == "lateral"  # not turned
    tab.press("[data-look=medial]")
    assert hinge_after("n") == 9
    tab.press("#hinges")
    tab.press("#reset")
    assert hinge_after("p") is None


def test_the_slider_shows_earlier_stages_at_the_same_scale_and_the_panel_says_so(tab):
    area = lambda: int((tab.pixels()[:, :21].min(axis=2) < 240).sum())
    full = area()
    assert tab.frame()["growth"].split(",")[0] == "2"
    for k, g in ((0, 1.0), (2, 2.0), (1, 1.5)):
        slide(tab, k, f"{g:g}")
        assert tab.js("document.getElementById('growth-now').textContent") == f"g = {g:g}"
        assert area() == pytest.approx(full * (g / 2) ** 2, rel=0.15)
        assert (coloured(tab.pixels()[:, :21]) > 20) == (g > 1)  # H was not measured at 1.0: bare
    assert tab.js(NAMES) == ["model (shown at g = 1.5)", "MRI lh", "MRI rh"]
    tab.press("input[name=surface][value=inflated]")  # which a stage does not have
    assert tab.js(NAMES) == ["model (shown at g = 1.5; pial: has no inflated surface)", "MRI lh", "MRI rh"]
    slide(tab, 2, "2")
    assert tab.js(NAMES) == ["model", "MRI lh", "MRI rh"]


def test_scale_each_to_fit_gives_every_panel_its_own_ruler(tab):
    """The scale is the same in every panel, and larger where the small surface is blown up."""
    model, left, right = tab.js(PIXELS_PER_MM)
    assert [model, right] == pytest.approx([left, left], rel=0.02)  # a ruler is drawn to a pixel
    tab.press("#fit")
    model, left, right = tab.js(PIXELS_PER_MM)
    assert model == pytest.approx(left / SMALL, rel=0.03)
    assert right == pytest.approx(left, rel=0.02)
    tab.press("#fit")
    assert np.ptp(tab.js(PIXELS_PER_MM)) < 0.05


def test_nothing_is_fetched_and_nothing_goes_wrong(tab):
    """Last of this page, so that it hears what every test above set off."""
    assert_quiet(tab)


# --- other pages


@pytest.mark.slow
def test_tables_sort_and_are_saved_with_all_digits(tmp_path):
    m = made_measures("lh", name="sub/01")
    m.regions[1]["gyral_thickness_mm"] = None
    m.regions[2]["area_mm2"] = 1234.56789
    names = "[...document.querySelectorAll('[data-name=sub_01-lh-regions] tbody th')].map(t => t.textContent)"
    with opened(analysis_report([m], tmp_path / "report.html"), tmp_path / "profile", "tables") as tab:
        sort = lambda key: (tab.press(f"[data-name=sub_01-lh-regions] th[data-key={key}] button"), tab.js(names))[1]
        assert tab.js(names) == ["front", "middle", "back"]
        assert sort("region") == ["back", "front", "middle"]
        assert sort("gyral_thickness_mm") == ["front", "back", "middle"]  # without a value: last
        assert sort("gyral_thickness_mm") == ["back", "front", "middle"]  # falling, and still last
        assert tab.js("document.querySelector('th[aria-sort]').getAttribute('aria-sort')") == "descending"
        tab.js("URL.createObjectURL = (blob) => { window.saved = blob; return '#'; }")
        tab.js("HTMLAnchorElement.prototype.click = function () { window.link = this.download; }")
        tab.js("document.querySelector('[data-name=sub_01-lh-regions] + .save').click()")
        assert tab.js("window.link") == "sub_01-lh-regions.tsv"
        lines = [line.split("\t") for line in tab.js("window.saved.text()").splitlines()]
        assert lines[0][:3] == ["region", "n_vertices", "area_mm2"]
        assert [line[0] for line in lines[1:]] == ["back", "front", "middle"]
        assert lines[1][2] == "1234.56789"
        assert lines[3][lines[0].index("gyral_thickness_mm")] == "n/a"
        tables = tab.js("[...document.querySelectorAll('table.sortable')].map(t => t.dataset.name)")
        assert tables == ["measures", "sub_01-lh-regions", "sub_01-lh-hinges"]


@pytest.mark.slow
def test_short_tables_are_open_on_paper_and_long_ones_not_there(tmp_path):
    m = made_measures("lh")
    m.hinges.extend(60 * m.hinges)
    page = analysis_report([m], tmp_path / "report.html")
    details = "[...document.querySelectorAll('details')]"
    visible = f"{details}.map(d => d.checkVisibility() && d.querySelector('table').checkVisibility())"
    state = (
        f"[{visible}, {details}.map(d => d.checkVisibility()), "
        "document.body.innerText.includes('Click on a column heading')]"
    )
    with opened(page, tmp_path / "profile", "tables") as tab:
        assert tab.js(state) == [[False, False], [True, True], True]
        tab.call("Emulation.setEmulatedMedia", media="print")
        tab.js("window.dispatchEvent(new Event('beforeprint'))")
        assert tab.js(state) == [[True, False], [True, False], False]
        tab.js("window.dispatchEvent(new Event('afterprint'))")
        tab.call("Emulation.setEmulatedMedia", media="")
        assert tab.js(state) == [[False, False], [True, True], True]
        tab.js(f"{details}.forEach(d => d.open = true)")  # opened by the reader
        tab.js("window.dispatchEvent(new Event('beforeprint'))")
        tab.js("window.dispatchEvent(new Event('afterprint'))")
        assert tab.js(visible) == [True, True]


@pytest.mark.slow
def test_an_analysis_of_two_hemispheres_that_grow_is_as_quiet_and_a_warning_leads_to_its_vertex(tmp_path):
    """Every control of the page is used once."""
    left, right = with_net(made_measures("lh", info={"g": 2.0})), made_measures("rh")
    x, y, z = right.cortex.pial.verts[100]
    right.notes["self_crossing"] = f"crossed at ({x:.6g}, {y:.6g}, {z:.6g})."
    stages = [shrunk(left, g) for g in (1.0, 1.5)]
    page = analysis_report([left, right], tmp_path / "report.html", stages=stages)
    with opened(page, tmp_path / "profile", "viewer") as tab:
        assert tab.frame()["growth"] == "2,"  # the right one does not grow
        tab.press("input[name=side][value=lh]")  # the other hemisphere
        assert tab.press("[data-vertex]")["view"] == "free"
        assert tab.middle_of("#panel-1 .mark") == pytest.approx(tab.middle_of("#panel-1"), abs=1.5)
        assert tab.js("[0, 1].map(k => document.querySelector(`#panel-${k} .mark`).hidden)") == [True, False]
        assert reading(tab, "panel-1")["Vertex"] == "100"
        tab.js("document.querySelectorAll('#viewer .tools input, #viewer .tools button').forEach(b => b.click())")
        slide(tab, 1, "1.5")
        tab.js("document.querySelectorAll('button.sort').forEach(b => b.click())")
        state = tab.frame()
        assert [state[key] for key in ("viewer", "tables", "crests", "hinges")] == ["ready", "ready", "true", "true"]
        assert_quiet(tab)


@pytest.mark.slow
def test_on_a_laptop_surfaces_are_in_sight_and_the_values_of_a_hinge_stay_off_name_and_ruler(tmp_path):
    """At 1280 x 720 most of the first row of surfaces is seen without scrolling: one panel, two, three and four."""
    left = with_net(made_measures())
    left.arms[:] = [{**left.arms[0], "arm": k, "angle_deg": 72.5 * k, "length_mm": 12.5} for k in range(5)]
    pair = [left, made_measures("rh")]
    for m in pair:
        m.notes.update(cortex_mask="no label came with it.", average="it is an average.")
    several = ({"a": pair}, {"a": pair, "b": left}, {"a": pair, "b": pair})
    pages = [compare(surfaces).report(tmp_path / str(k)) for k, surfaces in enumerate(several)]
    with opened(analysis_report([left], tmp_path / "report.html"), tmp_path / "profile", "viewer") as tab:
        tab.call("Emulation.setDeviceMetricsOverride", width=1280, height=720, deviceScaleFactor=1, mobile=False)
        for page in (None, *pages):
            if page:
                tab.go(page, "viewer")
            panel = tab.box("#panel-0")
            assert 720 - panel["top"] > 0.7 * panel["height"], panel
            tab.press("#hinges")
            tab.key("n")
            panel, name, values, ruler = (tab.box(f"#panel-0{part}") for part in ("", " .name", " .values", " .ruler"))
            assert name["bottom"] <= values["top"] < values["bottom"] < ruler["top"]
            assert panel["left"] < values["left"] < values["right"] < panel["right"]
            assert values["height"] < panel["height"] / 3


@pytest.mark.slow
def test_a_click_on_the_person_marks_the_same_point_on_smooth_body_and_simulated_cortex(tmp_path):
    rng = np.random.default_rng(4)
    person = made_person(random_folds(rng))
    simulated = made_person(random_folds(rng), name="simulated", grown_from=source())
    other = made_person(random_folds(rng), name="other")
    page = compare({"P": person, "S": simulated, "O": other}, spins=9).report(tmp_path / "out")
    with opened(page, tmp_path / "profile", "viewer") as tab:
        names = tab.js(NAMES)
        assert (names[0], names[2], names[3]) == ("P", "S", "O")
        assert tab.frame()["map"] == "relief_height"
        tab.click(*tab.middle_of("#panel-0"))
        vertices = [reading(tab, f"panel-{k}").get("Vertex", "") for k in range(4)]
        assert vertices[0].isdigit()
        assert vertices == [vertices[0]] * 3 + [""]  # all have the same mesh; the last is nobody's
        assert_quiet(tab)
