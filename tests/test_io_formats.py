"""Formats of other programs: surfaces and maps as CIVET, FreeSurfer, AFNI, SPM and CAT12 write them, whole or not."""

import gzip
import re
import shutil
import struct

import nibabel as nib
import numpy as np
import pytest
from made_surfaces import FOOTER, FORMATS, NO_SURFACE, is_small_sphere, one_line
from nibabel.freesurfer.mghformat import MGHImage
from nibabel.gifti import GiftiDataArray, GiftiImage, GiftiLabel, GiftiLabelTable

from morphofold import io as mio
from morphofold.errors import DamagedFile, NotFetched, OutOfRange, TooLarge, WrongFile
from morphofold.shapes import icosphere
from morphofold.surface import Regions, Surface

VERTS, FACES = icosphere(1, radius=3.0)
VALUES = np.r_[np.nan, np.linspace(-1.0, 4.0, 41)]


def rows(table, form="%.6f"):
    return "\n".join(" ".join(form % x for x in row) for row in np.atleast_2d(table)) + "\n"


def footer_bytes(folder, **changed):
    """What nibabel writes after the faces of a surface."""
    nib.freesurfer.write_geometry(folder / "t", VERTS, FACES, volume_info={**FOOTER, **changed})
    raw = (folder / "t").read_bytes()
    return raw[raw.index(b"valid =") - 12 :]


def three_bytes(numbers):
    return b"".join(int(n).to_bytes(3, "big") for n in numbers)


def quadrangles(tail, magic=b"\xff\xff\xfd"):
    """The sphere as quadrangles whose last two corners are equal."""
    quads = np.c_[FACES, FACES[:, 2]]
    points = VERTS.astype(">f4") if magic == b"\xff\xff\xfd" else np.round(100 * VERTS).astype(">i2")
    return magic + three_bytes((len(VERTS), len(quads))) + points.tobytes() + three_bytes(quads.ravel()) + tail


def mni(colours=0):
    colour = {0: 1, 1: len(FACES), 2: len(VERTS)}[colours]
    ends = [" ".join(map(str, part)) for part in np.array_split(3 * np.arange(1, len(FACES) + 1), 10)]
    corners = [" ".join(map(str, part)) for part in np.array_split(FACES.ravel(), 30)]
    head = [f"P 0.3 0.3 0.4 10 1 {len(VERTS)}", rows(VERTS), rows(VERTS / 3), f" {len(FACES)}"]
    return "\n".join([*head, f"{colours} " + "1 1 1 1 " * colour, "", *ends, "", *corners, ""])


def ascii_surface(comment="#!ascii version of lh.white"):
    flagged = lambda table: np.c_[table, np.zeros(len(table))]
    return f"{comment}\n{len(VERTS)} {len(FACES)}\n{rows(flagged(VERTS))}{rows(flagged(FACES), '%d')}"


def external(name="lh.central.dat", start=0):
    array = (
        '<DataArray Intent="NIFTI_INTENT_{}" DataType="NIFTI_TYPE_{}" Dimensionality="2" Dim0="{}" Dim1="3" '
        'Encoding="ExternalFileBinary" Endian="LittleEndian" ExternalFileName="{}" '
        'ExternalFileOffset="{}"><Data/></DataArray>'
    )
    points = array.format("POINTSET", "FLOAT32", len(VERTS), name, start)
    triangles = array.format("TRIANGLE", "INT32", len(FACES), name, start + 12 * len(VERTS))
    return f'<?xml version="1.0"?><GIFTI Version="1.0" NumberOfDataArrays="2">{points}{triangles}</GIFTI>'


DAT = VERTS.astype("<f4").tobytes() + FACES.astype("<i4").tobytes()


# --- surfaces


