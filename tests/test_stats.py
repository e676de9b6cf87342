"""``morphofold stats``: a model at every vertex of a study's maps on a template."""

import json
import shutil

import numpy as np
import pytest
from commands import refused
from made_spaces import FACES, VERTS, write_space

from morphofold.analysis import smooth
from morphofold.cli import main
from morphofold.errors import DamagedFile, DoesNotApply, MissingPart, UnknownName
from morphofold.group.map_statistics import cluster_rows, fit_study, summary, write_result
from morphofold.group.spaces import find_space
from morphofold.group_pages.stats_pages import effect_unit, stats_report
from morphofold.io import read_morph, write_surface
from morphofold.number_texts import number
from morphofold.report.pictures.pixel_canvas import read_png
from morphofold.surface import Surface
from morphofold.tables import read_table, write_table

OF_MAPS = "spaces/ball/group/participants.tsv"
N, SUBJECTS = len(VERTS), [f"s{k:02}" for k in range(24)]
NORTH, CORTEX = VERTS[:, 2] > 30, VERTS[:, 2] > -40


@pytest.fixture(scope="module")
def study_once(tmp_path_factory):
    """24 subjects on a ball of 642 vertices: age thins the north of the left side by 0.05 mm a year. s05 has no right
    side, and s07 no age; the south is no cortex."""
    study = tmp_path_factory.mktemp("stats") / "study"
    random = np.random.default_rng(1)
    age = random.uniform(20, 80, len(SUBJECTS))
    maps = {}
    for hemi in ("lh", "rh"):
        thickness = 0.5 * smooth(VERTS, FACES, random.standard_normal((N, len(SUBJECTS))), 15.0).T
        maps[f"{hemi}.cortical_thickness"] = 2.5 + thickness - 0.05 * (hemi == "lh") * np.outer(age - 50, NORTH)
        maps[f"{hemi}.area"] = np.full_like(thickness, 2.0)
    maps["rh.cortical_thickness"][5] = np.nan
    write_space(study, maps)
    table = study / OF_MAPS
    table.write_text(table.read_text().replace("s05\t1\t1", "s05\t1\t0"))
    write_people(study, age=[None if name == "s07" else a for name, a in zip(SUBJECTS, age)], site=[1] * len(SUBJECTS))
    return study


@pytest.fixture
def study(study_once, tmp_path):
    """A copy that a test may change."""
    return shutil.copytree(study_once, tmp_path / "study")


@pytest.fixture(scope="module")
def result(study_once):
    return fitted(study_once)


def write_people(study, names=SUBJECTS, **columns):
    """Write the table of participants."""
    rows = [dict(zip(("participant_id", *columns), row)) for row in zip(names, *columns.values())]
    write_table(study / "participants.tsv", ("participant_id", *columns), rows)


def fitted(study, model="age", contrast="age", permutations=199, **options):
    formula, table = f"cortical_thickness ~ {model}", study / "participants.tsv"
    return fit_study(find_space(study), table, formula, contrast, permutations=permutations, **options)


def command(study, *options, model="age", contrast="age"):
    return ["stats", str(study), "--model", f"cortical_thickness ~ {model}", "--contrast", contrast, "-q", *options]


# a study -----------------------------------------------------------------------------------------------------


def test_an_effect_is_significant_on_its_side_and_in_its_region(result, study_once):
    assert (result.design.left_out, result.without_maps, result.inference.df) == (("s07",), ("s05",), 20)
    significant, left = result.inference.p_tfce <= 0.05, slice(N)
    assert significant[left][VERTS[:, 2] > 35].mean() > 0.95
    assert significant[left][VERTS[:, 2] < 15].mean() < 0.02
    assert significant[N:].mean() < 0.02
    np.testing.assert_allclose(result.inference.effect[left][NORTH].mean(), -0.05, atol=0.01)
    assert np.isnan(result.inference.t[left][~CORTEX]).all()
    np.testing.assert_array_equal(result.n_values[left], np.where(CORTEX, 22, 0))
    assert result.remarks == []
    alone = fitted(study_once, hemis=("lh",), permutations=9)
    assert (alone.without_maps, len(alone.design.subjects), len(alone.inference.t)) == ((), 23, N)


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
    content = json.loads((out / "summary.json").read_text())
    effect = read_morph(out / "maps" / "rh.effect.shape.gii")
    np.testing.assert_allclose(effect, result.inference.effect[N:], rtol=1e-5)
    p = read_morph(out / "maps" / "lh.p_tfce")
    np.testing.assert_allclose(p, np.nan_to_num(result.inference.p_tfce[:N], nan=1.0), rtol=1e-6)
    cluster = read_morph(out / "maps" / "lh.cluster").astype(int)
    rows = read_table(out / "clusters.tsv", text_columns=("hemi", "region"))
    assert (cluster == 1).sum() * 2.0 == pytest.approx(rows[0]["area_mm2"])
    expected = {
        "vertices": {"all": 2 * N, "tested": int(np.isfinite(result.inference.t).sum())},
        "left_out": {"value missing": ["s07"], "no maps": ["s05"]},
    }
    assert {key: content[key] for key in expected} == expected
    again = write_result(fitted(study_once), tmp_path / "again", [table])
    for file in out.rglob("*.*"):
        assert file.read_bytes() == (again / file.relative_to(out)).read_bytes(), file


