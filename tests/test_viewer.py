"""The page in a real browser: what is drawn, what the controls do, and that nothing is fetched or complained about."""

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from browser import assert_quiet, needs_browser, opened
from made_measures import made_measures

from morphofold.comparison import compare
from morphofold.report import analysis_report
from morphofold.surface import Surface

pytestmark = needs_browser
SMALL = 0.8
PIXELS_PER_MM = (
    "[...document.querySelectorAll('.ruler')].map(r => r.getBoundingClientRect().width / parseFloat(r.textContent))"
)
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
    shapes = {n: getattr(m.cortex, n) for n in ("white", "pial", "inflated")}
    return replace(
        m, cortex=replace(m.cortex, **{n: Surface(s.verts * SMALL, s.faces, s.name) for n, s in shapes.items()})
    )


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    """A comparison of a model and two hemispheres, open in the browser."""
    folder = tmp_path_factory.mktemp("viewer")
    pair = [with_net(made_measures("lh", name="<b>bold</b>")), made_measures("rh")]
    model = small(made_measures(regions=False, origin="simulation", info={"g": 2.0}))
    grown = [shrunk(model, g) for g in (1.0, 1.5)]
    page = compare({"model": model, "MRI": pair}, growth={"model": [*grown, model]}).report(folder / "out")
    with opened(page, folder / "profile", "viewer") as tab:
        yield tab


@pytest.fixture
def tab(viewer):
    """The open page, whose controls are put back afterwards."""
    yield viewer
    for layer in ("crests", "hinges"):
        if viewer.frame()[layer] == "true":
            press(viewer, f"#{layer}")
    for selector in ("input[name=side][value=both]", "input[name=surface][value=pial]", "input[value=H]", "#reset"):
        press(viewer, selector)
    viewer.js("document.activeElement.blur()")


def coloured(pixels):
    """How many of the samples are neither white nor grey."""
    return int((np.ptp(pixels, axis=1) > 20).sum())


def press(tab, selector):
    """Click what a selector finds; the state that the page leaves on the document."""
    tab.js(f"document.querySelector('{selector}').click()")
    return tab.frame()


def click(tab, x, y):
    """Click at a place of the window."""
    for kind in ("mousePressed", "mouseReleased"):
        tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    tab.frame()


def reading(tab, panel):
    """What a panel tells of the place that was clicked, by its heading."""
    heads = f"[...document.querySelectorAll('#{panel} .values dt')]"
    return dict(tab.js(f"{heads}.map(d => [d.textContent, d.nextSibling.textContent])"))


def slide(tab, k, g):
    """Move the slider of growth to its place k, where the first body is shown at growth g."""
    tab.js(f"(s => {{ s.value = {k}; s.dispatchEvent(new Event('input')); }})(document.getElementById('growth'))")
    for _ in range(50):  # a stage is unpacked when it is first asked for
        if tab.frame()["growth"].split(",")[0] == g:
            return
    pytest.fail("the stage was not shown")


def test_every_surface_is_drawn(tab):
    state = tab.frame()
    assert state["viewer"] == "ready"
    assert int(state["triangles"]) == 3 * 1280
    assert coloured(tab.pixels()) > 300
    assert tab.js("[...document.querySelectorAll('.panel .name')].map(p => p.textContent)") == [
        "model",
        "MRI lh",
        "MRI rh",
    ]


def test_the_overlay_switch_changes_colours_unit_and_limits(tab):
    before = tab.pixels()
    assert press(tab, "input[value=cortical_thickness]")["map"] == "cortical_thickness"
    assert np.abs(tab.pixels() - before).mean() > 5
    assert tab.js("document.getElementById('bar-title').textContent") == "Cortical thickness [mm]"
    assert tab.js("['bar-low', 'bar-high'].map(i => Number(document.getElementById(i).value))") == [1, 5]
    tab.js(
        "(() => { const m = document.querySelector('select[name=map]'); m.value = 'none'; "
        "m.dispatchEvent(new Event('change')); })()"
    )
    assert tab.frame()["map"] == ""
    assert coloured(tab.pixels()) < 100
    press(tab, "input[value=H]")
    np.testing.assert_allclose(tab.pixels(), before, atol=1)


