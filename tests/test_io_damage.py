"""What is no surface, or a damaged one, is refused in one clear line before it can do harm."""

import gzip
import os
import re
import struct

import numpy as np
import pytest
from made_surfaces import FOOTER, FORMATS, NO_SURFACE, one_line

from morphofold.errors import DamagedFile, OutOfRange, TooLarge, WrongFile
from morphofold.io import read_cortex, read_morph, read_surface, sample_path, write_gifti_map, write_surface
from morphofold.shapes import icosphere
from morphofold.surface import Surface


def test_a_missing_surface_is_named_with_what_lies_beside_it():
    folder = sample_path("fsaverage5/surf")
    with pytest.raises(FileNotFoundError, match=r"surf.lh\.wite: .*\blh\.white\b"):
        read_surface(folder / "lh.wite")


def test_a_folder_instead_of_a_surface_and_a_file_instead_of_a_folder_are_refused():
    with pytest.raises(IsADirectoryError, match="fsaverage5: "):
        read_surface(sample_path("fsaverage5"))
    with pytest.raises(NotADirectoryError, match=r"lh\.white: "):
        read_cortex(sample_path("fsaverage5/surf/lh.white"))


def test_an_empty_file_is_refused(tmp_path):
    (tmp_path / "lh.white").touch()
    with pytest.raises(DamagedFile, match=r"lh\.white: .*\b0\b"):
        read_surface(tmp_path / "lh.white")


def test_a_file_beyond_the_stated_size_is_refused_unread(tmp_path, monkeypatch):
    with (tmp_path / "lh.white").open("wb") as file:
        file.truncate(3 * 2**30)  # sparse: takes no space
    with pytest.raises(TooLarge, match=r"lh\.white: .*\b3\.0 GiB\b.*\b2 GiB\b"):
        read_surface(tmp_path / "lh.white")


def test_a_device_is_refused():
    with pytest.raises(WrongFile, match=os.devnull):
        read_surface(os.devnull)


