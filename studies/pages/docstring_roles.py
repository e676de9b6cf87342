"""Roles of docstrings in the Python reference, a hook of mkdocs: names are shown without ``:func:`` before them."""

import re

ROLE_PATTERN = re.compile(r":(?:func|class|meth|mod|attr|data):(<code[^>]*>)(~?)([\w.]+)</code>")


def on_page_content(html: str, **_: object) -> str:
    """Names without their roles; after a tilde the last part alone."""
    return ROLE_PATTERN.sub(lambda m: f"{m[1]}{m[3].rpartition('.')[2] if m[2] else m[3]}</code>", html)
