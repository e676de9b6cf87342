"""A page in a real browser."""

import json
import shutil
import subprocess
import time
import urllib.request
from contextlib import contextmanager

import numpy as np
import pytest
from tornado.ioloop import IOLoop
from tornado.websocket import websocket_connect

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
#: software GL, and no conversation with anyone but the test
FLAGS = (
    "--headless --no-sandbox --disable-gpu-sandbox --use-gl=angle --use-angle=swiftshader "
    "--enable-unsafe-swiftshader --ignore-gpu-blocklist --disable-background-networking --no-first-run --disable-sync "
    "--disable-component-update --disable-quic --disable-extensions --hide-scrollbars --disable-smooth-scrolling "
    "--window-size=1280,1000 --remote-debugging-port=0 --remote-allow-origins=*"
).split()
BROWSER = next((path for name in BROWSERS if (path := shutil.which(name))), None)
needs_browser = pytest.mark.skipif(BROWSER is None, reason=f"no browser; looked for {', '.join(BROWSERS)}")


class Tab:
    """One page of a headless browser, spoken to over its debugging socket."""

    def __init__(self, port):
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
            target = next(t for t in json.load(answer) if t["type"] == "page")
        self.loop = IOLoop(make_current=False)
        connect = lambda: websocket_connect(target["webSocketDebuggerUrl"], max_message_size=2**28)
        self.socket = self.loop.run_sync(connect)
        self.number, self.events = 0, []

    def call(self, method, **params):
        self.number += 1
        self.socket.write_message(json.dumps({"id": self.number, "method": method, "params": params}))
        while True:
            message = json.loads(self.loop.run_sync(self.socket.read_message, timeout=60))
            if message.get("id") == self.number:
                assert "error" not in message, message
                return message["result"]
            self.events.append(message)

    def js(self, expression):
        answer = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def go(self, page, script):
        """Open the page at a path; wait, half a minute at most, for the word that its script leaves on the document."""
        self.call("Page.navigate", url=page.as_uri())
        for _ in range(1500):
            if self.js(f"document.documentElement?.dataset.{script}"):
                break
            time.sleep(0.02)

    def frame(self):
        """Let the page draw, then read the state it leaves on the document."""
        return self.js(
            "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => "
            "done({...document.documentElement.dataset}))))"
        )

    def press(self, selector):
        """Click what a selector finds; the state that the page leaves on the document."""
        self.js(f"document.querySelector('{selector}').click()")
        return self.frame()

    def key(self, key, shift="false"):
        """Press a key in the viewer."""
        event = f"new KeyboardEvent('keydown', {{key: '{key}', shiftKey: {shift}}})"
        self.js(f"document.getElementById('stage').dispatchEvent({event})")
        return self.frame()

    def mouse(self, kind, x, y, **more):
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1, **more)

    def click(self, x, y):
        """Click at a position in the window."""
        for kind in ("mousePressed", "mouseReleased"):
            self.mouse(kind, x, y)
        self.frame()

    def box(self, selector):
        """Where an element lies in the window."""
        return self.js(f"document.querySelector('{selector}').getBoundingClientRect().toJSON()")

    def middle_of(self, selector):
        box = self.box(selector)
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def pixels(self):
        """Colours of the canvas, sampled on a grid, (64, 64, 3)."""
        rgba = self.js(
            "(() => { const c = document.createElement('canvas'); c.width = c.height = 64; "
            "const g = c.getContext('2d'); g.drawImage(document.getElementById('canvas'), 0, 0, 64, 64); "
            "return [...g.getImageData(0, 0, 64, 64).data]; })()"
        )
        return np.array(rgba, dtype=float).reshape(64, 64, 4)[..., :3]

    def count(self, rgb):
        """How many pixels of the canvas have a colour, within 3, in each third of its width."""
        return self.js(
            "(() => { const c = document.getElementById('canvas'), d = document.createElement('canvas'); "
            "d.width = c.width; d.height = c.height; const g = d.getContext('2d'); g.drawImage(c, 0, 0); "
            "const p = g.getImageData(0, 0, d.width, d.height).data, n = [0, 0, 0], want = " + str(list(rgb)) + "; "
            "for (let i = 0; i < p.length; i += 4) if (want.every((w, k) => Math.abs(p[i + k] - w) < 4)) "
            "n[Math.floor(3 * (i / 4 % d.width) / d.width)]++; return n; })()"
        )


def assert_quiet(tab):
    """Nothing was fetched but the page itself, and nothing it did was complained about."""
    tab.frame()
    of = lambda method: [e["params"] for e in tab.events if e.get("method") == method]
    urls = [request["request"]["url"] for request in of("Network.requestWillBeSent")]
    assert [url[:60] for url in urls if not url.startswith(("file:", "data:", "blob:"))] == []
    assert sum(url.startswith("file:") for url in urls) == 1  # the page itself
    assert of("Runtime.exceptionThrown") == []
    assert [call for call in of("Runtime.consoleAPICalled") if call["type"] in ("error", "warning", "assert")] == []
    assert [line for line in of("Log.entryAdded") if line["entry"]["level"] == "error"] == []


@contextmanager
def opened(page, profile, script):
    """The page at a path, open in a browser of its own; ``script`` is the word its document has once that runs."""
    silent = {"stderr": subprocess.DEVNULL, "stdout": subprocess.DEVNULL}
    browser = subprocess.Popen([BROWSER, *FLAGS, f"--user-data-dir={profile}", "about:blank"], **silent)
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
        tab.go(page, script)
        yield tab
        tab.socket.close()
    finally:
        browser.terminate()
        browser.wait(10)