@pytest.mark.parametrize("name", [*FORMATS, "a.stl", "a.txt"])
@pytest.mark.parametrize("content", [NO_SURFACE.encode(), bytes(range(256)) * 8, b"\n"], ids=["a", "b", "c"])
def test_something_else_than_a_surface_is_refused_in_one_line(tmp_path, capfd, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises((DamagedFile, WrongFile), match=re.escape(name)) as error:
        read_surface(tmp_path / name)
    one_line(error)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", [*(f for f in FORMATS if f != "a.obj"), "a.stl"])
@pytest.mark.parametrize("share", [0.001, 0.02, 0.2, 0.5, 0.9, 0.995])
def test_a_truncated_surface_is_refused_in_one_line(tmp_path, capfd, rough, name, share):
    write_surface(tmp_path / name, Surface(rough.verts, rough.faces, geometry=FOOTER))
    raw = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(raw[: max(1, int(share * len(raw)))])
    with pytest.raises((DamagedFile, WrongFile), match=re.escape(name)) as error:
        read_surface(tmp_path / name)
    one_line(error)
    assert capfd.readouterr() == ("", "")


def test_a_truncated_freesurfer_surface_is_told_its_bytes(tmp_path):
    raw = sample_path("fsaverage5/surf/lh.white").read_bytes()
    (tmp_path / "lh.white").write_bytes(raw[:200_000])
    with pytest.raises(DamagedFile, match=r"\b20480\b.*\b3687\d\d\b.*\b200000\b"):
        read_surface(tmp_path / "lh.white")


def test_a_truncated_footer_is_refused_and_a_missing_one_is_not(tmp_path):
    raw = sample_path("fsaverage5/surf/lh.white").read_bytes()
    end = raw.index(struct.pack(">3i", 2, 0, 20))
    (tmp_path / "lh.white").write_bytes(raw[: end + 60])
    with pytest.raises(DamagedFile, match=rf"lh\.white: .*\b{end + 60}\b"):
        read_surface(tmp_path / "lh.white")
    (tmp_path / "lh.white").write_bytes(raw[:end])
    assert read_surface(tmp_path / "lh.white").geometry is None


@pytest.mark.parametrize("counts", [(2**31 - 1, 2**31 - 1), (-5, 80), (42, 0), (43, 80)])
def test_counts_that_the_file_cannot_hold_are_refused_before_anything_is_allocated(tmp_path, counts):
    write_surface(tmp_path / "lh.white", Surface(*icosphere(1)))
    raw = (tmp_path / "lh.white").read_bytes()
    at = raw.index(b"\n\n") + 2
    (tmp_path / "lh.white").write_bytes(raw[:at] + struct.pack(">2i", *counts) + raw[at + 8 :])
    with pytest.raises(DamagedFile, match=rf"lh\.white: .* {counts[0]}\b.* {counts[1]}\b"):
        read_surface(tmp_path / "lh.white")


def test_a_face_out_of_range_is_refused_with_the_path(tmp_path):
    write_surface(tmp_path / "lh.white", Surface(*icosphere(1)))
    raw = (tmp_path / "lh.white").read_bytes()
    (tmp_path / "lh.white").write_bytes(raw[:-4] + struct.pack(">i", 42))
    with pytest.raises(OutOfRange, match=re.escape(f"{tmp_path / 'lh.white'}: 1 of 80 ")):
        read_surface(tmp_path / "lh.white")


@pytest.mark.parametrize(
    "header",
    [
        "ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n0\n",
        "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 99999999999 float\n0 0 0\n",
        "# vtk DataFile Version 3.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 99999999999 float\n0 0 0\n",
    ],
)
def test_a_promise_of_too_many_elements_is_refused(tmp_path, header):
    (tmp_path / "a.x").write_text(header)
    with pytest.raises(DamagedFile, match=r"\b99999999999\b"):
        read_surface(tmp_path / "a.x")


def test_a_gifti_that_unpacks_to_more_than_it_says_is_refused(tmp_path, rough):
    write_surface(tmp_path / "a.gii", rough)
    text = (tmp_path / "a.gii").read_text().replace('Dim0="162"', 'Dim0="161"')
    (tmp_path / "a.gii").write_text(text)
    with pytest.raises(DamagedFile, match=r"\b486\b.*\(161,3\)"):
        read_surface(tmp_path / "a.gii")


def test_a_compressed_file_that_unpacks_beyond_the_bound_is_refused(tmp_path, monkeypatch):
    (tmp_path / "a.gii.gz").write_bytes(gzip.compress(bytes(2**28 + 1)))
    with pytest.raises(DamagedFile, match=r"a\.gii\.gz: .*\b256 MiB\b"):
        read_surface(tmp_path / "a.gii.gz")


def test_a_gifti_that_keeps_its_data_in_another_file_is_refused(tmp_path, rough):
    write_surface(tmp_path / "a.gii", rough)
    text = (tmp_path / "a.gii").read_text().replace("GZipBase64Binary", "ExternalFileBinary")
    (tmp_path / "a.gii").write_text(text.replace('ExternalFileName=""', 'ExternalFileName="../secret"'))
    with pytest.raises(WrongFile, match=r"'\.\./secret'"):
        read_surface(tmp_path / "a.gii")


def test_a_map_in_place_of_a_surface_and_the_reverse_are_told_apart():
    with pytest.raises(WrongFile, match=r"lh\.thickness: .*\b10242\b"):
        read_surface(sample_path("fsaverage5/surf/lh.thickness"))
    with pytest.raises(WrongFile, match=r"lh\.white: "):
        read_morph(sample_path("fsaverage5/surf/lh.white"))
    with pytest.raises(WrongFile, match=r"lh\.white\.surf\.gii: .*\bpointset \(152893, 3\)"):
        read_morph(sample_path("S1/lh.white.surf.gii"))


def test_a_gifti_map_is_no_surface(tmp_path):
    write_gifti_map(tmp_path / "lh.k.shape.gii", np.ones(10))
    with pytest.raises(WrongFile, match=r"lh\.k\.shape\.gii: \D*\b0\b\D*\b0\b.*\bshape \(10,\)"):
        read_surface(tmp_path / "lh.k.shape.gii")
