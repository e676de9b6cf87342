"""Formats of other programs: surfaces and maps as CIVET, FreeSurfer, AFNI, SPM and CAT12 write them."""

import gzip
import random
import struct

import nibabel as nib
import numpy as np
import pytest
from made_surfaces import FOOTER

from morphofold.errors import DamagedFile, NotFetched, Refusal, WrongFile
from morphofold.io import (
    read_annotation,
    read_morph,
    read_surface,
    scanner_transform,
    write_gifti_map,
    write_morph,
    write_surface,
)
from morphofold.shapes import icosphere
from morphofold.surface import Surface

VERTS, FACES = icosphere(1, radius=3.0)
CODES = {"damaged-file", "wrong-file", "out-of-range", "not-finite", "wrong-shape"}


def is_the_sphere(surface, atol=1e-5):
    np.testing.assert_allclose(surface.verts, VERTS, atol=atol)
    np.testing.assert_array_equal(surface.faces, FACES)


def rows(table, form="%.6f"):
    return "\n".join(" ".join(form % x for x in row) for row in np.atleast_2d(table)) + "\n"


def footer_bytes(folder, **changed):
    """What nibabel writes after the faces of a surface."""
    nib.freesurfer.write_geometry(folder / "t", VERTS, FACES, volume_info={**FOOTER, **changed})
    raw = (folder / "t").read_bytes()
    return raw[raw.index(b"valid =") - 12 :]


def quadrangles(tail, magic=b"\xff\xff\xfd"):
    """The sphere as quadrangles whose last two corners are equal."""
    three = lambda numbers: b"".join(int(n).to_bytes(3, "big") for n in numbers)
    points = VERTS.astype(">f4") if magic == b"\xff\xff\xfd" else np.round(100 * VERTS).astype(">i2")
    quads = np.c_[FACES, FACES[:, 2]].ravel()
    return magic + three((len(VERTS), len(FACES))) + points.tobytes() + three(quads) + tail


def mni(colours=0):
    colour = {0: 1, 1: len(FACES), 2: len(VERTS)}[colours]
    ends = [" ".join(map(str, part)) for part in np.array_split(3 * np.arange(1, len(FACES) + 1), 10)]
    corners = [" ".join(map(str, part)) for part in np.array_split(FACES.ravel(), 30)]
    return "\n".join(
        [
            f"P 0.3 0.3 0.4 10 1 {len(VERTS)}",
            rows(VERTS),
            rows(VERTS / 3),
            f" {len(FACES)}",
            f"{colours} " + "1 1 1 1 " * colour,
        ]
        + ["", *ends, "", *corners, ""]
    )


def ascii_surface(comment="#!ascii version of lh.white"):
    flagged = lambda table: np.c_[table, np.zeros(len(table))]
    return f"{comment}\n{len(VERTS)} {len(FACES)}\n{rows(flagged(VERTS))}{rows(flagged(FACES), '%d')}"


def external(name="lh.central.dat", at=0):
    array = (
        '<DataArray Intent="NIFTI_INTENT_{}" DataType="NIFTI_TYPE_{}" Dimensionality="2" Dim0="{}" Dim1="3" '
        'Encoding="ExternalFileBinary" Endian="LittleEndian" ExternalFileName="{}" '
        'ExternalFileOffset="{}"><Data/></DataArray>'
    )
    return (
        '<?xml version="1.0"?><GIFTI Version="1.0" NumberOfDataArrays="2">'
        + array.format("POINTSET", "FLOAT32", len(VERTS), name, at)
        + array.format("TRIANGLE", "INT32", len(FACES), name, at + 12 * len(VERTS))
        + "</GIFTI>"
    )


DAT = VERTS.astype("<f4").tobytes() + FACES.astype("<i4").tobytes()


# --- quadrangles of FreeSurfer


