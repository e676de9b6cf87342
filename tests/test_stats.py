"""``morphofold stats``: a model at every vertex of a study's maps on a template."""

import json
import re

import numpy as np
import pytest
from commands import refused

from morphofold.analysis import smooth
from morphofold.cli import main
from morphofold.errors import DoesNotApply, MissingPart, UnknownName
from morphofold.inference.spaces import find_space
from morphofold.inference.study import cluster_rows, fit_study, summary, write_result
from morphofold.io import read_morph, write_annotation, write_label, write_surface
from morphofold.report.pages.study_pages import effect_unit, stats_report
from morphofold.report.pictures.sheet import read_png
from morphofold.shapes import icosphere
from morphofold.surface import Regions, Surface
from morphofold.tables import read_table, write_table
from morphofold.words import number

VERTS, FACES = icosphere(3, radius=50.0)
SUBJECTS = [f"s{k:02}" for k in range(24)]
NORTH = VERTS[:, 2] > 30


@pytest.fixture
def study(tmp_path):
    """24 subjects on a ball of 642 vertices: age thins the north of the left side by 0.05 mm a year. s05 has no right
    side, and s07 no age; the south is no cortex."""
    folder = tmp_path / "study" / "spaces" / "ball" / "group"
    random = np.random.default_rng(1)
    age = random.uniform(20, 80, len(SUBJECTS))
    for place in ("surf", "label"):
        (folder / place).mkdir(parents=True)
    for hemi in ("lh", "rh"):
        write_surface(folder / "surf" / f"{hemi}.white", Surface(VERTS, FACES))
        write_label(folder / "label" / f"{hemi}.cortex.label", VERTS[:, 2] > -40, VERTS)
        regions = Regions(
            (VERTS[:, 2] > 0).astype(int), ("south", "north"), np.array([[9, 9, 9], [99, 9, 9]], np.uint8)
        )
        write_annotation(folder / "label" / f"{hemi}.aparc.annot", regions)
        maps = 0.5 * smooth(VERTS, FACES, random.standard_normal((len(VERTS), len(SUBJECTS))), 15.0).T
        maps += 2.5 - 0.05 * (hemi == "lh") * np.outer(age - 50, NORTH)
        if hemi == "rh":
            maps[5] = np.nan
        np.save(folder / f"{hemi}.cortical_thickness.npy", maps.astype(np.float32))
        np.save(folder / f"{hemi}.area.npy", np.full((len(SUBJECTS), len(VERTS)), 2.0, dtype=np.float32))
    rows = [{"participant_id": name, "lh": 1, "rh": int(name != "s05")} for name in SUBJECTS]
    write_table(folder / "participants.tsv", ("participant_id", "lh", "rh"), rows)
    (folder / "space.json").write_text("{}")
    people = [{"participant_id": n, "age": None if n == "s07" else a, "site": 1} for n, a in zip(SUBJECTS, age)]
    write_table(tmp_path / "study" / "participants.tsv", ("participant_id", "age", "site"), people)
    return tmp_path / "study"


def fitted(study, **options):
    space = find_space(study)
    return fit_study(space, study / "participants.tsv", "cortical_thickness ~ age", "age", permutations=199, **options)


def test_an_effect_is_found_on_its_side_and_in_its_place(study):
    found = fitted(study)
    assert found.design.left_out == ("s07",)
    assert found.without_maps == ("s05",)
    assert found.inference.df == 20
    n = len(VERTS)
    significant = found.inference.p_tfce <= 0.05
    assert significant[:n][VERTS[:, 2] > 35].mean() > 0.95
    assert significant[:n][VERTS[:, 2] < 15].mean() < 0.02
    assert significant[n:].mean() < 0.02
    np.testing.assert_allclose(found.inference.effect[:n][NORTH].mean(), -0.05, atol=0.01)
    off = VERTS[:, 2] <= -40
    assert np.isnan(found.inference.t[:n][off]).all()
    assert (found.counts[:n][off] == 0).all()
    assert (found.counts[:n][~off] == 22).all()


def test_results_say_what_they_are_in_a_line_without_arrays(study):
    found = fit_study(find_space(study), study / "participants.tsv", "cortical_thickness ~ age", "age", permutations=20)
    for what in (found, found.space, found.design, found.inference, found.mesh):
        assert re.match(rf"{type(what).__name__}\b", repr(what))
        assert "array" not in repr(what)
        assert len(repr(what)) < 300
    assert "cortical_thickness ~ age" in repr(found)
    assert f"{len(found.design.subjects)} subjects" in repr(found)


def test_one_hemisphere_keeps_the_subjects_of_the_other(study):
    found = fitted(study, hemis=("lh",))
    assert found.without_maps == ()
    assert len(found.design.subjects) == 23
    assert len(found.inference.t) == len(VERTS)