def test_limits_stay_symmetric_for_a_sign_can_be_reset_and_are_kept_where_a_field_is_emptied(tab):
    def limits(end, value):
        field = f"document.getElementById('bar-{end}')"
        tab.js(f"{field}.value = '{value}'; {field}.dispatchEvent(new Event('change'))")
        return tab.js("['bar-low', 'bar-high'].map(i => Number(document.getElementById(i).value))")

    assert limits("high", 0.05) == [-0.05, 0.05]
    press(tab, "#bar-reset")
    for key, before in (("H", [-0.3, 0.3]), ("cortical_thickness", [1, 5])):
        press(tab, f"input[value={key}]")
        for end in ("low", "high"):
            assert limits(end, "") == before


@pytest.mark.slow
def test_the_surface_switch_draws_another_surface(tab):
    before = tab.pixels()
    assert press(tab, "input[name=surface][value=white]")["surface"] == "white"
    assert np.abs(tab.pixels() - before).mean() > 1


def test_dragging_and_the_keyboard_turn_every_panel(tab):
    before = tab.pixels().reshape(64, 64, 3)
    x, y = tab.middle_of("panel-0")
    mouse = lambda kind, x, y: tab.call(
        "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1
    )
    mouse("mousePressed", x, y)
    mouse("mouseMoved", x + 60, y + 10)
    mouse("mouseMoved", x + 120, y + 20)
    mouse("mouseReleased", x + 120, y + 20)
    assert tab.frame()["view"] == "free"
    change = np.abs(tab.pixels().reshape(64, 64, 3) - before).mean(axis=(0, 2))
    assert all(change[a:b].mean() > 2 for a, b in ((0, 21), (21, 42), (43, 64)))  # all three panels
    assert press(tab, "#reset")["view"] == "lateral"
    np.testing.assert_allclose(tab.pixels().reshape(64, 64, 3), before, atol=1)
    tab.js("document.getElementById('stage').dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowLeft'}))")
    assert tab.frame()["view"] == "free"
    assert press(tab, "[data-look=medial]")["view"] == "medial"
    assert tab.js("document.querySelector('[data-look=medial]').getAttribute('aria-pressed')") == "true"


def test_the_wheel_scrolls_the_page_until_one_clicks_into_the_viewer(tab):
    """The ruler follows the zoom."""

    def wheel(by, modifiers=0):
        """How far the page went and how many times larger the surfaces are."""
        before = tab.js(f"[scrollY, {PIXELS_PER_MM}[0]]")
        x, y = tab.middle_of("panel-0")
        tab.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=by, modifiers=modifiers)
        for _ in range(100):
            tab.frame()
            if (after := tab.js(f"[scrollY, {PIXELS_PER_MM}[0]]")) != before:
                break
        return after[0] - before[0], after[1] / before[1]

    larger = pytest.approx(np.exp(0.15), rel=0.02)
    tab.js("document.activeElement.blur()")
    assert wheel(100) == (100, 1)
    assert wheel(-100) == (-100, 1)
    assert wheel(-100, modifiers=2) == (0, larger)  # with ctrl
    click(tab, *tab.middle_of("panel-0"))
    assert wheel(-100) == (0, larger)


def test_a_click_reads_the_values_of_the_vertex_under_it(tab):
    m = made_measures("lh")
    click(tab, *tab.middle_of("panel-1"))
    values = reading(tab, "panel-1")
    vertex = int(values["Vertex"])
    at = m.cortex.pial.verts[vertex]
    middle = (m.cortex.pial.verts.max(axis=0) + m.cortex.pial.verts.min(axis=0)) / 2
    assert at[0] < -30  # lateral side of a left hemisphere
    assert np.linalg.norm((at - middle)[1:]) < 6  # within an edge of the middle
    assert values["Region"] == ("front", "middle", "back")[m.cortex.regions.labels[vertex]]
    thickness = float(values["Cortical thickness"].split()[0])
    assert thickness == pytest.approx(m.maps["cortical_thickness"][vertex], abs=0.006)
    assert tab.js("document.querySelector('#panel-1 .mark').hidden") is False