@pytest.mark.parametrize(("magic", "atol"), [(b"\xff\xff\xfd", 1e-6), (b"\xff\xff\xff", 0.006)])
@pytest.mark.parametrize("valid", ["1  # volume info valid", "0  # volume info invalid"])
def test_quadrangles_keep_their_footer(tmp_path, magic, atol, valid):
    (tmp_path / "lh.white").write_bytes(quadrangles(footer_bytes(tmp_path, valid=valid), magic))
    surface = read_surface(tmp_path / "lh.white")
    is_the_sphere(surface, atol)
    assert surface.geometry["valid"] == valid
    np.testing.assert_array_equal(surface.geometry["cras"], FOOTER["cras"])
    assert (scanner_transform(surface.geometry) is None) == valid.startswith("0")


def test_quadrangles_are_cut_as_by_nibabel(tmp_path, rng):
    quads = np.array([rng.permutation(42)[:4] for _ in range(50)])
    three = lambda numbers: b"".join(int(n).to_bytes(3, "big") for n in numbers)
    raw = b"\xff\xff\xfd" + three((42, 50)) + VERTS.astype(">f4").tobytes() + three(quads.ravel())
    (tmp_path / "lh.orig").write_bytes(raw)
    verts, faces = nib.freesurfer.read_geometry(tmp_path / "lh.orig")
    surface = read_surface(tmp_path / "lh.orig")
    assert np.array_equal(surface.verts, verts)
    assert np.array_equal(surface.faces, faces)
    assert surface.geometry is None


@pytest.mark.parametrize("kind", ["triangles", "quadrangles"])
def test_a_footer_cut_anywhere_is_refused(tmp_path, kind):
    tail = footer_bytes(tmp_path)
    whole = (tmp_path / "t").read_bytes() if kind == "triangles" else quadrangles(tail)
    for left in range(1, len(tail)):
        (tmp_path / "lh.white").write_bytes(whole[: len(whole) - left])
        with pytest.raises(DamagedFile):
            read_surface(tmp_path / "lh.white")
    (tmp_path / "lh.white").write_bytes(whole[: len(whole) - len(tail)])
    assert read_surface(tmp_path / "lh.white").geometry is None


def test_a_footer_that_says_it_is_invalid_may_hold_anything(tmp_path):
    nothing = {"valid": "0  # volume info invalid", "cras": np.full(3, np.nan)}
    (tmp_path / "lh.white").write_bytes(quadrangles(footer_bytes(tmp_path, **nothing)))
    assert scanner_transform(read_surface(tmp_path / "lh.white").geometry) is None
    (tmp_path / "lh.white").write_bytes(quadrangles(footer_bytes(tmp_path, cras=np.full(3, np.nan))))
    with pytest.raises(DamagedFile):
        read_surface(tmp_path / "lh.white")


# --- texts


@pytest.mark.parametrize("colours", [0, 1, 2])
@pytest.mark.parametrize("name", ["s_white_surface_left_81920.obj", "a.x"])
def test_an_mni_object_is_read(tmp_path, colours, name):
    (tmp_path / name).write_text(mni(colours))
    is_the_sphere(read_surface(tmp_path / name))


def test_a_wavefront_obj_is_still_read(tmp_path):
    write_surface(tmp_path / "a.obj", Surface(VERTS, FACES))
    is_the_sphere(read_surface(tmp_path / "a.obj"))


@pytest.mark.parametrize("name", ["lh.white.asc", "lh.white.srf", "a.x"])
@pytest.mark.parametrize(
    "comment", ["#!ascii version of lh.white", "#!ascii version in FreeSurfer format (SUMA)\n# made"]
)
def test_freesurfers_text_is_read(tmp_path, name, comment):
    (tmp_path / name).write_text(ascii_surface(comment))
    is_the_sphere(read_surface(tmp_path / name))


VALUES = np.r_[np.nan, np.linspace(-1.0, 4.0, 41)]


@pytest.mark.parametrize("columns", [1, 5])
def test_a_map_as_text_is_read(tmp_path, columns):
    table = VALUES[:, None] if columns == 1 else np.c_[np.arange(42), VERTS, VALUES]
    (tmp_path / "a.txt").write_text(rows(table))
    np.testing.assert_allclose(read_morph(tmp_path / "a.txt"), VALUES, atol=1e-6)


