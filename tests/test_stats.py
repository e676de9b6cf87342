"""``morphofold stats``: a model at every vertex of a study's maps on a template."""

import json
import shutil

import numpy as np
import pytest
from commands import refused
from made_spaces import FACES, VERTS, write_space

from morphofold.analysis import smooth
from morphofold.cli import main
from morphofold.errors import UnknownName
from morphofold.group.spaces import find_space
from morphofold.group.study import cluster_rows, fit_study, summary, write_result
from morphofold.group_pages.study_pages import effect_unit, stats_report
from morphofold.io import read_morph, write_surface
from morphofold.report.pictures.sheet import read_png
from morphofold.surface import Surface
from morphofold.tables import read_table, write_table
from morphofold.words import number

OF_MAPS = "spaces/ball/group/participants.tsv"
SUBJECTS = [f"s{k:02}" for k in range(24)]
NORTH = VERTS[:, 2] > 30


@pytest.fixture(scope="module")
def study_once(tmp_path_factory):
    """24 subjects on a ball of 642 vertices: age thins the north of the left side by 0.05 mm a year. s05 has no right
    side, and s07 no age; the south is no cortex."""
    study = tmp_path_factory.mktemp("stats") / "study"
    random = np.random.default_rng(1)
    age = random.uniform(20, 80, len(SUBJECTS))
    maps = {}
    for hemi in ("lh", "rh"):
        thickness = 0.5 * smooth(VERTS, FACES, random.standard_normal((len(VERTS), len(SUBJECTS))), 15.0).T
        maps[f"{hemi}.cortical_thickness"] = 2.5 + thickness - 0.05 * (hemi == "lh") * np.outer(age - 50, NORTH)
        maps[f"{hemi}.area"] = np.full_like(thickness, 2.0)
    maps["rh.cortical_thickness"][5] = np.nan
    write_space(study, maps)
    table = study / OF_MAPS
    table.write_text(table.read_text().replace("s05\t1\t1", "s05\t1\t0"))
    people(study, age=[None if name == "s07" else a for name, a in zip(SUBJECTS, age)], site=[1] * len(SUBJECTS))
    return study


@pytest.fixture
def study(study_once, tmp_path):
    """A copy that a test may change."""
    return shutil.copytree(study_once, tmp_path / "study")


@pytest.fixture(scope="module")
def result(study_once):
    return fitted(study_once)


def people(study, names=SUBJECTS, **columns):
    """Write the table of participants."""
    rows = [dict(zip(("participant_id", *columns), row)) for row in zip(names, *columns.values())]
    write_table(study / "participants.tsv", ("participant_id", *columns), rows)


def fitted(study, model="age", contrast="age", permutations=199, **options):
    formula = f"cortical_thickness ~ {model}"
    table = study / "participants.tsv"
    return fit_study(find_space(study), table, formula, contrast, permutations=permutations, **options)


def command(study, *words, model="age", contrast="age"):
    return ["stats", str(study), "--model", f"cortical_thickness ~ {model}", "--contrast", contrast, "-q", *words]


def test_an_effect_is_found_on_its_side_and_in_its_place(result):
    assert result.design.left_out == ("s07",)
    assert result.without_maps == ("s05",)
    assert result.inference.df == 20
    n = len(VERTS)
    significant = result.inference.p_tfce <= 0.05
    assert significant[:n][VERTS[:, 2] > 35].mean() > 0.95
    assert significant[:n][VERTS[:, 2] < 15].mean() < 0.02
    assert significant[n:].mean() < 0.02
    np.testing.assert_allclose(result.inference.effect[:n][NORTH].mean(), -0.05, atol=0.01)
    off = VERTS[:, 2] <= -40
    assert np.isnan(result.inference.t[:n][off]).all()
    assert (result.counts[:n][off] == 0).all()
    assert (result.counts[:n][~off] == 22).all()
    assert result.remarks == []


def test_one_hemisphere_keeps_the_subjects_of_the_other(study_once):
    left = fitted(study_once, hemis=("lh",), permutations=9)
    assert left.without_maps == ()
    assert len(left.design.subjects) == 23
    assert len(left.inference.t) == len(VERTS)


def test_the_first_cluster_has_its_peak_area_and_region(result):
    row = cluster_rows(result)[0]
    assert (row["hemi"], row["cluster"], row["region"], row["p"]) == ("lh", 1, "north", 1 / 200)
    assert NORTH[row["peak"]]
    np.testing.assert_allclose([row["x"], row["y"], row["z"]], VERTS[row["peak"]], atol=1e-4)
    assert row["t"] < -4
    assert row["area_mm2"] == pytest.approx(2.0 * NORTH.sum(), rel=0.3)  # areas are those of the subjects