def test_the_command_writes_and_prints_results(study_once, tmp_path, capsys):
    assert main(command(study_once, "--permutations", "99", "-o", str(tmp_path / "age"))) == 0
    assert "lh north" in capsys.readouterr().out
    pictures = {file.stem: read_png(file).std() for file in (tmp_path / "age" / "figures").iterdir()}
    assert set(pictures) == {"effect", "p_height", "p_tfce", "r", "subjects"}
    assert min(pictures.values()) > 10
    argv = ["--hemi", "rh", "-o", str(tmp_path / "mean"), "--permutations", "9", "--no-report", "--json"]
    assert main(command(study_once, *argv, model="1", contrast="1")) == 0
    content = json.loads(capsys.readouterr().out)
    assert (content["exchanged"], content["hemispheres"], len(content["subjects"])) == ("signs", ["rh"], 23)


@pytest.mark.parametrize(
    ("options", "model", "contrast", "code"),
    [
        ([], "site", "site", "does-not-apply"),
        (["--whole-blocks"], "age", "age", "--blocks"),
        (["--asymmetry", "index", "--hemi", "rh"], "age", "age", "--hemi"),
    ],
)
def test_models_that_can_not_be_tested_are_refused(study_once, cwd, capsys, options, model, contrast, code):
    refused(capsys, command(study_once, *options, "-o", "out", model=model, contrast=contrast), code)
    assert list(cwd.iterdir()) == []


def test_without_a_table_of_the_study_that_of_cohort_beside_the_maps_is_read(study, capsys, cwd):
    argv = command(study, "--permutations", "9", "--no-report", "--json")
    of_maps, other = study / OF_MAPS, (study / "participants.tsv").rename(cwd / "other.tsv")
    refused(capsys, argv, str(study / "participants.tsv"))
    tables = (read_table(path, ("participant_id",)) for path in (of_maps, other))
    rows = [of_subject | {"age": person["age"]} for of_subject, person in zip(*tables)]
    write_table(of_maps, ("participant_id", "age", "lh", "rh"), rows)
    assert main(argv) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["inputs"][0]["path"] == str(of_maps)
    assert content["left_out"]["value missing"] == ["s07"]


# the page ----------------------------------------------------------------------------------------------------


def test_the_page_escapes_names_and_shows_subjects_and_the_interval_of_the_peak(study, tmp_path, monkeypatch):
    limits, picture = {}, "morphofold.group_pages.stats_pages.picture"
    monkeypatch.setattr(picture, lambda space, folder, what, maps: limits.update({what.key: what.limits}) or {})
    for table in study.rglob("participants.tsv"):
        table.write_text(table.read_text().replace("s05\t", "<b>s05\t"))
    result = fitted(study, permutations=9)
    page = (write_result(result, tmp_path / "out", report=stats_report) / "report.html").read_text(encoding="utf-8")
    assert "&lt;b&gt;s05" in page
    assert "<b>s05" not in page
    chart = page[page.index('<svg class="chart"') : page.index("</svg>", page.index('<svg class="chart"'))]
    assert all(f"{name}:" in chart for name in result.design.subjects)
    assert "s07:" not in chart
    fit, peak = result.inference, result.inference.clusters[0]["peak"]
    low, high = (number(fit.effect[peak] + sign * fit.half_width[peak]) for sign in (-1, 1))
    assert f"<td>{low} to {high}</td>" in page
    assert limits["effect"][1] == -limits["effect"][0] == np.nanmax(np.abs(fit.effect))