@pytest.mark.parametrize("text", ["1 2\n3 4\n", "1 2 3 4 5\n7 2 3 4 5\n", "1\n2 3\n", "1\nx\n", "x\n1\n"])
def test_a_text_that_is_no_map_is_refused(tmp_path, text):
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises((DamagedFile, WrongFile)):
        read_morph(tmp_path / "a.txt")


# --- MGH


@pytest.mark.parametrize("name", ["lh.k.mgh", "lh.k.mgz", "lh.k.mgh.gz"])
@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.int32, np.float32])
@pytest.mark.parametrize("shape", [(-1, 1, 1), (1, -1, 1)])
def test_a_map_of_every_type_is_read_from_mgh(tmp_path, name, kind, shape):
    values = np.arange(42).astype(kind)
    raw = nib.freesurfer.mghformat.MGHImage(values.reshape(shape), np.eye(4)).to_bytes()
    (tmp_path / name).write_bytes(raw if name.endswith("h") else gzip.compress(raw))
    np.testing.assert_array_equal(read_morph(tmp_path / name), values)


def test_what_is_written_as_mgh_is_read(tmp_path):
    write_morph(tmp_path / "lh.k.mgh", VALUES, nan=0.0)
    np.testing.assert_array_equal(read_morph(tmp_path / "lh.k.mgh"), np.nan_to_num(VALUES).astype(np.float32))


def test_an_mgh_of_several_maps_is_refused_and_a_huge_one_not_allocated(tmp_path):
    raw = nib.freesurfer.mghformat.MGHImage(np.zeros((42, 1, 1, 2), np.float32), np.eye(4)).to_bytes()
    (tmp_path / "a.mgh").write_bytes(raw)
    with pytest.raises(WrongFile, match="42 x 1 x 1 x 2"):
        read_morph(tmp_path / "a.mgh")
    (tmp_path / "a.mgh").write_bytes(struct.pack(">6i", 1, 2**31 - 1, 1, 1, 1, 3) + raw[24:])
    with pytest.raises(DamagedFile):
        read_morph(tmp_path / "a.mgh")


# --- GIFTI


@pytest.mark.parametrize("encoding", ["ASCII", "Base64Binary", "GZipBase64Binary"])
@pytest.mark.parametrize("order", ["RowMajorOrder", "ColumnMajorOrder"])
@pytest.mark.parametrize("endian", ["LittleEndian", "BigEndian"])
def test_arrays_are_read_as_by_nibabel(tmp_path, encoding, order, endian):
    from nibabel.gifti import GiftiDataArray, GiftiImage

    options = {"encoding": encoding, "ordering": order[0], "endian": endian[:-6].lower()}
    options["ordering"] = {"R": "C", "C": "F"}[order[0]]
    points = GiftiDataArray(VERTS.astype(np.float32), "NIFTI_INTENT_POINTSET", "NIFTI_TYPE_FLOAT32", **options)
    faces = GiftiDataArray(FACES.astype(np.int32), "NIFTI_INTENT_TRIANGLE", "NIFTI_TYPE_INT32", **options)
    raw = GiftiImage(darrays=[points, faces]).to_bytes()
    want = [a.data for a in GiftiImage.from_bytes(raw).darrays]
    (tmp_path / "a.gii").write_bytes(raw)
    got = read_surface(tmp_path / "a.gii")
    np.testing.assert_array_equal(got.verts, want[0])
    np.testing.assert_array_equal(got.faces, want[1])


def test_arrays_in_a_file_beside_it_are_read(tmp_path):
    (tmp_path / "lh.central.gii").write_text(external(at=7))
    (tmp_path / "lh.central.dat").write_bytes(b"8 bytes"[:7] + DAT)
    is_the_sphere(read_surface(tmp_path / "lh.central.gii"), 1e-6)


@pytest.mark.parametrize("name", [*r"../secret.dat /etc/passwd a/b.dat ..\secret.dat C:x.dat ..".split(), ""])
def test_no_other_file_than_one_beside_it_is_read(tmp_path, name):
    inside = tmp_path / "a"
    inside.mkdir()
    (tmp_path / "secret.dat").write_bytes(DAT)
    (inside / "b.dat").write_bytes(DAT)
    (inside / "lh.gii").write_text(external(name))
    with pytest.raises((WrongFile, DamagedFile)) as caught:
        read_surface(inside / "lh.gii")
    assert name in ("..", "") or isinstance(caught.value, WrongFile)


