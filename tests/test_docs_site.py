"""Pages: links lead somewhere, examples run, commands are those of the parser, the site builds."""

import contextlib
import html
import importlib.util
import inspect
import io
import json
import os
import pkgutil
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from matplotlib import pyplot

import morphofold as mf
from morphofold import analysis
from morphofold.analysis.measures_result import SCALARS
from morphofold.cli import COMMANDS, app, parsed
from morphofold.sim.effects import build_effects
from morphofold.sim.scene.scene_files import load_scene, scene_names
from morphofold.studies import bench
from morphofold.studies.pages import command_pages, descriptors, site_math

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="needs a checkout")

PAGES = [page for page in (ROOT / "README.md", *sorted(DOCS.rglob("*.md"))) if DOCS.is_dir()]
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
#: pages whose Python runs, those that take longer marked
LONG = ("docs/tables.md", "docs/tutorial-neuroimager.md", "docs/tutorial-mechanician.md")
RUN = ["docs/extending.md", *(pytest.param(page, marks=pytest.mark.slow) for page in LONG)]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.S | re.M)


def fences(name, *kinds):
    """(kind, text) of the fences of a page, in order."""
    all_of_page = FENCE.findall((ROOT / name).read_text(encoding="utf-8"))
    return [(kind, text) for kind, text in all_of_page if not kinds or kind in kinds]


def without_fences(path):
    return re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.S | re.M)


def anchors(path):
    """Anchors of the headings of a page, as a forge makes them."""
    heads = re.findall(r"^#+ (.*)$", without_fences(path), re.M)
    return {re.sub(r"[^\w\- ]", "", head.replace("`", "").lower()).replace(" ", "-") for head in heads}


# --- how much there is to read


def test_pages_are_short_enough_to_be_read():
    """Words of prose, code and tables; the references by code, key and step may be longer."""
    count = {
        name: sum(bool(re.search(r"\w", word)) for word in (ROOT / name).read_text("utf-8").split()) for name in NAMES
    }
    longer = {"docs/scenes.md": 3300, "docs/solver.md": 2600, "docs/messages.md": 2200}
    assert {name: n for name, n in count.items() if n > longer.get(name, 2000)} == {}
    assert sum(count.values()) <= 50_000


def test_descriptions_for_other_programs_are_what_the_parser_says(tmp_path):
    descriptors.write_descriptors(tmp_path)
    for name in ("analyze.boutiques.json", "Snakefile"):
        text = (ROOT / "descriptors" / name).read_text("utf-8")
        assert (tmp_path / name).read_text("utf-8") == text, (
            "renew: python -m morphofold.studies.pages.descriptors descriptors"
        )
    boutiques = json.loads((tmp_path / "analyze.boutiques.json").read_text("utf-8"))
    snakefile = (tmp_path / "Snakefile").read_text("utf-8")
    keys = [entry["value-key"] for entry in boutiques["inputs"]]
    assert boutiques["command-line"].split()[2:] == keys
    assert len(set(keys)) == len(keys) > 15
    flags = [entry["command-line-flag"] for entry in boutiques["inputs"] if "command-line-flag" in entry]
    values = {"lh": ["lh"], "Number": ["1"], "String": ["x"], "File": ["x"], "Flag": []}
    for entry in boutiques["inputs"][1:]:  # the parser takes every option as it is described
        chosen = entry["value-choices"][:1] if "value-choices" in entry else values[entry["type"]]
        assert parsed(app(), ["analyze", "folder", entry["command-line-flag"], *chosen])
    names = re.findall(r"'([\w-]+)'", "".join(re.findall(r"^(?:FLAGS|WITH_VALUE) = .*$", snakefile, re.M)))
    assert {f"--{name.replace('_', '-')}" for name in names} < {*flags}
    assert all(name.isidentifier() for name in names)


# --- links


