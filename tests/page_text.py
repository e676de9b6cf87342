"""What a page asks for, and what is to be read on it."""

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


def text_read(text):
    """What is to be read, without tags, scripts, styles and pictures."""
    text = re.sub(r"<(script|style|svg).*?</\1>", " ", text, flags=re.S)
    return " ".join(re.sub(r"<[^>]*>", " ", text).split())
