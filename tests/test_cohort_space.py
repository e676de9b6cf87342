"""Maps of a cohort on a template."""

import json
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from commands import refused
from made_cohort import HereWorkers, participants, quick_measure, table, write_subject

from morphofold.analysis import gyral_graph
from morphofold.analysis.graph.gyral_tables import amounts
from morphofold.cli import main
from morphofold.errors import MissingPart
from morphofold.geometry import vertex_areas
from morphofold.group.measure_subject import measure_participant
from morphofold.group.spaces import Mapped, map_participant, maps_on_template, template, write_space
from morphofold.group.workers import run_tasks
from morphofold.io import read_surface, write_label, write_surface
from morphofold.shapes import icosphere
from morphofold.studies.folded_ball import folded_ball
from morphofold.surface import Surface

NAMES = ("anna", "ben", "cleo")
POINTS = icosphere(2)[0]  # of the template


def measure_with_maps(cortex, **options):
    """In place of ``measure``: the area of each vertex, the direction in which it lies, and a hole in the south."""
    m, verts = quick_measure(cortex, **options), cortex.white.verts
    x, z = (verts / np.linalg.norm(verts, axis=1, keepdims=True)).T[[0, 2]]
    maps = {"area": vertex_areas(verts, cortex.faces), "x": x, "north": np.where(z > -0.5, 1.0, np.nan)}
    return replace(m, maps={**m.maps, **maps})


def write_sphere(folder, hemi="lh", level=3):
    write_surface(folder / "surf" / f"{hemi}.sphere.reg", Surface(*icosphere(level, radius=100.0)))


@pytest.fixture
def three(tmp_path, monkeypatch):
    """Subjects of 642 vertices a hemisphere; ben has no registered sphere of the right one."""
    monkeypatch.setattr("morphofold.analysis.measuring.measure", measure_with_maps)
    folders = [write_subject(tmp_path / "subjects" / name, 1 + i / 10, level=3) for i, name in enumerate(NAMES)]
    for folder in folders:
        write_sphere(folder)
        if folder.name != "ben":
            write_sphere(folder, "rh")
    return folders


@pytest.fixture
def small(tmp_path):
    """The folder of a template of 162 vertices."""
    folder, ball = tmp_path / "small", Surface(*icosphere(2, radius=100.0))
    for name in ("surf", "label"):
        (folder / name).mkdir(parents=True)
    for hemi in ("lh", "rh"):
        for kind in ("sphere", "white", "pial"):
            write_surface(folder / "surf" / f"{hemi}.{kind}", ball)
        write_label(folder / "label" / f"{hemi}.cortex.label", ball.verts[:, 2] > -50, ball.verts)
    return folder


def mapped(folders, out, on, run="1"):
    """Outcomes by subject, shapes of arrays, and the folder with these."""
    subjects, space = participants(folders, out, run), out / "spaces" / on.folder_name
    assert all(outcome.state != "failed" for outcome in run_tasks(HereWorkers(), measure_participant, subjects))
    tasks = [Mapped(subject, replace(subject.task_folder, out=str(space)), on) for subject in subjects]
    outcomes = {outcome.name: outcome for outcome in run_tasks(HereWorkers(), map_participant, tasks)}
    return outcomes, write_space(space, on, tasks), space / "group"


def failures(outcomes):
    return [list(outcome.failures) for outcome in outcomes.values()]


def test_each_map_is_one_array_of_all_subjects_in_order(three, small, tmp_path):
    _, shapes, group = mapped(three, tmp_path / "out", template(str(small)))
    assert shapes == {f"{hemi}.{name}": (3, 162) for hemi in ("lh", "rh") for name in ("H", "area", "x", "north")}
    rows = [(row["participant_id"], row["lh"], row["rh"]) for row in table(group / "participants.tsv")]
    assert rows == [("anna", "1", "1"), ("ben", "1", "0"), ("cleo", "1", "1")]
    H = np.load(group / "lh.H.npy")
    assert H.dtype == np.float32
    radii = [np.linalg.norm(read_surface(folder / "surf" / "lh.pial").verts, axis=1).mean() for folder in three]
    np.testing.assert_allclose(H, np.repeat(1 / np.array(radii)[:, None], 162, axis=1), rtol=1e-5)
    np.testing.assert_allclose(np.load(group / "lh.x.npy"), np.tile(POINTS[:, 0], (3, 1)), atol=0.15)
    for folder, row in zip(three, np.load(group / "lh.area.npy")):  # areas keep their sum
        white = read_surface(folder / "surf" / "lh.white")
        assert row.sum() == pytest.approx(vertex_areas(white.verts, white.faces).sum(), rel=1e-5)
    north = np.load(group / "lh.north.npy")
    assert np.isnan(north[:, POINTS[:, 2] < -0.7]).all()  # not measured there
    np.testing.assert_allclose(north[:, POINTS[:, 2] > -0.2], 1.0, rtol=1e-6)
    files = sorted(file.name for file in (group / "surf").iterdir())
    assert files == [f"{hemi}.{kind}" for hemi in ("lh", "rh") for kind in ("pial", "sphere", "white")]


@pytest.mark.parametrize("level", [None, 4], ids=["missing", "another mesh"])
def test_a_hemisphere_without_its_registered_sphere_fails_alone(three, small, tmp_path, level):
    if level:
        write_sphere(three[1], "rh", level)
    outcomes, _, group = mapped(three, tmp_path / "out", template(str(small)))
    assert failures(outcomes) == [[], ["rh"], []]
    assert np.isnan(np.load(group / "rh.H.npy")).all(axis=1).tolist() == [False, True, False]
    assert np.isfinite(np.load(group / "lh.H.npy")).all()