def test_the_net_is_drawn_over_the_surface_that_has_one(tab):
    press(tab, "input[value=cortical_thickness]")
    for layer, rgb, area in (("crests", (41, 41, 41), (200, 3000)), ("hinges", (214, 94, 0), (20, 100))):
        assert tab.count(rgb) == [0, 0, 0]
        assert press(tab, f"#{layer}")[layer] == "true"
        model, left, right = tab.count(rgb)
        assert area[0] < left < area[1]
        assert (model, right) == (0, 0)  # they have none
        assert press(tab, f"#{layer}")[layer] == "false"


def test_a_click_on_a_hinge_reads_it(tab):
    verts = made_measures("lh").cortex.pial.verts
    vertex = int(np.argmin(made_measures("lh").cortex.white.verts[:, 0]))
    away = verts[vertex] - (verts.max(axis=0) + verts.min(axis=0)) / 2
    x, y = tab.middle_of("panel-1") - tab.js(PIXELS_PER_MM)[1] * away[1:]  # seen from the left: anterior is left
    click(tab, x, y)
    assert "Hinge" not in reading(tab, "panel-1")  # not shown, not read
    press(tab, "#hinges")
    click(tab, x, y)
    hinge = reading(tab, "panel-1")
    assert (hinge["Hinge"], hinge["Angles"]) == ("0, Y", "0°, 120°, 240°")
    assert hinge["Arms"] == "8.00, 8.00, 8.00 mm"


def test_keys_go_from_hinge_to_hinge_in_sight_and_move_the_view(tab):
    def hinge_after(key, shift="false"):
        keydown = f"new KeyboardEvent('keydown', {{key: '{key}', shiftKey: {shift}}})"
        tab.js(f"document.getElementById('stage').dispatchEvent({keydown})")
        tab.frame()
        hinge = reading(tab, "panel-1").get("Hinge")
        return hinge and int(hinge.split(",")[0])

    assert hinge_after("n") is None  # not shown
    press(tab, "#hinges")
    assert [hinge_after(key) for key in "nnnN"] == [LATERAL, 8, 7, LATERAL]  # from the middle outwards, around
    assert [hinge_after(key) for key in "pp"] == [7, 8]
    assert tab.js("[...document.querySelectorAll('.mark')].map(m => m.hidden)") == [True, False, True]
    place = "['left', 'top'].map(s => parseFloat(document.querySelector('#panel-1 .mark').style[s]))"
    before = np.array(tab.js(place))
    for key, moved in (("ArrowRight", (30, 0)), ("ArrowUp", (30, -30)), ("ArrowLeft", (0, -30)), ("ArrowDown", (0, 0))):
        assert hinge_after(key, shift="true") == 8
        np.testing.assert_allclose(tab.js(place), before + moved, atol=0.01)
    assert tab.frame()["view"] == "lateral"  # not turned
    press(tab, "[data-look=medial]")
    assert hinge_after("n") == 9
    press(tab, "#hinges")
    press(tab, "#reset")
    assert hinge_after("p") is None


def test_one_hemisphere_is_shown_beside_the_model(tab):
    hidden = "[...document.querySelectorAll('.panel')].map(p => p.hidden)"
    for side, gone in (("lh", [False, False, True]), ("rh", [False, True, False]), ("both", [False] * 3)):
        press(tab, f"input[name=side][value={side}]")
        assert int(tab.frame()["triangles"]) == 1280 * (3 - sum(gone))
        assert tab.js(hidden) == gone


