"""The page in a real browser: what is drawn, what the controls do, and that nothing is fetched or complained about."""

import base64
import http.client
import json
import os
import shutil
import socket
import subprocess
import time
from dataclasses import replace

import numpy as np
import pytest
from made_measures import made_measures

from morphofold.comparison import compare
from morphofold.report import figures
from morphofold.surface import Surface

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--disable-background-networking", "--no-first-run",
    "--disable-sync", "--disable-component-update", "--disable-quic", "--disable-extensions", "--hide-scrollbars",
    "--window-size=1280,1000", "--remote-debugging-port=0", "--remote-allow-origins=*",
)  # fmt: skip
"""Software GL, and no conversation with anyone but the test."""
BROWSER = next((found for name in BROWSERS if (found := shutil.which(name))), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason=f"no browser here; looked for {', '.join(BROWSERS)}")


class Tab:
    """One page of a headless browser, spoken to over its debugging socket (a WebSocket, kept as small as will do)."""

    def __init__(self, port):
        http_ = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        http_.request("GET", "/json")
        target = next(t for t in json.loads(http_.getresponse().read()) if t["type"] == "page")
        path = "/" + target["webSocketDebuggerUrl"].split("/", 3)[3]
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=60)
        key = base64.b64encode(os.urandom(16)).decode()
        self.socket.sendall(
            f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        self.stream = self.socket.makefile("rb")
        assert b" 101 " in self.stream.readline()
        while self.stream.readline() != b"\r\n":
            pass
        self.number, self.events = 0, []

    def call(self, method, **params):
        self.number += 1
        data = json.dumps({"id": self.number, "method": method, "params": params}).encode()
        size = len(data)
        head = bytes([0x81, 0x80 | size]) if size < 126 else b"\x81\xfe" + size.to_bytes(2, "big")
        self.socket.sendall(head + bytes(4) + data)  # a mask of zeros leaves the text as it is
        while True:
            message = self.receive()
            if message.get("id") == self.number:
                assert "error" not in message, message
                return message["result"]
            self.events.append(message)

    def receive(self):
        text, last = b"", False
        while not last:
            first, size = self.stream.read(2)
            last = bool(first & 0x80)
            if size >= 126:
                size = int.from_bytes(self.stream.read(2 if size == 126 else 8), "big")
            text += self.stream.read(size)
        return json.loads(text)

    def js(self, expression):
        got = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in got, got
        return got["result"].get("value")

    def frame(self):
        """Let the page draw, then read the state it leaves on the document."""
        return self.js(
            "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => "
            "done({...document.documentElement.dataset}))))"
        )

    def middle_of(self, panel):
        """Where the middle of a panel lies in the window, (x, y) in pixels."""
        box = self.js(f"document.getElementById('{panel}').getBoundingClientRect().toJSON()")
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def pixels(self):
        """Colours of the canvas, sampled on a grid of 64 x 64, (4096, 3)."""
        rgba = self.js(
            "(() => { const c = document.createElement('canvas'); c.width = c.height = 64; "
            "const g = c.getContext('2d'); g.drawImage(document.getElementById('canvas'), 0, 0, 64, 64); "
            "return [...g.getImageData(0, 0, 64, 64).data]; })()"
        )
        return np.array(rgba, dtype=float).reshape(-1, 4)[:, :3]


SMALL = 0.8


def small(m):
    """The same measures of a cortex ``SMALL`` times the size."""
    shapes = {n: getattr(m.cortex, n) for n in ("white", "pial", "inflated")}
    return replace(
        m, cortex=replace(m.cortex, **{n: Surface(s.verts * SMALL, s.faces, s.name) for n, s in shapes.items()})
    )


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    """A comparison of a model and two hemispheres, open in the browser."""
    folder = tmp_path_factory.mktemp("viewer")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MORPHOFOLD_RENDERER", "raster")
        figures.renderer.cache_clear()
        pair = [made_measures("lh", name="<b>bold</b>"), made_measures("rh")]
        page = compare({"model": small(made_measures(regions=False)), "MRI": pair}).report(folder / "out")
    figures.renderer.cache_clear()
    profile = folder / "profile"
    browser = subprocess.Popen(
        [BROWSER, *FLAGS, f"--user-data-dir={profile}", "about:blank"],
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    )
    try:
        port_file = profile / "DevToolsActivePort"
        for _ in range(300):
            if port_file.is_file() and port_file.read_text().count("\n"):
                break
            time.sleep(0.1)
        else:
            pytest.fail("the browser did not start within 30 s")
        tab = Tab(int(port_file.read_text().split()[0]))
        for domain in ("Page", "Runtime", "Log", "Network"):
            tab.call(f"{domain}.enable")
        tab.call("Page.navigate", url=page.as_uri())
        for _ in range(300):
            if tab.js("document.documentElement?.dataset.viewer"):
                break
            time.sleep(0.1)
        yield tab
        tab.socket.close()
    finally:
        browser.terminate()
        browser.wait(10)


def coloured(pixels):
    """How many of the samples are neither white nor grey."""
    return int((np.ptp(pixels, axis=1) > 20).sum())


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
    tab.js("document.querySelector('input[value=cortical_thickness]').click()")
    assert tab.frame()["map"] == "cortical_thickness"
    assert np.abs(tab.pixels() - before).mean() > 5
    assert tab.js("document.getElementById('bar-title').textContent") == "Cortical thickness [mm]"
    assert tab.js("['bar-low', 'bar-high'].map(i => Number(document.getElementById(i).value))") == [1, 5]
    tab.js("(() => { const m = document.querySelector('select[name=map]'); m.value = 'none'; "
           "m.dispatchEvent(new Event('change')); })()")  # fmt: skip
    assert tab.frame()["map"] == ""
    assert coloured(tab.pixels()) < 100
    tab.js("document.querySelector('input[value=H]').click()")
    tab.frame()
    np.testing.assert_allclose(tab.pixels(), before, atol=1)


def test_signed_limits_stay_symmetric_and_can_be_reset(tab):
    high = "document.getElementById('bar-high')"
    tab.js(f"{high}.value = '0.05'; {high}.dispatchEvent(new Event('change'))")
    assert tab.js("['bar-low', 'bar-high'].map(i => Number(document.getElementById(i).value))") == [-0.05, 0.05]
    tab.js("document.getElementById('bar-reset').click()")
    assert tab.js("['bar-low', 'bar-high'].map(i => Number(document.getElementById(i).value))") == [-0.3, 0.3]


def test_the_surface_switch_draws_another_surface(tab):
    before = tab.pixels()
    tab.js("document.querySelector('input[name=surface][value=white]').click()")
    assert tab.frame()["surface"] == "white"
    assert np.abs(tab.pixels() - before).mean() > 1
    tab.js("document.querySelector('input[name=surface][value=pial]').click()")
    tab.frame()


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
    tab.js("document.getElementById('reset').click()")
    assert tab.frame()["view"] == "lateral"
    np.testing.assert_allclose(tab.pixels().reshape(64, 64, 3), before, atol=1)
    tab.js("document.getElementById('stage').dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowLeft'}))")
    assert tab.frame()["view"] == "free"
    tab.js("document.querySelector('[data-look=medial]').click()")
    assert tab.frame()["view"] == "medial"
    assert tab.js("document.querySelector('[data-look=medial]').getAttribute('aria-pressed')") == "true"
    tab.js("document.getElementById('reset').click()")
    tab.frame()


def test_the_wheel_zooms_and_the_ruler_follows(tab):
    width = "(r => r.getBoundingClientRect().width / parseFloat(r.textContent))(document.querySelector('.ruler'))"
    before = tab.js(width)
    tab.js("document.getElementById('stage').dispatchEvent(new WheelEvent('wheel', {deltaY: -300, cancelable: true}))")
    tab.frame()
    assert tab.js(width) == pytest.approx(before * np.exp(0.45), rel=0.02)
    tab.js("document.getElementById('reset').click()")
    tab.frame()


def test_a_click_reads_the_values_of_the_vertex_under_it(tab):
    m = made_measures("lh")
    x, y = tab.middle_of("panel-1")
    for kind in ("mousePressed", "mouseReleased"):
        tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    tab.frame()
    shown = tab.js("[...document.querySelectorAll('#panel-1 .values dd')].map(d => d.textContent)")
    labels = tab.js("[...document.querySelectorAll('#panel-1 .values dt')].map(d => d.textContent)")
    said = dict(zip(labels, shown))
    vertex = int(said["Vertex"])
    at = m.cortex.pial.verts[vertex]
    middle = (m.cortex.pial.verts.max(axis=0) + m.cortex.pial.verts.min(axis=0)) / 2
    assert at[0] < -30  # lateral side of a left hemisphere
    assert np.linalg.norm((at - middle)[1:]) < 6  # within an edge of the middle
    assert said["Region"] == ("front", "middle", "back")[m.cortex.regions.labels[vertex]]
    assert float(said["Cortical thickness"].split()[0]) == pytest.approx(
        m.maps["cortical_thickness"][vertex], abs=0.006
    )
    assert tab.js("document.querySelector('#panel-1 .mark').hidden") is False
    tab.js("document.getElementById('reset').click()")
    tab.frame()


def test_scale_each_to_fit_gives_every_panel_its_own_ruler(tab):
    """Pixels per mm: the same in every panel, and larger where the small surface is blown up."""
    scales = (
        "[...document.querySelectorAll('.ruler')].map(r => r.getBoundingClientRect().width / parseFloat(r.textContent))"
    )
    model, left, right = tab.js(scales)
    assert model == pytest.approx(left, rel=0.02)                         # a ruler is drawn to a pixel
    assert right == pytest.approx(left, rel=0.02)
    tab.js("document.getElementById('fit').click()")
    tab.frame()
    model, left, right = tab.js(scales)
    assert model == pytest.approx(left / SMALL, rel=0.03)
    assert right == pytest.approx(left, rel=0.02)
    tab.js("document.getElementById('fit').click()")
    tab.frame()
    assert np.ptp(tab.js(scales)) < 0.05


def test_nothing_is_fetched_and_nothing_goes_wrong(tab):
    """Last, so that it hears what every test above set off."""
    tab.frame()
    asked = [e["params"]["request"]["url"] for e in tab.events if e.get("method") == "Network.requestWillBeSent"]
    assert [u[:60] for u in asked if not u.startswith(("file:", "data:", "blob:"))] == []
    assert sum(u.startswith("file:") for u in asked) == 1  # the page itself
    wrong = [
        e for e in tab.events
        if e.get("method") == "Runtime.exceptionThrown"
        or (e.get("method") == "Runtime.consoleAPICalled" and e["params"]["type"] in ("error", "warning", "assert"))
        or (e.get("method") == "Log.entryAdded" and e["params"]["entry"]["level"] == "error")
    ]  # fmt: skip
    assert wrong == []