def test_arrays_in_an_annex_are_read_if_they_were_fetched(tmp_path):
    store = tmp_path / ".git/annex/objects/K"
    (tmp_path / "lh.central.dat").symlink_to(".git/annex/objects/K/K")
    (tmp_path / "lh.central.gii").write_text(external(at=0))
    with pytest.raises(NotFetched):
        read_surface(tmp_path / "lh.central.gii")
    store.mkdir(parents=True)
    (store / "K").write_bytes(DAT)
    is_the_sphere(read_surface(tmp_path / "lh.central.gii"), 1e-6)


@pytest.mark.parametrize("size", [None, 0, 100, len(DAT) - 1])
def test_a_missing_or_short_file_beside_it_is_refused(tmp_path, size):
    (tmp_path / "lh.central.gii").write_text(external())
    if size is not None:
        (tmp_path / "lh.central.dat").write_bytes(DAT[:size])
    with pytest.raises(DamagedFile):
        read_surface(tmp_path / "lh.central.gii")


def test_names_of_regions_are_one_line(tmp_path):
    from nibabel.gifti import GiftiDataArray, GiftiImage, GiftiLabel, GiftiLabelTable

    table = GiftiLabelTable()
    table.labels.append(GiftiLabel(1, 0.1, 0.2, 0.3, 1))
    table.labels[0].label = "top\nof \u2028 it"
    array = GiftiDataArray(np.ones(4, np.int32), "NIFTI_INTENT_LABEL", "NIFTI_TYPE_INT32")
    (tmp_path / "a.label.gii").write_bytes(GiftiImage(darrays=[array], labeltable=table).to_bytes())
    assert read_annotation(tmp_path / "a.label.gii").names == (r"top\nof \u2028 it",)


# --- damage


def samples(folder):
    write_gifti_map(folder / "map.gii", VALUES, nan=0.0)
    maps = nib.freesurfer.mghformat.MGHImage(np.arange(42, dtype=np.float32).reshape(-1, 1, 1), np.eye(4)).to_bytes()
    (folder / "lh.central.dat").write_bytes(DAT)
    write_surface(folder / "a.gii", Surface(VERTS, FACES))
    return {
        "a.obj": (mni().encode(), read_surface),
        "a.asc": (ascii_surface().encode(), read_surface),
        "lh.white": (quadrangles(footer_bytes(folder)), read_surface),
        "lh.central.gii": (external().encode(), read_surface),
        "a.gii": ((folder / "a.gii").read_bytes(), read_surface),
        "a.mgh": (maps, read_morph),
        "a.mgz": (gzip.compress(maps, mtime=0), read_morph),
        "map.gii": ((folder / "map.gii").read_bytes(), read_morph),
        "a.txt": (rows(VALUES[:, None]).encode(), read_morph),
    }


@pytest.mark.filterwarnings("ignore::UserWarning")  # of a cut last line
@pytest.mark.parametrize("places", [40, pytest.param(400, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", "a.obj a.asc lh.white lh.central.gii a.gii a.mgh a.mgz map.gii a.txt".split())
def test_damage_ends_in_what_was_there_or_a_refusal(tmp_path, name, places):
    raw, read = samples(tmp_path)[name]
    rng, codes = random.Random(1), set()
    for at in rng.sample(range(len(raw)), min(places, len(raw))):
        changed = bytearray(raw)
        changed[at] = rng.choice([rng.randrange(256), rng.choice(b"0123456789 .-\n")])
        huge = raw[:at] + b"999999999999" + raw[at + 1 :]
        for damaged in (changed, raw[:at] or b" ", huge):
            (tmp_path / name).write_bytes(damaged)
            try:
                read(tmp_path / name)
            except Refusal as error:
                codes.add(error.code)
    assert codes & CODES
    assert codes <= CODES