def test_maps_come_over_once_and_again_where_a_sphere_or_the_template_has_changed(three, small, tmp_path):
    def states(run):
        outcomes, _, group = mapped(three, tmp_path / "out", template(str(small), 50.0), run)
        return [outcome.state for outcome in outcomes.values()], group

    _, group = states("1")
    before = {file.name: file.read_bytes() for file in group.glob("*.*")}
    assert states("2")[0] == ["reused"] * 3
    assert {file.name: file.read_bytes() for file in group.glob("*.*")} == before
    write_sphere(three[1], "rh")
    assert states("3")[0] == ["reused", "done", "reused"]
    assert np.isfinite(np.load(group / "rh.H.npy")[1]).any()
    write_surface(small / "surf" / "lh.white", Surface(*icosphere(2, radius=90.0)))
    assert states("4")[0] == ["done"] * 3


def test_maps_are_smoothed_on_the_template_except_areas(three, small, tmp_path):
    plain, broad = template(str(small)), template(str(small), 150.0)
    assert (plain.folder_name, broad.folder_name) == ("small", "small-fwhm150")
    *_, group = mapped(three, tmp_path / "out", plain)
    *_, smoothed = mapped(three, tmp_path / "out", broad)
    np.testing.assert_array_equal(np.load(group / "lh.area.npy"), np.load(smoothed / "lh.area.npy"))
    inside, above = POINTS[:, 2] > -0.5, POINTS[:, 2] > 0.5  # the template's cortex; far from its edge
    H = np.load(smoothed / "lh.H.npy")
    np.testing.assert_allclose(np.load(group / "lh.H.npy")[:, inside], H[:, inside], rtol=1e-5)
    assert np.isnan(H[:, ~inside]).all()
    assert np.isfinite(np.load(smoothed / "lh.north.npy")[:, inside]).all()
    ratio = np.load(smoothed / "lh.x.npy")[:, above].std() / np.load(group / "lh.x.npy")[:, above].std()
    degree_1 = np.exp(-(150.0**2) / (8 * np.log(2)) / 100.0**2)  # l (l + 1) / 2 = 1
    assert ratio == pytest.approx(degree_1, abs=0.05)
    assert json.loads((smoothed / "space.json").read_text())["smoothing_fwhm_mm"] == 150.0


def test_templates_of_one_side_map_that_side_and_without_sphere_are_refused(three, small, tmp_path):
    for kind in ("sphere", "white", "pial"):
        (small / "surf" / f"rh.{kind}").unlink()
    outcomes, shapes, _ = mapped(three, tmp_path / "out", template(str(small)))
    assert failures(outcomes) == 3 * [["rh"]]
    assert {name.split(".")[0] for name in shapes} == {"lh"}
    (small / "surf" / "lh.sphere").unlink()
    with pytest.raises(MissingPart):
        template(str(small))


def test_a_template_is_symmetric_where_its_spheres_are_mirrored(small):
    on = template(str(small))
    assert not on.is_symmetric()  # the two sides are the same, not mirrored
    left = read_surface(small / "surf" / "lh.sphere")
    write_surface(small / "surf" / "rh.sphere", Surface(left.verts * (-1, 1, 1), left.faces[:, ::-1]))
    assert on.is_symmetric()


def test_the_command_brings_maps_over(three, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("morphofold.group.workers.open_workers", lambda *options: nullcontext(HereWorkers()))
    out = tmp_path / "study"
    argv = ["cohort", str(tmp_path / "subjects"), "-o", str(out), "--no-report", "--space", "fsaverage5"]
    assert main([*argv, "--json"]) == 1  # ben rh
    mapped = json.loads(capsys.readouterr().out)["mapped"]
    assert {name: list(reasons) for name, reasons in mapped.items()} == {"anna": [], "ben": ["rh"], "cleo": []}
    assert np.load(out / "spaces" / "fsaverage5" / "group" / "lh.x.npy").shape == (3, 10242)


@pytest.mark.parametrize(
    "argv", [["--smooth", "10"], ["--space", "nowhere"], ["--space", "fsaverage5", "--smooth", "0"]]
)
def test_impossible_templates_are_refused_before_anything_is_written(three, tmp_path, capsys, argv):
    out = tmp_path / "study"
    refused(capsys, ["cohort", str(tmp_path / "subjects"), "-o", str(out), *argv])
    assert not out.exists()


def test_hinges_and_crests_keep_their_number_and_length(small, tmp_path):
    cortex = folded_ball(10_000)
    graph, area = gyral_graph(cortex), vertex_areas(cortex.white.verts, cortex.faces)
    unit = cortex.pial.verts / np.linalg.norm(cortex.pial.verts, axis=1, keepdims=True)
    write_surface(tmp_path / "lh.sphere.reg", Surface(100 * unit, cortex.faces))
    m = replace(quick_measure(cortex), graph=graph, maps={"area": area})
    plain, smoothed = (
        maps_on_template(m, tmp_path / "lh.sphere.reg", small / "surf/lh.sphere", template(str(small), width))
        for width in (None, 100.0)
    )
    own = amounts(graph, cortex.n_vertices)
    for name, amount in own.items():
        assert plain[name].sum() == pytest.approx(amount.sum(), rel=1e-12)
    assert np.nanmin(plain["hinge_distance"]) >= 0
    inside = np.isfinite(smoothed["hinge_density"])
    whole = 100 * own["hinges"].sum() / area.sum()
    assert np.median(smoothed["hinge_density"][inside]) == pytest.approx(whole, rel=0.2)