def test_every_link_of_a_page_leads_somewhere_and_every_picture_is_on_a_page():
    broken = []
    for page in PAGES:
        prose = re.sub(r"`[^`\n]*`", "", without_fences(page))  # brackets of code are no links
        for link in re.findall(r"\]\(([^)\s]+)\)", prose):
            path, _, anchor = link.partition("#")
            target = (page.parent / path).resolve() if path else page
            leads = target.exists() and (not anchor or anchor in anchors(target))
            if not leads and not re.match(r"[a-z]+:", link):
                broken.append((page.name, link))
    assert not broken
    texts = [page.read_text(encoding="utf-8") for page in PAGES]
    assert [p.name for p in DOCS.glob("*.png") if not any(f"{p.name})" in text for text in texts)] == []


# --- examples


@pytest.mark.parametrize("name", RUN)
def test_the_python_of_a_page_runs_and_prints_what_the_page_says(name, tmp_path, monkeypatch):
    """One namespace for a page; a fence of text right after Python is what it prints."""
    monkeypatch.chdir(tmp_path)
    space, printed = {"__name__": "page"}, None
    write_scenes(name, tmp_path)
    for kind, text in fences(name):
        if kind == "python":
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                exec(compile(text, f"{name}, after {text.splitlines()[0]!r}", "exec"), space)
            printed = out.getvalue()
        elif kind == "text" and printed is not None:
            assert printed == text, f"{name} says {text!r}, its code prints {printed!r}"
            printed = None
        else:
            printed = None
    pyplot.close("all")


def write_scenes(name, folder):
    """The scenes of a page: a fence of TOML whose first line is a comment with the name of a file."""
    matches = {text: re.match(r"# (\S+\.toml)\n", text) for _, text in fences(name, "toml")}
    files = {folder / match[1]: text for text, match in matches.items() if match}
    for file, text in files.items():
        file.write_text(text, encoding="utf-8")
        assert load_scene(file).name


@pytest.mark.parametrize("name", [name for name in NAMES if fences(name, "sh", "toml")])
def test_the_scenes_and_commands_of_a_page_are_understood(name, tmp_path, monkeypatch):
    """Settings of the commands too, where their scene is built in or one of the page's."""
    write_scenes(name, tmp_path)
    monkeypatch.chdir(tmp_path)
    for line in "".join(text.replace("\\\n", " ") for _, text in fences(name, "sh")).splitlines():
        argv = shlex.split(line.partition(" > ")[0], comments=True)
        if argv[:1] == ["morphofold"] and argv[1:] != ["--version"]:
            options = vars(parsed(app(), argv[1:]))  # leaves the test with what is wrong
            scene = options.get("scene") or options.get("body")
            if scene and (scene in scene_names() or (tmp_path / scene).is_file()):
                build_effects(load_scene(scene, options.get("set") or ()))
        if argv[:3] == ["python3", "run.py", "bench"]:
            parsed(bench.app(), argv[3:])
        if argv[:2] == ["python", "-m"] and argv[2].startswith("morphofold."):
            assert importlib.util.find_spec(argv[2])


def with_change(text, change):
    """A file with the lines that a diff adds, without those it takes; each piece must stand at one place."""
    for piece in re.split(r"^@@\n", change, flags=re.M)[1:]:
        before, after = ("".join(f"{l[1:]}\n" for l in piece.splitlines() if l[0] in marks) for marks in (" -", " +"))
        assert text.count(before) == 1, before
        text = text.replace(before, after)
    return text


