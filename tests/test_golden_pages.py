"""Six pages as text, one of each kind: ids, headings, sentences, tables, without pictures, scripts and exact digits.

After a change that is meant, ``MORPHOFOLD_RENEW_PAGES=1 pytest tests/test_golden_pages.py`` writes them again.
"""

import os
import re
from html import unescape
from itertools import zip_longest
from pathlib import Path

import numpy as np
import pytest
from made_groups import made_group
from made_measures import made_measures
from made_spaces import VERTS, write_space
from made_sweeps import made_sweep

from morphofold import __version__
from morphofold.cli import main
from morphofold.comparison import compare
from morphofold.group.map_statistics import fit_study, write_result
from morphofold.group.spaces import find_space
from morphofold.group_pages.cohort_page import group_report
from morphofold.group_pages.phase_page import phase_report
from morphofold.group_pages.stats_pages import stats_report
from morphofold.io import sample_path
from morphofold.report import analysis_report
from morphofold.tables import write_table

GOLDEN = Path(__file__).parent / "golden"
RENEW = "MORPHOFOLD_RENEW_PAGES"


#: what is left out of a page, and what begins a line of its own
LINES = {
    r'<(script|style).*?</\1>|<p class="versions">.*?</p>': "",
    r'<svg[^>]*aria-label="([^"]*)".*?</svg>|<img[^>]*alt="([^"]*)">': r"\n[\1\2]\n",
    r"<svg.*?</svg>": "",
    r"<h([123])[^>]*>": r"\n\1. ",
    r'<section[^>]*?(?: id="([^"]*)")?[^>]*>': r"\n--- \1",
    r"<t[dh]\b[^>]*>": " | ",
    r"<(span|code class)[^>]*>": " ",
    r"</?(title|h.|p|tr|summary|li|figcaption|legend|label|button|option|textarea)\b[^>]*>": "\n",
    r"<[^>]*>": "",
    r"[0-9a-f]{64}": "DIGEST",
    r"\d\.\d*0\b": lambda match: match[0].rstrip("0").rstrip("."),  # 1.00 and 1.000 are the same to round-off
}


def lines_of(page, folder):
    """Sections with ids, headings, sentences, labels and rows of tables, a line each."""
    text = " ".join(page.read_text(encoding="utf-8").split())
    text = text.replace(str(folder), "FOLDER").replace(str(sample_path()), "SAMPLES")
    text = text.replace(f"morphofold {__version__}", "morphofold VERSION")
    for pattern, line in LINES.items():
        text = re.sub(pattern, line, text, flags=re.DOTALL)
    return [" ".join(unescape(line).split()) for line in text.splitlines() if line.strip()]


def analysis(folder):
    hemispheres = [made_measures(hemi, name="person", origin="FreeSurfer") for hemi in ("lh", "rh")]
    for m in hemispheres:
        m.regions[0].update(gyral_thickness_mm=8.0)  # off the line of the others: p would be round-off
    hemispheres[0].notes.update(cortex_mask="label was lost.", accuracy="the mesh is fine.", H="said of a map.")
    hemispheres[1].scalars.update(n_hinges=7, area_pial_mm2=20_000.0)
    return analysis_report(hemispheres, folder / "report.html", failed={"rh": "it is torn"}, inputs=[])


def comparison(folder):
    stages = [made_measures(origin="simulation", name="model", info={"g": g, "name": "model"}) for g in (1.0, 1.5, 2.0)]
    for m, index in zip(stages, (1.0, 2.0, 3.0)):
        m.scalars.update(gyrification_index=index, area_pial_mm2=20_000.0 * index)
        m.regions[0].update(gyral_thickness_mm=8.0)
        m.cortex.info.update(law="isotropic", mu_ratio=3.0)
    brain = made_measures("rh", name="brain", origin="FreeSurfer", regions=False)
    brain.scalars.update(gyrification_index=2.5, area_pial_mm2=90_000.0)
    return compare({"model": stages[-1], "person": brain}, growth={"model": stages}).report(folder / "out")


def group(folder):
    thickness = made_group(20).scalars["mean_cortical_thickness_mm"].copy()
    thickness[4, 0] = 7.77
    failures = [{"subject": "sub-00003", "hemi": "rh", "reason": "torn", "log": "logs/sub-00003.log"}]
    notes = {"remarks": {"sub-00001": ["lh: coarse."]}, "same": [["sub-00001", "sub-00005"]], "simulated": 2}
    return group_report(made_group(20, failures=failures, mean_cortical_thickness_mm=thickness, **notes), folder)


def sweep(folder):
    return phase_report(made_sweep(("cortex_thickness=1,2", "growth.final=1.2,1.8"), broken=[((0, 0), 0)]), folder)


def stats(folder):
    age = np.linspace(20, 80, 12)
    thickness = 2.5 - 0.05 * np.outer(age - 50, VERTS[:, 2] > 30) + np.random.default_rng(1).random((12, len(VERTS)))
    names = write_space(
        folder, {"lh.cortical_thickness": thickness, "lh.area": np.full_like(thickness, 2)}, hemis=["lh"]
    )
    table = folder / "participants.tsv"
    write_table(table, ("participant_id", "age"), [{"participant_id": n, "age": a} for n, a in zip(names, age)])
    found = fit_study(find_space(folder), table, "cortical_thickness ~ age", "age", permutations=49, hemis=("lh",))
    return write_result(found, folder / "out", [table], report=stats_report) / "report.html"


def unfold(folder):
    assert main(["unfold", str(sample_path("fsaverage5")), "--hemi", "lh", "-q", "-o", "out"]) == 0
    return folder / "out" / "report.html"


@pytest.mark.parametrize("write", [analysis, comparison, group, sweep, stats, unfold], ids=lambda f: f.__name__)
def test_a_page_is_as_it_was(write, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines, file = lines_of(write(tmp_path), tmp_path), GOLDEN / f"{write.__name__}.txt"
    if os.environ.get(RENEW):
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    pairs = zip_longest(lines, file.read_text(encoding="utf-8").splitlines())
    for k, (line, golden) in enumerate(pairs, start=1):
        assert line == golden, f"line {k} of the page {write.__name__} differs; renew it if that is meant ({RENEW}=1)"