@pytest.mark.parametrize(
    ("model", "contrast", "unit"),
    [
        ("age", "age", "mm per year"),
        ("center(age)", "1", "mm"),
        ("age + sex", "sex", "mm"),
        ("age + iq", "iq", "mm per unit of iq"),
        ("age * sex", "age:sex", "mm per unit of age:sex[T.M]"),
    ],
)
def test_the_unit_of_an_effect_is_that_of_the_map_for_each_of_the_regressor(study, model, contrast, unit):
    count, ages = range(24), [20 + k * k for k in range(24)]
    write_people(study, age=ages, sex=["FM"[k % 2] for k in count], iq=[100 + 7 * (k % 5) for k in count])
    assert effect_unit(fitted(study, model, contrast, permutations=1)) == unit


# remarks, sessions and blocks --------------------------------------------------------------------------------


def test_sessions_of_a_person_are_exchanged_with_the_person(study):
    """What is the same in all sessions of a person by whole persons, what is not within them, and both say so."""
    persons = [f"p{k // 3}" for k in range(24)]
    names = [f"sub-{person}_ses-{k % 3}" for k, person in enumerate(persons)]
    ages = np.random.default_rng(2).uniform(20, 80, 8).round(1)
    write_people(study, names, age=np.repeat(ages, 3).tolist(), visit=[k % 3 for k in range(24)], person=persons)
    of_maps = study / OF_MAPS
    rows = [{**row, "participant_id": name} for row, name in zip(read_table(of_maps, ("participant_id",)), names)]
    write_table(of_maps, ("participant_id", "lh", "rh"), rows)
    for model, contrast, whole in (("age", "age", True), ("age + visit", "visit", False)):
        usual, own = (
            fitted(study, model, contrast, permutations=50, hemis=("lh",), **options)
            for options in ({}, {"blocks": "person", "whole": whole})
        )
        np.testing.assert_array_equal(usual.inference.p_tfce, own.inference.p_tfce)
        content = summary(usual)
        assert (content["exchanged"], content["blocks"]) == ("blocks" if whole else "subjects", 8)
        assert len(usual.design.remarks) == 1
        assert own.design.remarks == ()


def test_few_exchanges_and_unequal_variances_are_remarked(study):
    write_people(study, age=[20 + k if k < 4 else None for k in range(24)])
    few = fitted(study, hemis=("lh",))
    assert (few.inference.n_possible, len(few.remarks)) == (24, 1)
    write_people(study, group=["ab"[k % 2] for k in range(24)])
    file = study / "spaces" / "ball" / "group" / "lh.cortical_thickness.npy"
    maps = np.load(file)
    maps[::2] += 3 * (maps[::2] - maps[::2].mean(axis=0))
    np.save(file, maps)
    options = {"model": "group", "contrast": "group", "hemis": ("lh",), "permutations": 99}
    plain, grouped = summary(fitted(study, **options)), summary(fitted(study, variance_groups="group", **options))
    assert (len(plain["remarks"]), plain["exchanged"], plain["variance_groups"]) == (1, "subjects", None)
    assert (grouped["remarks"], grouped["exchanged"], grouped["variance_groups"]) == ([], "signs", 2)


def test_repeated_measures_are_exchanged_within_a_person_or_as_whole_blocks(tmp_path, rng):
    """Eight people, each measured twice; the second time the north is 0.1 mm thinner. People differ by 1 mm."""
    person, visit, visits = np.repeat(np.arange(8), 2), np.tile([0, 1], 8), tmp_path / "study"
    maps = rng.uniform(2, 3, (8, 1))[person] - 0.1 * np.outer(visit, NORTH) + 0.01 * rng.standard_normal((16, N))
    names = write_space(visits, {"lh.cortical_thickness": maps}, hemis=["lh"])
    write_people(
        visits, names, person=[f"p{k}" for k in person], visit=visit.tolist(), age=(20.0 + 5 * person).tolist()
    )
    options = {"blocks": "person", "hemis": ["lh"]}
    within = fitted(visits, "visit + C(person)", "visit", **options).inference
    assert (within.p_height[NORTH] <= 0.05).mean() > 0.95
    assert (within.p_height[CORTEX & ~NORTH] <= 0.05).mean() <= 0.01
    assert within.effect[NORTH].mean() == pytest.approx(-0.1, abs=0.01)
    whole = fitted(visits, whole=True, **options)
    assert len(np.unique(whole.inference.null_height)) > 100
    assert summary(whole)["exchanged"] == "blocks"
    with pytest.raises(DoesNotApply):  # no exchange within a person changes it
        fitted(visits, **options)
    with pytest.raises(DoesNotApply):  # no exchange of persons changes what differs within them
        fitted(visits, "visit", "visit", whole=True, **options)