def test_results_are_maps_a_table_and_a_summary(result, study_once, tmp_path):
    table = study_once / "participants.tsv"
    out = write_result(result, tmp_path / "out", [table])
    n, said = len(VERTS), json.loads((out / "summary.json").read_text())
    effect = read_morph(out / "maps" / "rh.effect.shape.gii")
    np.testing.assert_allclose(effect, result.inference.effect[n:], rtol=1e-5)
    p = read_morph(out / "maps" / "lh.p_tfce")
    np.testing.assert_allclose(p, np.nan_to_num(result.inference.p_tfce[:n], nan=1.0), rtol=1e-6)
    cluster = read_morph(out / "maps" / "lh.cluster").astype(int)
    rows = read_table(out / "clusters.tsv", words=("hemi", "region"))
    assert (cluster == 1).sum() * 2.0 == pytest.approx(rows[0]["area_mm2"])
    assert said["vertices"] == {"all": 2 * n, "tested": int(np.isfinite(result.inference.t).sum())}
    assert said["left_out"] == {"value missing": ["s07"], "no maps": ["s05"]}
    assert said["smallest_p"]["p_tfce"] == 1 / 200
    again = write_result(fitted(study_once), tmp_path / "again", [table])
    for file in out.rglob("*.*"):
        assert file.read_bytes() == (again / file.relative_to(out)).read_bytes(), file


def test_the_command_writes_and_prints_what_it_found(study, tmp_path, capsys):
    for table in study.rglob("participants.tsv"):
        table.write_text(table.read_text().replace("s07", "s\x1b[31m\x9b7").replace("s03", "s\u202e3"))
    assert main(command(study, "--permutations", "99", "-o", str(tmp_path / "age"))) == 0
    printed = capsys.readouterr().out
    assert "lh north" in printed
    assert "s\\x1b[31m\\x9b7" in printed
    assert printed.replace("\n", "").isprintable()
    names = {file.stem for file in (tmp_path / "age" / "figures").iterdir()}
    assert names == {"effect", "p_height", "p_tfce", "r", "subjects"}
    argv = ["--hemi", "rh", "-o", str(tmp_path / "mean"), "--permutations", "9", "--no-report", "--json"]
    assert main(command(study, *argv, model="1", contrast="1")) == 0
    said = json.loads(capsys.readouterr().out)
    assert not (tmp_path / "mean" / "report.html").exists()
    assert (said["exchanged"], said["hemispheres"], len(said["subjects"])) == ("signs", ["rh"], 23)
    assert said["permutations"] == 9


@pytest.mark.parametrize(
    ("model", "contrast", "code"),
    [
        ("height ~ age", "age", "unknown-name"),
        ("cortical_thickness ~ site", "site", "does-not-apply"),
        ("cortical_thickness ~ {open('x', 'w')}", "1", "not-readable"),
        ("cortical_thickness ~ bs(age, df=22)", "1", "does-not-apply"),
    ],
)
def test_what_can_not_be_tested_is_refused(study_once, cwd, capsys, model, contrast, code):
    refused(
        capsys, ["stats", str(study_once), "--model", model, "--contrast", contrast, "-o", "out", "-q"], f"[{code}]"
    )
    assert list(cwd.iterdir()) == []


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


def test_the_page_escapes_names(study, tmp_path):
    for table in study.rglob("participants.tsv"):
        table.write_text(table.read_text().replace("s05\t", "<b>s05\t"))
    out = write_result(fitted(study, permutations=9), tmp_path / "out", report=stats_report)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "&lt;b&gt;s05" in page
    assert "<b>s05" not in page
    assert "<script" not in page
    for file in (out / "figures").iterdir():
        assert read_png(file).std() > 10


def test_the_page_shows_limits_subjects_and_the_interval_of_the_peak(result, tmp_path, monkeypatch):
    drawn = {}
    monkeypatch.setattr(
        "morphofold.group_pages.study_pages.picture",
        lambda space, folder, what, maps: drawn.update({what.key: (maps, what.limits)}) or {},
    )
    page = (write_result(result, tmp_path / "out", report=stats_report) / "report.html").read_text(encoding="utf-8")
    maps, limits = drawn["effect"]
    assert limits[1] == -limits[0] == max(np.nanmax(np.abs(values)) for values in maps.values())
    chart = page[page.index('<svg class="chart"') : page.index("</svg>", page.index('<svg class="chart"'))]
    assert all(f"{name}:" in chart for name in result.design.subjects)
    assert "s07:" not in chart
    peak = result.inference.clusters[0]["peak"]
    half = result.inference.half_width[peak]
    low, high = (number(result.inference.effect[peak] + sign * half) for sign in (-1, 1))
    assert f"<td>{low} to {high}</td>" in page


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
    count = range(len(SUBJECTS))
    people(
        study, age=[20 + k * k for k in count], sex=["FM"[k % 2] for k in count], iq=[100 + 7 * (k % 5) for k in count]
    )
    assert effect_unit(fitted(study, model, contrast, permutations=1)) == unit