def test_subjects_of_different_blocks_are_not_exchanged(study):
    """Age is the site's, so exchanging within sites changes nothing, and nothing could be found."""
    table = study / "participants.tsv"
    head, *lines = table.read_text().splitlines()
    cells = [line.split("\t") for line in lines]
    for k, row in enumerate(cells):
        row[1], row[2] = str(20 + 10 * (k % 4)), f"site{k % 4}"
    table.write_text("\n".join(["\t".join(row) for row in [head.split("\t"), *cells]]) + "\n")
    with pytest.raises(DoesNotApply):
        fitted(study, blocks="site")


def test_the_first_cluster_has_its_peak_area_and_region(study):
    row = cluster_rows(fitted(study))[0]
    assert (row["hemi"], row["cluster"], row["region"], row["p"]) == ("lh", 1, "north", 1 / 200)
    assert NORTH[row["peak"]]
    np.testing.assert_allclose([row["x"], row["y"], row["z"]], VERTS[row["peak"]], atol=1e-4)
    assert row["t"] < -4
    assert row["area_mm2"] == pytest.approx(2.0 * NORTH.sum(), rel=0.3)  # areas are those of the subjects


def test_results_are_maps_a_table_and_a_summary(study, tmp_path):
    found = fitted(study)
    out = write_result(found, tmp_path / "out", [study / "participants.tsv"])
    n, said = len(VERTS), json.loads((out / "summary.json").read_text())
    effect = read_morph(out / "maps" / "rh.effect.shape.gii")
    np.testing.assert_allclose(effect, found.inference.effect[n:], rtol=1e-5)
    p = read_morph(out / "maps" / "lh.p_tfce")
    np.testing.assert_allclose(p, np.nan_to_num(found.inference.p_tfce[:n], nan=1.0), rtol=1e-6)
    cluster = read_morph(out / "maps" / "lh.cluster").astype(int)
    rows = read_table(out / "clusters.tsv", words=("hemi", "region"))
    assert (cluster == 1).sum() * 2.0 == pytest.approx(rows[0]["area_mm2"])
    assert said["vertices"] == {"all": 2 * n, "tested": int(np.isfinite(found.inference.t).sum())}
    assert said["left_out"] == {"value missing": ["s07"], "no maps": ["s05"]}
    assert said["smallest_p"]["p_tfce"] == 1 / 200
    again = write_result(fitted(study), tmp_path / "again", [study / "participants.tsv"])
    for file in out.rglob("*.*"):
        assert file.read_bytes() == (again / file.relative_to(out)).read_bytes(), file


