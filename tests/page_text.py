"""What a page runs and points to, and what is to be read on it."""

import base64
import hashlib
import html
import re
from html.parser import HTMLParser


class Page(HTMLParser):
    """What a browser would make of a page: ids, scripts with their attributes, and whatever points elsewhere."""

    def __init__(self, text):
        super().__init__()
        self.scripts, self.links, self.ids, self.open = [], [], set(), None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        assert not any(k.startswith("on") for k, _ in attrs)
        self.links += [v for k, v in attrs if k in ("src", "href", "srcset", "action") and v]
        self.ids |= {v for k, v in attrs if k == "id"}
        self.open = dict(attrs) if tag == "script" else None

    def handle_data(self, data):
        if self.open is not None:
            self.scripts.append((self.open, data))
            self.open = None


def assert_closed(text):
    """A page with names that hold a script escapes them, runs its one script, and asks for nothing outside itself."""
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert" in text
    page = Page(text)
    (script,) = (s for attributes, s in page.scripts if "type" not in attributes)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = html.unescape(re.search(r'Content-Security-Policy" content="([^"]+)"', text).group(1))
    assert f"script-src 'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none'")
    assert page.links
    assert all(link.startswith("data:") or link.removeprefix("#") in page.ids for link in page.links)
    style = re.search(r"<style>(.*?)</style>", text, re.DOTALL).group(1)
    assert ("url(" in style, "@import" in style) == (False, False)


def text_read(text):
    """What is to be read, without tags, scripts, styles and pictures."""
    text = re.sub(r"<(script|style|svg).*?</\1>", " ", text, flags=re.S)
    return " ".join(re.sub(r"<[^>]*>", " ", text).split())