ADDED = """
from pathlib import Path
import numpy as np
import morphofold as mf
from morphofold.group.subjects import find_subjects
from morphofold.io import read_surface, write_surface
from morphofold.report import analysis_report
from morphofold.studies.folded_ball import folded_ball
from morphofold.quantities import quantity
from morphofold.sim.effects import build_effects
from morphofold.sim.scene.scene_files import load_scene
effects = build_effects(load_scene("fig5", ["effects.pressure={pressure=0.5}"]))
assert "pressure" in {effect.name for effect in effects}
material = load_scene("fig5", ["material.model=demiray", "material.stiffening=2"]).material
assert str(material.build()) == "Demiray(a=2.0)"
ball = folded_ball(1000)
write_surface("ball.tri", ball.pial)
again = read_surface("ball.tri")
assert np.array_equal(again.verts, ball.pial.verts) and np.array_equal(again.faces, ball.faces)
Path("study/anna/visit1").mkdir(parents=True)
for kind, name in (("white", "inner"), ("pial", "outer")):
    write_surface(f"study/anna/visit1/anna_right_{name}.ply", getattr(ball, kind))
cortex = mf.read_cortex("study/anna/visit1", hemi="rh")
assert np.allclose(cortex.white.verts, ball.white.verts, atol=1e-4) and cortex.name == "anna_visit1"
assert list(find_subjects(Path("study"))[0]) == ["anna_visit1"]
measures = mf.measure(cortex)
assert measures.maps["surface_ratio"].min() > 0.5 and quantity("surface_ratio").label == "Surface ratio"
assert "Crests between hinges" in analysis_report([measures], "report.html").read_text()
print(mf.__file__)
"""