def test_the_command_prints_what_it_found(study, tmp_path, capsys):
    argv = [
        "stats",
        str(study),
        "--model",
        "cortical_thickness ~ age",
        "--contrast",
        "age",
        "--permutations",
        "99",
        "-q",
    ]
    assert main([*argv, "-o", str(tmp_path / "age")]) == 0
    assert "lh north" in capsys.readouterr().out
    assert sorted(file.stem for file in (tmp_path / "age" / "figures").iterdir()) == [
        "effect",
        "p_height",
        "p_tfce",
        "r",
        "subjects",
    ]
    assert main([*argv, "-o", str(tmp_path / "age"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["permutations"] == 99
    mean = ["--model", "cortical_thickness ~ 1", "--contrast", "1"]
    assert (
        main(
            [
                "stats",
                str(study),
                *mean,
                "--hemi",
                "rh",
                "-o",
                str(tmp_path / "mean"),
                "-q",
                "--permutations",
                "9",
                "--no-report",
            ]
        )
        == 0
    )
    said = json.loads((tmp_path / "mean" / "summary.json").read_text())
    assert not (tmp_path / "mean" / "report.html").exists()
    assert (said["exchanged"], said["hemispheres"], len(said["subjects"])) == ("signs", ["rh"], 23)


@pytest.mark.parametrize(
    ("model", "contrast", "word"),
    [
        ("age", "age", "unknown-name"),
        ("height ~ age", "age", "cortical_thickness"),
        ("cortical_thickness ~ height", "height", "age, site"),
        ("cortical_thickness ~ age", "sex", "Intercept, age"),
        ("cortical_thickness ~ site", "site", "does-not-apply"),
        ("cortical_thickness ~ age + scale(age)", "age", "does-not-apply"),
        ("cortical_thickness ~ {open('x', 'w')}", "1", "not-readable"),
        ("cortical_thickness ~ age", "age = 3", "unknown-name"),
        ("cortical_thickness ~ bs(age, df=22)", "1", "does-not-apply"),
    ],
)
def test_what_can_not_be_tested_is_refused(study, tmp_path, capsys, model, contrast, word):
    out = tmp_path / "out"
    refused(capsys, ["stats", str(study), "--model", model, "--contrast", contrast, "-o", str(out), "-q"], word)
    assert not out.exists()


def test_a_study_without_one_space_is_refused(study, tmp_path):
    with pytest.raises(FileNotFoundError):
        find_space(tmp_path)
    with pytest.raises(FileNotFoundError):
        find_space(study, "fsaverage6")
    (study / "spaces" / "other" / "group").mkdir(parents=True)
    (study / "spaces" / "other" / "group" / "space.json").write_text("{}")
    with pytest.raises(UnknownName):
        find_space(study)
    assert find_space(study, "ball").subjects == tuple(SUBJECTS)


def test_a_subject_without_a_row_is_refused(study):
    table = study / "participants.tsv"
    table.write_text("".join(line for line in table.read_text().splitlines(True) if not line.startswith("s03")))
    with pytest.raises(MissingPart, match="s03"):
        fitted(study)


def test_the_page_has_the_clusters_and_escapes_names(study, tmp_path):
    table = study / "participants.tsv"
    table.write_text(table.read_text().replace("s05\t", "<b>s05\t"))
    people = study / "spaces" / "ball" / "group" / "participants.tsv"
    people.write_text(people.read_text().replace("s05\t", "<b>s05\t"))
    out = write_result(fitted(study), tmp_path / "out", report=stats_report)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "<td>north</td>" in page
    assert "&lt;b&gt;s05" in page
    assert "<b>s05" not in page
    assert "<script" not in page
    for file in (out / "figures").iterdir():
        assert read_png(file).std() > 10


def test_the_page_shows_unit_peak_design_and_interval(study, tmp_path, monkeypatch):
    drawn = {}
    monkeypatch.setattr(
        "morphofold.report.pages.study_pages.picture",
        lambda space, folder, what, maps, limits, words: drawn.update({what.key: (what, maps, limits)}) or {},
    )
    found = fitted(study)
    page = (write_result(found, tmp_path / "out", report=stats_report) / "report.html").read_text(encoding="utf-8")
    what, maps, limits = drawn["effect"]
    assert what.unit == "mm per year"
    assert limits[1] == -limits[0] == max(np.nanmax(np.abs(values)) for values in maps.values())
    chart = page[page.index('<svg class="chart"') : page.index("</svg>", page.index('<svg class="chart"'))]
    assert all(f"{name}:" in chart for name in found.design.subjects)
    assert "s07:" not in chart
    peak = found.inference.clusters[0]["peak"]
    half = found.inference.half_width[peak]
    low, high = (number(found.inference.effect[peak] + sign * half) for sign in (-1, 1))
    assert f"<td>{low} to {high}</td>" in page
    for name in found.design.columns:
        assert f'<th scope="row">{name}</th>' in page


@pytest.mark.parametrize(
    ("model", "contrast", "unit"),
    [
        ("age", "age", "mm per year"),
        ("center(age)", "center(age)", "mm per year"),
        ("center(age)", "1", "mm"),
        ("age + sex", "sex", "mm"),
        ("age", "Intercept + 30 * age", "mm"),
        ("age + iq", "iq", "mm per unit of iq"),
        ("age * sex", "age:sex", "mm per unit of age:sex[T.M]"),
    ],
)
def test_the_unit_of_an_effect_is_that_of_the_map_for_each_of_the_regressor(study, model, contrast, unit):
    rows = [
        {"participant_id": name, "age": 20 + k * k, "sex": "FM"[k % 2], "iq": 100 + 7 * (k % 5)}
        for k, name in enumerate(SUBJECTS)
    ]
    write_table(study / "participants.tsv", ("participant_id", "age", "sex", "iq"), rows)
    found = fit_study(
        find_space(study), study / "participants.tsv", f"cortical_thickness ~ {model}", contrast, permutations=1
    )
    assert effect_unit(found) == unit


def renamed(study, names, **columns):
    """The study with other names of subjects and columns of participants."""
    of_maps = study / "spaces" / "ball" / "group" / "participants.tsv"
    rows = [{**row, "participant_id": name} for row, name in zip(read_table(of_maps, ("participant_id",)), names)]
    write_table(of_maps, ("participant_id", "lh", "rh"), rows)
    people = [
        {"participant_id": name} | {key: values[k] for key, values in columns.items()} for k, name in enumerate(names)
    ]
    write_table(study / "participants.tsv", ("participant_id", *columns), people)


def test_sessions_of_a_person_are_exchanged_with_the_person(study):
    """What is the same in all sessions of a person by whole persons, what is not within them, and both say so."""
    persons = [f"p{k // 3}" for k in range(24)]
    names = [f"sub-{person}_ses-{k % 3}" for k, person in enumerate(persons)]
    random = np.random.default_rng(2)
    age, visit = np.repeat(random.uniform(20, 80, 8), 3).round(1).tolist(), [k % 3 for k in range(24)]
    renamed(study, names, age=age, visit=visit, person=persons)
    for model, contrast, whole in (("age", "age", True), ("age + visit", "visit", False)):
        model = f"cortical_thickness ~ {model}"
        table = study / "participants.tsv"
        usual, own = (
            fit_study(find_space(study), table, model, contrast, permutations=50, hemis=("lh",), **options)
            for options in ({}, {"blocks": "person", "whole": whole})
        )
        np.testing.assert_array_equal(usual.inference.p_tfce, own.inference.p_tfce)
        assert summary(usual)["exchanged"] == ("blocks" if whole else "subjects")
        assert summary(usual)["blocks"] == 8
        assert len(usual.design.remarks) == 1
        assert own.design.remarks == ()


def test_a_tiny_variance_group_is_remarked(study):
    for few, remarks in ((2, 1), (4, 1), (5, 0)):
        renamed(study, SUBJECTS, group=["a" if k < few else "b" for k in range(24)])
        found = fit_study(
            find_space(study),
            study / "participants.tsv",
            "cortical_thickness ~ group",
            "group",
            variance_groups="group",
            hemis=("lh",),
            permutations=9,
        )
        assert len(found.remarks) == remarks


def test_few_exchanges_and_unequal_variances_are_remarked(study, capsys, tmp_path):
    space, table = find_space(study), study / "participants.tsv"
    assert fitted(study).remarks == []
    people = read_table(table, ("participant_id",))
    write_table(
        table,
        ("participant_id", "age"),
        [{**row, "age": row["age"] if k < 4 else None} for k, row in enumerate(people)],
    )
    few = fit_study(space, table, "cortical_thickness ~ age", "age", hemis=("lh",), permutations=199)
    assert few.inference.possible == 24
    assert len(few.remarks) == 1
    group = [{"participant_id": name, "group": "ab"[k % 2]} for k, name in enumerate(SUBJECTS)]
    write_table(table, ("participant_id", "group"), group)
    file = space.folder / "lh.cortical_thickness.npy"
    maps = np.load(file)
    maps[::2] += 3 * (maps[::2] - maps[::2].mean(axis=0))
    np.save(file, maps)
    argv = ["stats", str(study), "--model", "cortical_thickness ~ group", "--contrast", "group", "--hemi", "lh"]
    argv += ["--permutations", "99", "-q", "--json", "-o", str(tmp_path / "out")]
    assert main(argv) == 0
    plain = json.loads(capsys.readouterr().out)
    assert (len(plain["remarks"]), plain["exchanged"], plain["variance_groups"]) == (1, "subjects", None)
    assert main([*argv, "--variance-groups", "group"]) == 0
    grouped = json.loads(capsys.readouterr().out)
    assert (grouped["remarks"], grouped["exchanged"], grouped["variance_groups"]) == ([], "signs", 2)


def test_without_a_table_of_the_study_that_of_cohort_beside_the_maps_is_taken(study, capsys, tmp_path):
    argv = ["stats", str(study), "--model", "cortical_thickness ~ age", "--contrast", "age", "--permutations", "9"]
    argv += ["--no-report", "-q", "--json", "-o", str(tmp_path / "age")]
    table, of_maps = study / "participants.tsv", study / "spaces" / "ball" / "group" / "participants.tsv"
    ages = {row["participant_id"]: row["age"] for row in read_table(table, ("participant_id",))}
    table.unlink()
    refused(capsys, argv, str(table))
    rows = read_table(of_maps, ("participant_id",))
    write_table(
        of_maps, ("participant_id", "age", "lh", "rh"), [{**row, "age": ages[row["participant_id"]]} for row in rows]
    )
    assert main(argv) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["inputs"][0]["path"] == str(of_maps)
    assert said["left_out"]["value missing"] == ["s07"]


def test_a_template_in_gifti_is_read(study):
    """As fs_LR is."""
    group = study / "spaces" / "ball" / "group"
    for hemi in ("lh", "rh"):
        (group / "surf" / f"{hemi}.white").unlink()
        write_surface(group / "surf" / f"{hemi}.white.surf.gii", Surface(VERTS, FACES))
    assert len(fitted(study).inference.t) == 2 * len(VERTS)


def test_what_is_printed_controls_no_terminal(study, capsys):
    for table in study.rglob("participants.tsv"):
        table.write_text(table.read_text().replace("s07", "s\x1b[31m\x9b7").replace("s03", "s\u202e3"))
    words = ["stats", str(study), "--model", "cortical_thickness ~ age", "--contrast", "age", "--permutations", "9"]
    assert main([*words, "-o", str(study / "out"), "--quiet", "--no-report"]) == 0
    printed = capsys.readouterr().out
    assert "s\\x1b[31m\\x9b7" in printed
    assert printed.replace("\n", "").isprintable()
