"""The files that a scene names are found from the scene's folder, wherever a run starts and goes on."""

import os
import shutil
import warnings
from pathlib import Path

import meshio
import numpy as np
import pytest
from made_subjects import write_subject
from skfem import MeshTet

from morphofold.errors import DamagedFile, Refusal
from morphofold.sim.mesh.checked_tets import PIAL, read_tets
from morphofold.sim.scene import MeshFile
from morphofold.sim.scene.scene_files import load_scene, to_toml

BALL = '[geometry]\nshape = "mesh"\nfile = "{}"\ncortex_thickness = 15.0\n[growth]\nfinal = 1.02\n'


@pytest.fixture
def places(tmp_path, monkeypatch):
    """The folder of a scene, and the working folder, another one."""
    folder, cwd = tmp_path / "scenes", tmp_path / "working"
    folder.mkdir()
    cwd.mkdir()
    monkeypatch.chdir(cwd)
    return folder, cwd


def write_ball(path):
    mesh = MeshTet.init_ball(nrefs=1)
    meshio.write(path, meshio.Mesh(mesh.p.T * 40, [("tetra", mesh.t.T)]))


def write_scene(folder, text, name="scene.toml"):
    (folder / name).write_text(f'name = "a"\n{text}')
    return folder / name


def test_a_mesh_is_found_from_the_folder_of_its_scene(places):
    folder, cwd = places
    write_ball(folder / "ball.vtu")
    (cwd / "ball.vtu").write_text("another file of this name")
    scene = load_scene(write_scene(folder, BALL.format("ball.vtu")))
    assert scene.geometry.path() == folder / "ball.vtu"
    assert load_scene(os.path.relpath(folder / "scene.toml")) == scene
    write_scene(folder, BALL.format("../scenes/ball.vtu"), "up.toml")
    assert load_scene(folder / "up.toml").geometry == scene.geometry


def test_each_file_of_a_scene_like_another_is_found_from_the_scene_that_names_it(places):
    folder, cwd = places
    (folder / "base").mkdir()
    write_ball(folder / "base/ball.vtu")
    write_ball(folder / "own.vtu")
    write_scene(folder / "base", BALL.format("ball.vtu"))
    like = write_scene(folder, 'like = "base/scene.toml"\n')
    assert load_scene(like).geometry.path() == folder / "base/ball.vtu"
    own = write_scene(folder, 'like = "base/scene.toml"\n[geometry]\nfile = "own.vtu"\n', "own.toml")
    assert load_scene(own).geometry.path() == folder / "own.vtu"
    write_ball(cwd / "set.vtu")  # a setting is given where the command runs
    assert load_scene(like, ["geometry.file=set.vtu"]).geometry.path() == cwd / "set.vtu"


def test_the_old_rule_is_taken_with_a_warning_and_a_sample_without(places):
    folder, cwd = places
    write_ball(cwd / "ball.vtu")
    with pytest.warns(UserWarning, match=r"geometry\.file.*'ball\.vtu'"):
        scene = load_scene(write_scene(folder, BALL.format("ball.vtu")))
    assert scene.geometry.path() == cwd / "ball.vtu"
    sample = load_scene(write_scene(folder, BALL.format("hemisphere/hemisphere.vtu")))
    assert sample.geometry.file == "hemisphere/hemisphere.vtu"
    assert load_scene("hemisphere").geometry.subject == "fsaverage5"


def test_subject_sphere_and_maps_follow_the_same_rule(places):
    folder, cwd = places
    write_subject(folder / "bert", thickness=lambda s: 2.5 + s[:, 2])
    write_subject(cwd / "bert")
    for name in ("lh.white", "lh.sphere", "lh.thickness"):
        shutil.copy(folder / "bert/surf" / name, folder / name)
    text = (
        '[geometry]\nshape = "cortex"\nsubject = "{}"\nsphere = "{}"\n'
        'thickness_map = {{file = "{}", sphere = "lh.sphere"}}\n[effects.growth_map]\nfile = "lh.thickness"\n'
        'sphere = "../scenes/lh.sphere"\n'
    )
    scene = load_scene(write_scene(folder, text.format("lh.white", "lh.sphere", "lh.thickness")))
    assert scene.geometry.place() == folder / "lh.white"
    assert Path(scene.geometry.sphere) == folder / "lh.sphere"
    assert set(scene.map_files.values()) == {folder / "lh.thickness", folder / "lh.sphere"}
    named = load_scene(write_scene(folder, text.format("bert", "sphere", "thickness")))
    assert named.geometry.place() == folder / "bert"
    assert named.geometry.sphere == "sphere"
    assert named.map_files["thickness_map"] == folder / "bert/surf/lh.thickness"


