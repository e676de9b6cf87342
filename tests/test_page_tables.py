"""Tables of the page in a real browser: they sort, and are saved with all digits."""

import pytest
from browser import needs_browser, opened
from made_measures import made_measures

from morphofold.report import analysis_report


@needs_browser
def test_tables_sort_and_are_saved_with_all_digits(tmp_path):
    m = made_measures("lh", name="sub/01")
    m.regions[1]["gyral_thickness_mm"] = None
    m.regions[2]["area_mm2"] = 1234.56789
    page = analysis_report([m], tmp_path / "report.html")
    names = "[...document.querySelectorAll('[data-name=sub_01-lh-regions] tbody th')].map(t => t.textContent)"
    head = "document.querySelector('[data-name=sub_01-lh-regions] th[data-key={}] button').click()"
    with opened(page, tmp_path / "profile", "tables") as tab:
        assert tab.js(names) == ["front", "middle", "back"]
        tab.js(head.format("region"))
        assert tab.js(names) == ["back", "front", "middle"]
        tab.js(head.format("gyral_thickness_mm"))
        assert tab.js(names) == ["front", "back", "middle"]  # without a value: last
        tab.js(head.format("gyral_thickness_mm"))
        assert tab.js(names) == ["back", "front", "middle"]  # falling, and still last
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
@needs_browser
def test_short_tables_are_open_on_paper_and_long_ones_not_there(tmp_path):
    m = made_measures("lh")
    m.hinges.extend(60 * m.hinges)
    page = analysis_report([m], tmp_path / "report.html")
    details = "[...document.querySelectorAll('details')]"
    with opened(page, tmp_path / "profile", "tables") as tab:
        shown = lambda: tab.js(f"{details}.map(d => d.checkVisibility() && d.querySelector('table').checkVisibility())")
        heads = lambda: tab.js(f"{details}.map(d => d.checkVisibility())")
        hint = lambda: tab.js("document.body.innerText.includes('Click on a column heading')")
        assert (shown(), heads(), hint()) == ([False, False], [True, True], True)
        tab.call("Emulation.setEmulatedMedia", media="print")
        tab.js("window.dispatchEvent(new Event('beforeprint'))")
        assert (shown(), heads(), hint()) == ([True, False], [True, False], False)
        tab.js("window.dispatchEvent(new Event('afterprint'))")
        tab.call("Emulation.setEmulatedMedia", media="")
        assert (shown(), heads(), hint()) == ([False, False], [True, True], True)
        tab.js(f"{details}.forEach(d => d.open = true)")  # opened by the reader
        tab.js("window.dispatchEvent(new Event('beforeprint'))")
        tab.js("window.dispatchEvent(new Event('afterprint'))")
        assert shown() == [True, True]