def test_the_slider_shows_earlier_stages_at_the_same_scale(tab):
    area = lambda: int((tab.pixels().reshape(64, 64, 3)[:, :21].min(axis=2) < 240).sum())
    full = area()
    assert tab.frame()["growth"].split(",")[0] == "2"
    for k, g in ((0, 1.0), (1, 1.5), (2, 2.0)):
        slide(tab, k, f"{g:g}")
        assert tab.js("document.getElementById('growth-now').textContent") == f"g = {g:g}"
        assert area() == pytest.approx(full * (g / 2) ** 2, rel=0.15)
        pixels = tab.pixels().reshape(64, 64, 3)[:, :21]
        assert (coloured(pixels.reshape(-1, 3)) > 20) == (g > 1)  # H was not measured at 1.0: bare


def test_a_panel_says_where_it_shows_another_stage_or_surface_than_its_name_or_the_switch(tab):
    names = lambda: tab.js("[...document.querySelectorAll('.panel .name')].map(p => p.textContent)")
    choose = "document.querySelector('input[name=surface][value={}]').click()"
    slide(tab, 1, "1.5")
    assert names() == ["model (shown at g = 1.5)", "MRI lh", "MRI rh"]
    tab.js(choose.format("inflated"))  # which a stage does not have
    tab.frame()
    assert names()[0] == "model (shown at g = 1.5; pial: has no inflated surface)"
    assert names()[1:] == ["MRI lh", "MRI rh"]
    slide(tab, 2, "2")
    assert names() == ["model", "MRI lh", "MRI rh"]
    tab.js(choose.format("pial"))
    tab.frame()


@pytest.mark.slow
def test_a_warning_leads_to_its_vertex(tmp_path):
    left, right = made_measures("lh"), made_measures("rh")
    x, y, z = right.cortex.pial.verts[100]
    right.notes["self_crossing"] = f"crossed at ({x:.6g}, {y:.6g}, {z:.6g})."
    page = analysis_report([left, right], tmp_path / "report.html")
    with opened(page, tmp_path / "profile", "viewer") as tab:
        assert tab.frame()["surface"] == "inflated"
        press(tab, "input[name=side][value=lh]")  # the other hemisphere
        assert press(tab, "[data-vertex]")["view"] == "free"
        mark = tab.js("document.querySelector('#panel-1 .mark').getBoundingClientRect().toJSON()")
        middle = (mark["x"] + mark["width"] / 2, mark["y"] + mark["height"] / 2)
        assert middle == pytest.approx(tab.middle_of("panel-1"), abs=1.5)
        assert tab.js("document.querySelector('#panel-1 .mark').hidden") is False
        assert tab.js("document.querySelector('#panel-1 .values dd').textContent") == "100"
        assert tab.js("document.querySelector('#panel-0 .mark').hidden") is True
        assert_quiet(tab)


def test_enter_reads_what_is_shown_and_a_click_beside_the_brain_nothing(tab):
    press(tab, "#hinges")
    press(tab, "input[name=side][value=rh]")
    tab.js("document.getElementById('stage').dispatchEvent(new KeyboardEvent('keydown', {key: 'Enter'}))")
    tab.frame()
    assert "Vertex" in reading(tab, "panel-2")
    assert reading(tab, "panel-1") == {}  # hidden
    press(tab, "input[name=side][value=both]")
    corner = tab.js("(b => [b.left + 8, b.bottom - 8])(document.getElementById('panel-1').getBoundingClientRect())")
    click(tab, *corner)
    assert reading(tab, "panel-1") == {}


