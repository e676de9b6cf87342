"""What a name and a few bytes tell of a file: its side, a link that a copy lost, content that was not fetched."""

import shutil

import pytest
from made_subjects import AXES, write_subject

from morphofold.errors import NotFetched
from morphofold.io import read_annotation, read_cortex, read_label, read_morph, read_surface, sample_path, write_surface
from morphofold.io.cortices import read_folded
from morphofold.io.files import side_named
from morphofold.io.json_files import Record, read_json
from morphofold.shapes import icosphere
from morphofold.sim.scene.scene_files import load_scene
from morphofold.surface import Surface

SIDES = {
    "lh": "lh.white LH.ply s_white_surface_left_81920.obj sub-01_hemi-L_white.surf.gii hemi-l.gii L.mid.surf.gii "
    "100307.L.white.32k_fs_LR.surf.gii sub_Lwhite.gii white-left.stl CortexLeft.vtk lh_white.off tpl-fsLR_hemi-L.gii "
    "sub-R_hemi-L_white.gii sub-right_ses-R_hemi-left_pial.gii brain.lh",
    "rh": "rh.pial brain_RH.ply sub-01_hemi-right_wm.surf.gii hemi-R_space-fsLR.gii R.white 1_R_white.gii "
    "sub_Rhemi.gii white_right_.ply alright_hemi-R.gii rightWhite.ply subject.R.pial.surf.gii",
    None: "white.gii bright.ply Rhesus.white rhesus_white.gii upright.vtk Lhasa.ply leftover.stl lhwhite.gii fs_LR.gii "
    "left_right.ply lh.rh.white hemi-L_hemi-R.gii 1.L.R.gii sub-L_white.gii T1R.gii sub-right01.ply",
}


@pytest.mark.parametrize(("name", "side"), [(name, side) for side, names in SIDES.items() for name in names.split()])
def test_a_side_is_told_by_any_usual_spelling_and_never_guessed(name, side):
    assert side_named(name) == side


def test_the_side_of_a_pair_is_that_of_its_names(tmp_path):
    folder = sample_path("fsaverage5/surf")
    for kind in ("white", "pial"):
        shutil.copy(folder / f"rh.{kind}", tmp_path / f"sub-L_hemi-right_{kind}")
    assert read_cortex(white=tmp_path / "sub-L_hemi-right_white", pial=tmp_path / "sub-L_hemi-right_pial").hemi == "rh"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A subject with small surfaces, a map, a label and an annotation on both sides."""
    folder, (verts, faces) = tmp_path_factory.mktemp("made"), icosphere(4)
    for hemi in ("lh", "rh"):
        write_subject(folder, hemi, axes=AXES, thickness=lambda s: 2 + s[:, 0])
        write_surface(folder / "surf" / f"{hemi}.pial", Surface(verts * (AXES + 2), faces))
    return folder


@pytest.fixture
def bert(made, tmp_path):
    return shutil.copytree(made, tmp_path / "bert")


LOST = {
    "nothing": None,
    "empty": b"",
    "text": b"lh.pial.T1",
    "macOS": b"XSym\n0010\n3f2b\nlh.pial.T1\n" + b" " * 1000,
    "Cygwin": b"!<symlink>\xff\xfe" + "lh.pial.T1\0".encode("utf-16-le"),
    "link": "lh.pial.T1",
    "link of another machine": "/home/me/subjects/bert/surf/lh.pial.T1",
}


@pytest.mark.parametrize("how", LOST)
@pytest.mark.parametrize("hemi", ["lh", "rh"])
@pytest.mark.parametrize("kind", ["T1", "T2", "FLAIR"])
def test_a_pial_surface_whose_link_is_lost_is_read(bert, how, hemi, kind):
    pial = bert / "surf" / f"{hemi}.pial"
    want = read_surface(pial)
    pial.rename(pial.with_name(f"{hemi}.pial.{kind}"))
    left = LOST[how]
    if isinstance(left, bytes):
        pial.write_bytes(left.replace(b"lh", hemi.encode()).replace(b"l\0h", f"{hemi[0]}\0h".encode()))
    elif left is not None and how == "link" and kind == "T1":
        pial.symlink_to(f"{hemi}.pial.T1")  # not lost: no warning
        assert read_cortex(bert, hemi).files[1] == str(pial)
        return
    elif left is not None:
        pial.symlink_to(left.replace("lh", hemi))
    with pytest.warns(UserWarning, match=rf"{hemi}\.pial\.{kind}\b"):
        cortex = read_cortex(bert, hemi)
    assert (cortex.pial.verts == want.verts).all()
    assert cortex.files[1] == str(pial.with_name(f"{hemi}.pial.{kind}"))
    with pytest.warns(UserWarning, match=kind):
        assert (read_surface(pial).verts == want.verts).all()
    with pytest.warns(UserWarning, match=kind):
        assert (read_folded(bert, hemi, surface="pial").white.verts == want.verts).all()


def test_the_refined_pial_surface_is_that_of_the_link_and_a_damaged_one_is_not_replaced(bert):
    pial = bert / "surf/lh.pial"
    shutil.copy(pial, pial.with_name("lh.pial.T2"))
    pial.rename(pial.with_name("lh.pial.T1"))
    with pytest.warns(UserWarning, match=r"lh\.pial\.T2"):  # -T2pial links it
        read_surface(pial)
    pial.write_text("lh.pial.T1")
    with pytest.warns(UserWarning, match=r"lh\.pial\.T1"):
        read_surface(pial)
    for damaged in (pial.with_name("lh.pial.T1").read_bytes()[:1000], b"something else"):
        pial.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"lh\.pial: "):
            read_surface(pial)


KEY = "annex/objects/SHA256E-s369000--0123456789abcdef.white"
UNFETCHED = {
    "link of DataLad": f"../../.git/{KEY}",
    "link of a folder with spaces": f"/my study/.git/{KEY}",
    "file of git-annex": f"/{KEY}\n".encode(),
    "link as text": f"../../.git/{KEY}".encode(),
    "git-lfs": b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 369000\n",
}


@pytest.mark.parametrize("how", UNFETCHED)
@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("surf/lh.white", read_surface),
        ("surf/lh.pial", lambda file: read_cortex(file.parents[1])),
        ("surf/lh.thickness", read_morph),
        ("surf/lh.thickness", lambda file: read_cortex(file.parents[1])),
        ("label/lh.aparc.annot", read_annotation),
        ("label/lh.cortex.label", lambda file: read_label(file, 2562)),
        ("label/lh.cortex.label", lambda file: read_folded(file.parents[1], "lh")),
        ("scene.toml", load_scene),
        ("stage.json", lambda file: read_json(file, Record, "")),
    ],
)
def test_a_file_that_was_not_fetched_is_called_so(bert, how, name, read):
    file, left = bert / name, UNFETCHED[how]
    file.unlink(missing_ok=True)
    if isinstance(left, bytes):
        file.write_bytes(left)
    else:
        file.symlink_to(left)
    with pytest.raises(NotFetched, match="lfs pull" if how == "git-lfs" else "datalad get"):
        read(file)


def test_a_link_to_a_pial_surface_that_was_not_fetched_is_not_lost(bert):
    pial = bert / "surf/lh.pial"
    pial.unlink()
    pial.with_name("lh.pial.T1").symlink_to(f"../../.git/{KEY}")
    pial.symlink_to("lh.pial.T1")
    with pytest.raises(NotFetched):
        read_cortex(bert)