def test_a_scene_as_a_run_writes_it_finds_its_files_from_anywhere(places, monkeypatch):
    folder, _ = places
    write_ball(folder / "ball.vtu")
    scene = load_scene(write_scene(folder, BALL.format("ball.vtu")))
    (folder / "out").mkdir()
    (folder / "out/scene.toml").write_text(to_toml(scene))
    monkeypatch.chdir("/")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert load_scene(folder / "out/scene.toml") == scene
    monkeypatch.chdir(folder)
    relative = scene.model_copy(update={"geometry": scene.geometry.model_copy(update={"file": "ball.vtu"})})
    assert load_scene(relative) == scene  # in Python, from the working folder


# --- meshes of folding codes


def block(n=3):
    """A block of cubes of six tetrahedra each, which are turned inwards, and its boundary."""
    mesh = MeshTet.init_tensor(*[np.arange(n + 1.0)] * 3)
    points, tets = 10 * mesh.p.T, mesh.t.T.copy()
    edges = points[tets[:, 1:]] - points[tets[:, :1]]
    outwards = np.linalg.det(edges) > 0
    tets[outwards] = tets[outwards][:, [0, 2, 1, 3]]
    return points, tets, mesh.facets[:, mesh.boundary_facets()].T


def neutral(points, tets, faces=None, labels=(1, 1)):
    rows = [str(len(points)), *(" ".join(f"{x:.6f}" for x in p) for p in points)]
    for cells, label in ((tets, labels[0]), (faces, labels[1])):
        if cells is not None:
            first = [] if label is None else [np.broadcast_to(label, len(cells))]
            table = np.column_stack([*first, cells + 1])
            rows += [str(len(cells)), *(" ".join(map(str, row)) for row in table)]
    return "\n".join([*rows, ""])


@pytest.mark.parametrize(("with_faces", "label"), [(True, 1), (False, None)])
def test_a_mesh_of_a_folding_code_is_read_and_turned(tmp_path, with_faces, label):
    points, tets, faces = block()
    (tmp_path / "a.mesh").write_text(neutral(points, tets, faces if with_faces else None, (label, label)))
    body = read_tets(MeshFile(shape="mesh", file=str(tmp_path / "a.mesh")))
    np.testing.assert_allclose(body.points, points)
    corners = body.points[body.tets]
    assert (np.linalg.det(corners[:, 1:] - corners[:, :1]) > 0).all()
    assert np.array_equal(np.sort(body.tets), np.sort(tets))
    assert np.array_equal(np.unique(np.sort(body.faces(PIAL)), axis=0), np.unique(np.sort(faces), axis=0))


def test_labels_of_a_mesh_of_a_folding_code_can_be_named(tmp_path):
    points, tets, faces = block()
    grey = (points[tets].mean(axis=1)[:, 2] > 20).astype(int) + 1
    (tmp_path / "a.mesh").write_text(neutral(points, tets, faces, (grey, 7)))
    body = read_tets(MeshFile(shape="mesh", file=str(tmp_path / "a.mesh"), label="label", cortex_label=2))
    assert np.array_equal(body.cortex, grey == 2)
    assert len(body.file.labelled_triangles("label", [7], "cut_facets")) == len(faces)


def test_mixed_orders_of_corners_are_usual_and_a_medit_file_is_still_read(tmp_path):
    points, tets, _ = block()
    tets[::2] = tets[::2][:, [1, 0, 2, 3]]
    meshio.Mesh(points, [("tetra", tets)]).write(tmp_path / "a.mesh")
    body = read_tets(MeshFile(shape="mesh", file=str(tmp_path / "a.mesh")))
    assert len(body.tets) == len(tets)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_damage_of_a_mesh_of_a_folding_code_is_refused_or_seen_as_a_body(tmp_path, rng):
    raw, codes = neutral(*block(1)).encode(), set()
    for at in range(0, len(raw), 3):
        changed = raw[:at] + bytes([rng.choice(list(b"0123456789 .-\n\xff"))]) + raw[at + 1 :]
        for damaged in (changed, raw[:at] or b" ", raw[:at] + b"99999999" + raw[at:]):
            (tmp_path / "a.mesh").write_bytes(damaged)
            try:
                read_tets(MeshFile(shape="mesh", file=str(tmp_path / "a.mesh")))
            except Refusal as error:
                codes.add(error.code)
    assert DamagedFile.code in codes
    assert codes <= {"damaged-file", "wrong-file", "out-of-range", "not-finite", "wrong-shape", "bad-mesh"}