@pytest.mark.parametrize(("magic", "atol"), [(b"\xff\xff\xfd", 1e-6), (b"\xff\xff\xff", 0.006)])
@pytest.mark.parametrize("valid", ["1  # volume info valid", "0  # volume info invalid"])
def test_quadrangles_keep_their_footer(tmp_path, magic, atol, valid):
    (tmp_path / "lh.white").write_bytes(quadrangles(footer_bytes(tmp_path, valid=valid), magic))
    surface = mio.read_surface(tmp_path / "lh.white")
    is_small_sphere(surface, atol)
    assert surface.geometry["valid"] == valid
    np.testing.assert_array_equal(surface.geometry["cras"], FOOTER["cras"])
    assert (mio.scanner_transform(surface.geometry) is None) == valid.startswith("0")


@pytest.mark.parametrize("kind", ["triangles", "quadrangles"])
def test_a_footer_cut_anywhere_is_refused(tmp_path, kind):
    tail = footer_bytes(tmp_path)
    whole = (tmp_path / "t").read_bytes() if kind == "triangles" else quadrangles(tail)
    for left in range(1, len(tail)):
        (tmp_path / "lh.white").write_bytes(whole[: len(whole) - left])
        with pytest.raises(DamagedFile):
            mio.read_surface(tmp_path / "lh.white")
    (tmp_path / "lh.white").write_bytes(whole[: len(whole) - len(tail)])
    assert mio.read_surface(tmp_path / "lh.white").geometry is None