@pytest.mark.slow
def test_the_values_of_a_hinge_stay_off_name_and_ruler_and_leave_the_surface_in_sight(tmp_path):
    one = with_net(made_measures())
    one.arms[:] = [{**one.arms[0], "arm": k, "angle_deg": 72.5 * k, "length_mm": 12.5} for k in range(5)]
    pair = [one, made_measures("rh")]
    boxes = (
        "['', ' .name', ' .values', ' .ruler'].map(part => document.querySelector('#panel-0' + part))"
        ".map(e => e.getBoundingClientRect().toJSON())"
    )
    several = ({"a": pair}, {"a": pair, "b": one}, {"a": pair, "b": pair})
    pages = [compare(shown).report(tmp_path / str(k)) for k, shown in enumerate(several)]
    with opened(analysis_report([one], tmp_path / "report.html"), tmp_path / "profile", "viewer") as tab:
        tab.call("Emulation.setDeviceMetricsOverride", width=1280, height=720, deviceScaleFactor=1, mobile=False)
        for page in (None, *pages):  # of one panel, two, three and four
            if page:
                tab.go(page, "viewer")
            press(tab, "#hinges")
            tab.js("document.getElementById('stage').dispatchEvent(new KeyboardEvent('keydown', {key: 'n'}))")
            tab.frame()
            panel, name, values, ruler = tab.js(boxes)
            assert name["bottom"] <= values["top"] < values["bottom"] < ruler["top"]
            assert panel["left"] < values["left"] < values["right"] < panel["right"]
            assert values["height"] < panel["height"] / 3


def test_the_paragraph_for_a_paper_is_there_to_copy(tab):
    assert "Fischl and Dale 2000" in tab.js("document.getElementById('methods').value")
    press(tab, "[data-copy]")
    assert tab.js("getSelection().toString().length || document.getElementById('methods').selectionEnd") > 500


def test_scale_each_to_fit_gives_every_panel_its_own_ruler(tab):
    """The scale is the same in every panel, and larger where the small surface is blown up."""
    model, left, right = tab.js(PIXELS_PER_MM)
    assert [model, right] == pytest.approx([left, left], rel=0.02)  # a ruler is drawn to a pixel
    press(tab, "#fit")
    model, left, right = tab.js(PIXELS_PER_MM)
    assert model == pytest.approx(left / SMALL, rel=0.03)
    assert right == pytest.approx(left, rel=0.02)
    press(tab, "#fit")
    assert np.ptp(tab.js(PIXELS_PER_MM)) < 0.05


def test_nothing_is_fetched_and_nothing_goes_wrong(tab):
    """Last, so that it hears what every test above set off."""
    assert_quiet(tab)


@pytest.mark.slow
def test_an_analysis_of_two_hemispheres_that_grow_is_as_quiet(tmp_path):
    """Every control of the page is used once."""
    left = with_net(made_measures("lh", info={"g": 2.0}))
    page = analysis_report(
        [left, made_measures("rh")], tmp_path / "report.html", stages=[shrunk(left, g) for g in (1.0, 1.5)]
    )
    with opened(page, tmp_path / "profile", "viewer") as tab:
        assert tab.frame()["growth"] == "2,"  # the right one does not grow
        tab.js("document.querySelectorAll('#viewer .tools input, #viewer .tools button').forEach(b => b.click())")
        slide(tab, 1, "1.5")
        tab.js("document.querySelectorAll('button.sort').forEach(b => b.click())")
        state = tab.frame()
        assert [state[key] for key in ("viewer", "tables", "crests", "hinges")] == ["ready", "ready", "true", "true"]
        assert_quiet(tab)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2, 4])
def test_surfaces_are_in_sight_on_the_first_screen_of_a_laptop(count, tmp_path):
    """At 1280 x 720 most of the first row of surfaces is seen without scrolling, however much is remarked on."""
    surfaces = {}
    for k in range(count):
        m = made_measures(name=f"subject {k}")
        m.notes.update(cortex_mask=f"no label came with surface {k}.", average=f"surface {k} is an average.")
        surfaces[m.cortex.name] = m
    page = compare(surfaces).report(tmp_path / "out")
    with opened(page, tmp_path / "profile", "viewer") as tab:
        tab.call("Emulation.setDeviceMetricsOverride", width=1280, height=720, deviceScaleFactor=1, mobile=False)
        tab.frame()
        box = tab.js("document.getElementById('panel-0').getBoundingClientRect().toJSON()")
        assert 720 - box["top"] > 0.7 * box["height"], box
