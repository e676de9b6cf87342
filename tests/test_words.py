"""Words of our own that no page, message or docstring uses: the field has better ones (CONTRIBUTING.md)."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("morphofold", "sim", "analysis", "studies")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
TEMPLATES = sorted((ROOT / "morphofold" / "report" / "templates").glob("*.html"))
#: a pattern, and the words to use
BETTER = {
    r"twins?": "coarser run, counterpart",
    r"altimeters?|altitudes?": "depth potential",
    r"hang(s|ing)? on": "depends on",
    r"(has|have) (its|their) say": "affects",
    r"ways along": "paths, geodesics",
    r"blind (gyri|gyrus|arms?|ends?)": "dead-end gyri",
    r"mended|mends?": "repaired",
    r"picking": "choosing",
    r"as the crow flies": "in a straight line",
    r"was calm|is calm|calm enough": "kinetic energy is small",
    r"passed nowhere through itself": "does not self-intersect",
    r"measuring room": "analysis",
    r"is sure of": "is known",
    r"of next to no": "almost zero",
}
#: code, and attributes in docstrings, are names, which stay as they are; so does what is generated from tests
CODE = re.compile(r"^```.*?^```|``[^`]*``|`[^`\n]*`|^ *[\w, ]+ : \w.*?$", re.S | re.M)
GENERATED = {"hard-cases.md"}
pytestmark = pytest.mark.skipif(not (ROOT / "docs").is_dir(), reason="needs a checkout")


def found(text):
    return {better: m[0] for words, better in BETTER.items() if (m := re.search(rf"\b({words})\b", text, re.I))}


@pytest.mark.parametrize("page", [p for p in PAGES if p.name not in GENERATED], ids=lambda p: p.name)
def test_a_page_uses_the_words_of_the_field(page):
    assert found(CODE.sub(" ", page.read_text(encoding="utf-8"))) == {}


@pytest.mark.parametrize("template", TEMPLATES, ids=lambda p: p.name)
def test_a_template_uses_the_words_of_the_field(template):
    assert found(template.read_text(encoding="utf-8")) == {}


@pytest.mark.parametrize("package", PACKAGES)
def test_messages_and_docstrings_use_the_words_of_the_field(package):
    """Strings of more than one word; columns and keys of one word keep their names."""
    wrong = {}
    for file in sorted((ROOT / package).rglob("*.py")):  # follows no symlinks
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value.strip():
                wrong |= {f"{file.name}:{node.lineno}": hit for hit in found(CODE.sub(" ", node.value)).values()}
    assert wrong == {}