def test_what_the_page_adds_is_one_file_each_and_a_line_elsewhere_at_most(tmp_path):
    """An effect, a material, a measure, a format, a layout of folders and a section of a page."""
    for room in ("morphofold", "sim", "analysis", "studies", "data_samples"):
        shutil.copytree(ROOT / room, tmp_path / room, symlinks=True)  # with what is compiled
    (tmp_path / "pyproject.toml").touch()  # what a checkout is known by
    page = (DOCS / "extending.md").read_text(encoding="utf-8")
    files = [text for _, text in fences("docs/extending.md", "python", "html") if text.startswith(('"""', "{%"))]
    names = re.findall(r"The whole file,\s`([^`]*)`", page)
    assert not any((ROOT / name).exists() for name in names)
    for name, text in zip(names, files, strict=True):
        (tmp_path / name).write_text(text, encoding="utf-8")
    for _, change in fences("docs/extending.md", "diff"):
        file = tmp_path / re.search(r"^--- a/(\S+)$", change, re.M)[1]
        file.write_text(with_change(file.read_text(encoding="utf-8"), change), encoding="utf-8")
    done = subprocess.run([sys.executable, "-c", ADDED], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(tmp_path / "morphofold" / "__init__.py")


# --- pages of commands


def test_the_pages_of_commands_are_what_the_parser_says(tmp_path):
    folder = shutil.copytree(DOCS / "commands", tmp_path / "commands")
    command_pages.write_pages(folder)
    renew = "renew them: python -m morphofold.studies.pages.command_pages docs/commands"
    for page in sorted(folder.glob("*.md")):
        assert page.read_text(encoding="utf-8") == (DOCS / "commands" / page.name).read_text(encoding="utf-8"), renew
    assert {page.stem for page in folder.glob("*.md")} == {*COMMANDS, "index"}

    (folder / "demo.md").unlink()
    with pytest.raises(FileNotFoundError, match=r"demo\.md"):
        command_pages.write_pages(folder)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_page_of_a_command_has_what_it_reads_what_it_writes_and_an_example(name):
    text = (DOCS / "commands" / f"{name}.md").read_text(encoding="utf-8")
    assert ("**Reads**" in text, "**Writes**" in text) == (True, True)
    assert re.search(f"^morphofold {name}", text, re.M)


# --- measures


MEASURES = DOCS / "measures"


@pytest.mark.parametrize("page", sorted(p.name for p in MEASURES.glob("*.md") if p.name != "index.md"))
def test_a_measure_has_a_definition_a_unit_a_picture_limits_and_a_source(page):
    text = (MEASURES / page).read_text(encoding="utf-8")
    for part in ("Where", "Definition", "Unit", "How well it is known", "Limits", "Source"):
        assert text.count(f"\n**{part}.** ") == 1, part
    assert re.search(r"^!\[.*\]\(", text, re.M)
    names = re.findall(r"`analysis\.([\w.]+)", text)
    assert names
    assert all(hasattr(analysis, name) or importlib.util.find_spec(f"morphofold.analysis.{name}") for name in names)


def test_every_number_map_and_page_is_in_the_table_of_measures():
    text = (MEASURES / "index.md").read_text(encoding="utf-8").split("\n## ")[0]
    rows = [line.split("|") for line in text.splitlines() if line.startswith("|")][2:]
    maps, numbers = (set(re.findall(r"`(\w+)`", " ".join(row[k] for row in rows))) for k in (2, 3))
    assert numbers == set(SCALARS)
    assert maps == {*analysis.measure(mf.read_cortex(mf.sample_path("fsaverage5"))).maps}
    linked = {page for row in rows for page in re.findall(r"\]\(([\w-]+\.md)", row[1])}
    assert linked == {p.name for p in MEASURES.glob("*.md")} - {"index.md"}


# --- the site


def test_formulas_become_mathml_and_code_stays():
    page = "Take $x_1$ and $`\\mu_2`$, not `$HOME$`.\n\n```math\nx^2\n```\n\n```sh\necho $a$\n```\n"
    text, formulas = site_math.take_out(page)
    assert [html.unescape(re.sub("<[^>]*>", "", formula)) for formula in formulas] == ["x1", "μ2", "x2"]
    assert ['display="block"' in formula for formula in formulas] == [False, False, True]
    assert ("`$HOME$`" in text, "echo $a$" in text, "```math" in text) == (True, True, False)


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_fetches_nothing(tmp_path):
    for package in ("mkdocs", "material", "latex2mathml", "mkdocstrings"):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed: pip install -e .[docs]")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(tmp_path / "site")]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=quiet)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    pages = {p.relative_to(tmp_path / "site").as_posix(): p.read_text("utf-8") for p in tmp_path.rglob("*.html")}
    assert {name.removeprefix("docs/").replace(".md", ".html") for name in NAMES[1:]} <= set(pages)
    for name, text in pages.items():
        assert not re.findall(r"<(?:script|img|link|iframe)\b[^>]*(?:src|href)=\"?(?:https?:)?//", text), name
        assert "OF-PAGE" not in text, name
    assert pages["theory.html"].count("<math") > 50
    assert {"gallery.html", "gallery/curvature_of_a_torus.html", "pages-to-try.html"} <= set(pages)


def test_the_reference_has_every_public_name():
    text = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md"))
    documented = set(re.findall(r"^::: ([\w.]+)$", text, re.M))
    for name in ("", ".analysis", ".sim.theory", ".comparison", ".forecasts", ".io", ".results", ".report"):
        module = importlib.import_module(f"morphofold{name}")
        for public in module.__all__:
            home = getattr(getattr(module, public), "__module__", None) or module.__name__
            assert public.startswith("__") or {f"{home}.{public}", f"{module.__name__}.{public}"} & documented, public


def test_every_name_of_the_reference_exists_and_no_class_prints_its_address_in_memory():
    bare = []
    for page in (DOCS / "api").glob("*.md"):
        for name in re.findall(r"^::: ([\w.]+)$", page.read_text(encoding="utf-8"), re.M):
            public = pkgutil.resolve_name(name)
            if inspect.isclass(public) and public.__repr__ is object.__repr__ and public.__name__ != "Effect":
                bare.append(name)
    assert bare == []


# --- numbers that pages name and no other test holds


def test_a_person_is_folded_as_the_tutorial_says_and_the_average_has_as_many_hinges_as_peers_says():
    expected = float(re.search(r"gyrification index\s+of (\d\.\d+)", (DOCS / "tutorial-neuroimager.md").read_text())[1])
    person = mf.read_cortex(mf.sample_path("S1"), hemi="lh").pial
    assert analysis.gyrification_index(person.verts, person.faces) == pytest.approx(expected, abs=0.005)
    averages = [mf.read_cortex(mf.sample_path("fsaverage5"), hemi=hemi) for hemi in ("lh", "rh")]
    numbers = sorted(len(analysis.hinges(analysis.gyral_graph(cortex))) for cortex in averages)
    expected = re.search(r"(\d+) to (\d+) hinges a hemisphere", (DOCS / "peers.md").read_text())
    assert [str(n) for n in numbers] == [*expected.groups()]
