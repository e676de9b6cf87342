"""Roles of docstrings in the Python reference, a hook of mkdocs: names are shown without ``:func:`` before them."""

import re

ROLE_REGEX = re.compile(r":(?:func|class|meth|mod|attr|data):(<code[^>]*>)(~?)([\w.]+)</code>")


def on_page_content(html: str, **_: object) -> str:
    """Names without their roles; after a tilde the last part alone."""
    return ROLE_REGEX.sub(lambda role: f"{role[1]}{role[3].rpartition('.')[2] if role[2] else role[3]}</code>", html)