def test_a_footer_that_says_it_is_invalid_may_hold_anything(tmp_path):
    nothing = {"valid": "0  # volume info invalid", "cras": np.full(3, np.nan)}
    (tmp_path / "lh.white").write_bytes(quadrangles(footer_bytes(tmp_path, **nothing)))
    assert mio.scanner_transform(mio.read_surface(tmp_path / "lh.white").geometry) is None
    (tmp_path / "lh.white").write_bytes(quadrangles(footer_bytes(tmp_path, cras=np.full(3, np.nan))))
    with pytest.raises(DamagedFile):
        mio.read_surface(tmp_path / "lh.white")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("s_white_surface_left_81920.obj", mni(0)),
        ("a.x", mni(1)),
        ("a.obj", mni(2)),
        ("lh.white.asc", ascii_surface()),
        ("a.x", ascii_surface("#!ascii version in FreeSurfer format (SUMA)\n# made")),
    ],
)
def test_texts_of_mni_and_freesurfer_are_read(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    is_small_sphere(mio.read_surface(tmp_path / name))


def test_arrays_in_a_file_beside_it_are_read_and_from_an_annex_if_they_were_fetched(tmp_path):
    gii, dat, store = tmp_path / "lh.central.gii", tmp_path / "lh.central.dat", tmp_path / ".git/annex/objects/K"
    gii.write_text(external(start=7))
    dat.write_bytes(b"8 bytes"[:7] + DAT)
    is_small_sphere(mio.read_surface(gii), 1e-6)
    dat.unlink()
    dat.symlink_to(".git/annex/objects/K/K")
    gii.write_text(external())
    with pytest.raises(NotFetched):
        mio.read_surface(gii)
    store.mkdir(parents=True)
    (store / "K").write_bytes(DAT)
    is_small_sphere(mio.read_surface(gii), 1e-6)
    for size in (0, 100, len(DAT) - 1):
        (store / "K").write_bytes(DAT[:size])
        with pytest.raises(DamagedFile):
            mio.read_surface(gii)


# --- maps and regions


@pytest.mark.parametrize("columns", [1, 5])
def test_a_map_as_text_is_read(tmp_path, columns):
    table = VALUES[:, None] if columns == 1 else np.c_[np.arange(42), VERTS, VALUES]
    (tmp_path / "a.txt").write_text(rows(table))
    np.testing.assert_allclose(mio.read_morph(tmp_path / "a.txt"), VALUES, atol=1e-6)


@pytest.mark.parametrize("text", ["1 2\n3 4\n", "1 2 3 4 5\n7 2 3 4 5\n", "1\n2 3\n", "1\nx\n", "x\n1\n"])
def test_a_text_that_is_no_map_is_refused(tmp_path, text):
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises((DamagedFile, WrongFile)):
        mio.read_morph(tmp_path / "a.txt")


@pytest.mark.parametrize(
    ("name", "kind", "shape"),
    [
        ("lh.k.mgh", np.uint8, (-1, 1, 1)),
        ("lh.k.mgz", np.int16, (1, -1, 1)),
        ("lh.k.mgh.gz", np.int32, (-1, 1, 1)),
        ("lh.k.mgz", np.float32, (1, -1, 1)),
    ],
)
def test_a_map_of_every_type_is_read_from_mgh(tmp_path, name, kind, shape):
    values = np.arange(42).astype(kind)
    raw = MGHImage(values.reshape(shape), np.eye(4)).to_bytes()
    (tmp_path / name).write_bytes(raw if name.endswith("h") else gzip.compress(raw))
    np.testing.assert_array_equal(mio.read_morph(tmp_path / name), values)


def test_an_mgh_of_several_maps_is_refused_and_a_huge_one_not_allocated(tmp_path):
    raw = MGHImage(np.zeros((42, 1, 1, 2), np.float32), np.eye(4)).to_bytes()
    (tmp_path / "a.mgh").write_bytes(raw)
    with pytest.raises(WrongFile, match="42 x 1 x 1 x 2"):
        mio.read_morph(tmp_path / "a.mgh")
    (tmp_path / "a.mgh").write_bytes(struct.pack(">6i", 1, 2**31 - 1, 1, 1, 1, 3) + raw[24:])
    with pytest.raises(DamagedFile):
        mio.read_morph(tmp_path / "a.mgh")


def test_names_of_regions_are_one_line(tmp_path):
    table = GiftiLabelTable()
    table.labels.append(GiftiLabel(1, 0.1, 0.2, 0.3, 1))
    table.labels[0].label = "top\nof \u2028 it"
    array = GiftiDataArray(np.ones(4, np.int32), "NIFTI_INTENT_LABEL", "NIFTI_TYPE_INT32")
    (tmp_path / "a.label.gii").write_bytes(GiftiImage(darrays=[array], labeltable=table).to_bytes())
    assert mio.read_annotation(tmp_path / "a.label.gii").names == (r"top\nof \u2028 it",)


# --- damage

READERS = {
    **dict.fromkeys([*FORMATS, "a.stl", "mni.obj", "a.asc", "lh.central.gii", "lh.orig"], mio.read_surface),
    **dict.fromkeys(["map.gii", "lh.curv", "k.mgh", "k.mgz", "a.txt"], mio.read_morph),
    **dict.fromkeys(["lh.a.annot", "a.label.gii"], mio.read_annotation),
    "lh.cortex.label": lambda path: mio.read_label(path, 42),
}
ENDLESS = ("a.obj", "a.txt")  # a part of it is a whole text, or has the whole surface


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """A folder with a file of each format."""
    folder, surface = tmp_path_factory.mktemp("samples"), Surface(VERTS, FACES, geometry=FOOTER)
    for name in [*FORMATS, "a.stl"]:
        mio.write_surface(folder / name, surface)
    mio.write_gifti_map(folder / "map.gii", VALUES, nan=0.0)
    for name in ("lh.curv", "k.mgh"):
        mio.write_morph(folder / name, VALUES, nan=0.0)
    np.testing.assert_array_equal(mio.read_morph(folder / "k.mgh"), np.nan_to_num(VALUES).astype(np.float32))
    (folder / "k.mgz").write_bytes(gzip.compress((folder / "k.mgh").read_bytes(), mtime=0))
    regions = Regions(np.arange(42) % 3, ("a", "b", "c"), np.arange(9, dtype=np.uint8).reshape(3, 3))
    for name in ("lh.a.annot", "a.label.gii"):
        mio.write_annotation(folder / name, regions)
    mio.write_label(folder / "lh.cortex.label", VALUES > 0, VERTS)
    texts = {"mni.obj": mni(), "a.asc": ascii_surface(), "a.txt": rows(VALUES[:, None]), "lh.central.gii": external()}
    for name, text in texts.items():
        (folder / name).write_text(text)
    (folder / "lh.orig").write_bytes(quadrangles(footer_bytes(folder)))
    (folder / "lh.central.dat").write_bytes(DAT)
    return folder


@pytest.fixture
def damaged(samples, tmp_path, request):
    """The bytes of a sample, and a function that reads others under its name."""
    name = request.param
    shutil.copy(samples / "lh.central.dat", tmp_path)

    def read(raw):
        (tmp_path / name).write_bytes(raw)
        return READERS[name](tmp_path / name)

    return (samples / name).read_bytes(), read


@pytest.mark.parametrize(
    "damaged",
    [pytest.param(n, marks=[pytest.mark.slow] * (n in ("a.vtk", "a.vtu"))) for n in READERS if n not in ENDLESS],
    indirect=True,
)
def test_a_cut_file_and_another_content_are_refused_in_one_line(damaged, capfd):
    raw, read = damaged
    cut = [raw[: max(1, int(part * len(raw)))] for part in (0.001, 0.2, 0.9)]
    for content in (*cut, NO_SURFACE.encode(), bytes(range(256)) * 8):
        with pytest.raises((DamagedFile, WrongFile)) as error:
            read(content)
        one_line(error)
    assert capfd.readouterr() == ("", "")


def test_what_is_no_file_of_sensible_size_is_refused_unread(tmp_path):
    (tmp_path / "lh.white").touch()
    with pytest.raises(DamagedFile, match=r"lh\.white: .*\b0\b"):
        mio.read_surface(tmp_path / "lh.white")
    with (tmp_path / "lh.white").open("wb") as file:
        file.truncate(3 * 2**30)  # sparse: takes no space
    with pytest.raises(TooLarge, match=r"lh\.white: .*\b3\.0 GiB\b.*\b2 GiB\b"):
        mio.read_surface(tmp_path / "lh.white")


def test_a_missing_file_is_named_with_what_lies_beside_it_and_a_folder_is_called_one():
    with pytest.raises(FileNotFoundError, match=r"surf.lh\.wite: .*\blh\.white\b"):
        mio.read_surface(mio.sample_path("fsaverage5/surf") / "lh.wite")
    with pytest.raises(IsADirectoryError, match="fsaverage5: "):
        mio.read_surface(mio.sample_path("fsaverage5"))
    with pytest.raises(NotADirectoryError, match=r"lh\.white: "):
        mio.read_cortex(mio.sample_path("fsaverage5/surf/lh.white"))


@pytest.mark.parametrize("counts", [(2**31 - 1, 2**31 - 1), (-5, 80), (4300, 80)])
def test_counts_that_the_file_cannot_hold_are_refused_before_anything_is_allocated(samples, tmp_path, counts):
    raw = (samples / "lh.white").read_bytes()
    start = raw.index(b"\n\n") + 2
    (tmp_path / "lh.white").write_bytes(raw[:start] + struct.pack(">2i", *counts) + raw[start + 8 :])
    with pytest.raises(DamagedFile):
        mio.read_surface(tmp_path / "lh.white")


def test_a_face_out_of_range_is_refused_with_the_path(tmp_path):
    mio.write_surface(tmp_path / "lh.white", Surface(VERTS, FACES))
    raw = (tmp_path / "lh.white").read_bytes()
    (tmp_path / "lh.white").write_bytes(raw[:-4] + struct.pack(">i", 42))
    with pytest.raises(OutOfRange, match=re.escape(f"{tmp_path / 'lh.white'}: 1 of 80 ")):
        mio.read_surface(tmp_path / "lh.white")


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("lh.curv", mio.read_surface),
        ("map.gii", mio.read_surface),
        ("lh.white", mio.read_morph),
        ("a.gii", mio.read_morph),
    ],
)
def test_maps_and_surfaces_are_distinguished(samples, name, read):
    with pytest.raises(WrongFile, match=re.escape(name)):
        read(samples / name)