def test_sessions_of_a_person_are_exchanged_with_the_person(study):
    """What is the same in all sessions of a person by whole persons, what is not within them, and both say so."""
    persons = [f"p{k // 3}" for k in range(24)]
    names = [f"sub-{person}_ses-{k % 3}" for k, person in enumerate(persons)]
    ages = np.random.default_rng(2).uniform(20, 80, 8).round(1)
    people(study, names, age=np.repeat(ages, 3).tolist(), visit=[k % 3 for k in range(24)], person=persons)
    of_maps = study / OF_MAPS
    rows = [{**row, "participant_id": name} for row, name in zip(read_table(of_maps, ("participant_id",)), names)]
    write_table(of_maps, ("participant_id", "lh", "rh"), rows)
    for model, contrast, whole in (("age", "age", True), ("age + visit", "visit", False)):
        usual, own = (
            fitted(study, model, contrast, permutations=50, hemis=("lh",), **options)
            for options in ({}, {"blocks": "person", "whole": whole})
        )
        np.testing.assert_array_equal(usual.inference.p_tfce, own.inference.p_tfce)
        assert summary(usual)["exchanged"] == ("blocks" if whole else "subjects")
        assert summary(usual)["blocks"] == 8
        assert len(usual.design.remarks) == 1
        assert own.design.remarks == ()


def test_few_exchanges_and_a_tiny_variance_group_are_remarked(study):
    for few, remarks in ((2, 1), (4, 1), (5, 0)):
        people(study, group=["a" if k < few else "b" for k in range(24)])
        result = fitted(study, "group", "group", variance_groups="group", hemis=("lh",), permutations=9)
        assert len(result.remarks) == remarks
    people(study, age=[20 + k if k < 4 else None for k in range(24)])
    few = fitted(study, hemis=("lh",))
    assert few.inference.possible == 24
    assert len(few.remarks) == 1


def test_unequal_variances_are_remarked_and_groups_of_variance_have_signs_exchanged(study, capsys, cwd):
    people(study, group=["ab"[k % 2] for k in range(24)])
    file = study / "spaces" / "ball" / "group" / "lh.cortical_thickness.npy"
    maps = np.load(file)
    maps[::2] += 3 * (maps[::2] - maps[::2].mean(axis=0))
    np.save(file, maps)
    argv = command(study, "--hemi", "lh", "--permutations", "99", "--json", model="group", contrast="group")
    assert main(argv) == 0
    plain = json.loads(capsys.readouterr().out)
    assert (len(plain["remarks"]), plain["exchanged"], plain["variance_groups"]) == (1, "subjects", None)
    assert main([*argv, "--variance-groups", "group"]) == 0
    grouped = json.loads(capsys.readouterr().out)
    assert (grouped["remarks"], grouped["exchanged"], grouped["variance_groups"]) == ([], "signs", 2)


def test_without_a_table_of_the_study_that_of_cohort_beside_the_maps_is_taken(study, capsys, cwd):
    argv = command(study, "--permutations", "9", "--no-report", "--json")
    table, of_maps = study / "participants.tsv", study / OF_MAPS
    table.rename(cwd / "other.tsv")
    refused(capsys, argv, str(table))
    rows = read_table(of_maps, ("participant_id",))
    ages = [{"age": row["age"]} for row in read_table(cwd / "other.tsv", ("participant_id",))]
    write_table(of_maps, ("participant_id", "age", "lh", "rh"), [row | age for row, age in zip(rows, ages)])
    assert main(argv) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["inputs"][0]["path"] == str(of_maps)
    assert said["left_out"]["value missing"] == ["s07"]


def test_a_template_in_gifti_is_read(study):
    """As fs_LR is."""
    for white in (study / "spaces" / "ball" / "group" / "surf").iterdir():
        write_surface(white.with_name(f"{white.name}.surf.gii"), Surface(VERTS, FACES))
        white.unlink()
    assert len(fitted(study, permutations=9).inference.t) == 2 * len(VERTS)