# left against right ------------------------------------------------------------------------------------------


def test_the_difference_and_the_index_of_left_and_right_are_tested_within_subjects(tmp_path, study_once, rng):
    """The left is 10 % thicker than the right in the north, and subjects differ by far more than that."""
    level, noise = rng.uniform(1.5, 3.5, (16, 1)), 0.02 * rng.standard_normal((2, 16, N))
    left, right = (level * (1 + sign * 0.05 * NORTH) + noise[k] for k, sign in enumerate((1, -1)))
    maps = {"lh.cortical_thickness": left, "rh.cortical_thickness": right}
    names = write_space(tmp_path / "study", maps, symmetric=True)
    write_people(tmp_path / "study", names, age=rng.uniform(20, 80, 16).tolist())
    options = {"model": "center(age)", "contrast": "1"}
    difference = fitted(tmp_path / "study", **options, asymmetry="difference")
    assert (difference.hemis, difference.inference.by_signs) == (("lh",), True)
    p = difference.inference.p_height
    assert (p[NORTH] <= 0.05).all()
    assert (p[CORTEX & ~NORTH] <= 0.05).mean() <= 0.01
    assert np.isnan(p[~CORTEX]).all()
    assert difference.inference.effect[NORTH].mean() == pytest.approx(0.1 * 2.5, rel=0.15)
    index = fitted(tmp_path / "study", **options, asymmetry="index").inference
    np.testing.assert_allclose(index.effect[NORTH], 0.1, atol=0.02)
    with pytest.raises(DoesNotApply):  # its template is not symmetric
        fitted(study_once, asymmetry="difference")


# maps on disk ------------------------------------------------------------------------------------------------


def test_a_template_in_gifti_is_read(study):
    """As fs_LR is."""
    for white in (study / "spaces" / "ball" / "group" / "surf").iterdir():
        write_surface(white.with_name(f"{white.name}.surf.gii"), Surface(VERTS, FACES))
        white.unlink()
    assert len(fitted(study, permutations=9).inference.t) == 2 * N


def test_a_study_without_maps_or_with_several_spaces_is_refused(study, tmp_path):
    for arguments in ((tmp_path,), (study, "fsaverage6")):
        with pytest.raises(FileNotFoundError):
            find_space(*arguments)
    shutil.copytree(study / "spaces" / "ball", study / "spaces" / "other")
    with pytest.raises(UnknownName):
        find_space(study)
    assert find_space(study, "ball").subjects == tuple(SUBJECTS)


@pytest.mark.parametrize("content", [np.full((24, N), "text"), np.zeros((25, N)), np.zeros((24, N - 1)), None])
def test_a_file_that_is_no_map_of_the_subjects_is_refused(study, content):
    file = study / "spaces" / "ball" / "group" / "lh.cortical_thickness.npy"
    if content is None:
        file.write_bytes(file.read_bytes()[:5000])
    else:
        np.save(file, content)
    with pytest.raises(DamagedFile):
        find_space(study).map("lh", "cortical_thickness")


def test_a_map_of_one_side_only_is_not_an_unknown_one(study, tmp_path, capsys):
    (study / "spaces" / "ball" / "group" / "lh.area.npy").unlink()
    space = find_space(study)
    with pytest.raises(UnknownName):
        space.map("lh", "K")
    with pytest.raises(MissingPart):
        space.map("lh", "area")
    assert space.map("rh", "area").shape == (24, N)
    refused(capsys, command(study, "-o", str(tmp_path / "out")), "missing-part", "lh.area.npy")


@pytest.mark.parametrize("change", [("s01", "s02"), ("rh", "side")])
def test_a_damaged_list_of_subjects_is_refused(study, change):
    table = study / OF_MAPS
    table.write_text(table.read_text().replace(*change))
    with pytest.raises(DamagedFile):
        find_space(study)
