"""A page in a real browser."""

import base64
import http.client
import json
import os
import shutil
import socket
import subprocess
import time
from contextlib import contextmanager

import numpy as np
import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-background-networking",
    "--no-first-run",
    "--disable-sync",
    "--disable-component-update",
    "--disable-quic",
    "--disable-extensions",
    "--hide-scrollbars",
    "--disable-smooth-scrolling",
    "--window-size=1280,1000",
    "--remote-debugging-port=0",
    "--remote-allow-origins=*",
)
"""Software GL, and no conversation with anyone but the test."""
BROWSER = next((found for name in BROWSERS if (found := shutil.which(name))), None)
needs_browser = pytest.mark.skipif(BROWSER is None, reason=f"no browser here; looked for {', '.join(BROWSERS)}")


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
    asked = [e["params"]["request"]["url"] for e in tab.events if e.get("method") == "Network.requestWillBeSent"]
    assert [u[:60] for u in asked if not u.startswith(("file:", "data:", "blob:"))] == []
    assert sum(u.startswith("file:") for u in asked) == 1  # the page itself
    wrong = [
        e
        for e in tab.events
        if e.get("method") == "Runtime.exceptionThrown"
        or (e.get("method") == "Runtime.consoleAPICalled" and e["params"]["type"] in ("error", "warning", "assert"))
        or (e.get("method") == "Log.entryAdded" and e["params"]["entry"]["level"] == "error")
    ]
    assert wrong == []


@contextmanager
def opened(page, profile, script):
    """The page at a path, open in a browser of its own; ``script`` is the word its document has once that runs."""
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
        tab.go(page, script)
        yield tab
        tab.socket.close()
    finally:
        browser.terminate()
        browser.wait(10)
