"""What a release says of itself: the same in every file, and no placeholder is left when it is published."""

import re
import tomllib
from pathlib import Path

import pytest

import morphofold

ROOT = Path(__file__).resolve().parent.parent
pytestmark = pytest.mark.skipif(not (ROOT / "conda").is_dir(), reason="needs a checkout")
CONDA_NAMES = {"matplotlib": "matplotlib-base"}


def text_of(name):
    return (ROOT / name).read_text("utf-8")


def project():
    return tomllib.loads(text_of("pyproject.toml"))["project"]


def test_the_version_is_the_same_everywhere():
    versions = {
        "pyproject.toml": project()["version"],
        "CITATION.cff": re.search(r"^version: (.+)$", text_of("CITATION.cff"), re.M)[1],
        "conda/recipe.yaml": re.search(r'^  version: "(.+)"$', text_of("conda/recipe.yaml"), re.M)[1],
    }
    assert set(versions.values()) == {morphofold.__version__}


def test_conda_needs_what_pip_needs():
    _, _, after = text_of("conda/recipe.yaml").partition("  run:\n")
    conda = dict(re.findall(r"^    - ([\w-]+) >=([\d.]+)$", after, re.M))
    assert conda.pop("python") == project()["requires-python"].removeprefix(">=")
    pip = dict(re.fullmatch(r"([\w-]+)>=([\d.]+?)(?:\.post\d+)?", line).groups() for line in project()["dependencies"])
    assert conda == {CONDA_NAMES.get(name, name): bound for name, bound in pip.items()}


def test_what_a_package_index_shows_has_absolute_links():
    links = re.findall(r"\]\(([^)]+)\)", text_of(project()["readme"]))
    assert links
    assert all(link.startswith("https://") for link in links)


@pytest.mark.release
@pytest.mark.parametrize("name", ["CITATION.cff", "paper/paper.md", "pyproject.toml", "PYPI.md", "README.md"])
def test_no_placeholder_is_left(name):
    assert not re.search(r"OWNER|fill in before the release", text_of(name))


@pytest.mark.release
def test_the_changelog_begins_with_this_version_and_its_date():
    date = re.search(r"^date-released: (\S+)$", text_of("CITATION.cff"), re.M)[1]
    assert re.search(r"^## (.+)$", text_of("CHANGELOG.md"), re.M)[1] == f"{morphofold.__version__} - {date}"
