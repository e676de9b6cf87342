"""What VTK's XML promises is taken from the tags that say it, and bounded by what the bytes may hold."""

import base64
import binascii
import re

import numpy as np
import pytest

from morphofold.errors import DamagedFile
from morphofold.io import read_surface
from morphofold.io.vtk_blocks import MOST_UNPACKED_BYTES, check_blocks
from morphofold.shapes import icosphere


def refused_numbers(raw):
    """The numbers of the refusal of a file."""
    with pytest.raises(DamagedFile) as caught:
        check_blocks(raw)
    return [int(number) for number in re.findall(r"\d+", str(caught.value))]


def written(path, *, appended, zlib, wide, components=20, kind=np.uint64):
    """A sphere with so many components at each point, as VTK writes it; ``wide`` headers have 8 bytes."""
    import pyvista
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    verts, faces = icosphere(1)
    mesh = pyvista.PolyData.from_regular_faces(verts, faces)
    mesh.point_data["a"] = np.ones((len(verts), components), dtype=kind)
    mesh.cell_data["b"] = np.ones((len(faces), 3), dtype=np.uint8)
    writer = vtkXMLPolyDataWriter()
    writer.SetInputData(mesh)
    writer.SetFileName(str(path))
    writer.SetDataModeToAppended() if appended else writer.SetDataModeToBinary()
    if not zlib:
        writer.SetCompressorTypeToNone()
    writer.SetHeaderTypeToUInt64() if wide else writer.SetHeaderTypeToUInt32()
    assert writer.Write()
    return verts, faces


@pytest.mark.parametrize("appended", [False, True])
@pytest.mark.parametrize("zlib", [False, True])
@pytest.mark.parametrize("wide", [False, True])
def test_twenty_components_of_any_number_are_read_whatever_the_headers(tmp_path, appended, zlib, wide):
    path = tmp_path / "a.vtp"
    verts, faces = written(path, appended=appended, zlib=zlib, wide=wide)
    assert b'type="UInt64"' in path.read_bytes()[:1024]
    got = read_surface(path)
    np.testing.assert_allclose(got.verts, verts, atol=1e-6)
    np.testing.assert_array_equal(got.faces, faces)


@pytest.mark.parametrize("appended", [False, True])
@pytest.mark.parametrize("old", [b'"a" NumberOfComponents="20"', b'NumberOfPoints="42"', b'NumberOfPolys="80"'])
def test_more_numbers_than_the_bytes_hold_are_refused(tmp_path, appended, old):
    path = tmp_path / "a.vtp"
    written(path, appended=appended, zlib=False, wide=False)
    raw = path.read_bytes()
    assert old in raw
    for many in (10**6, 2**31 - 1):
        changed = raw.replace(old, re.sub(rb"\d+", b"%d" % many, old))
        promised, size = refused_numbers(changed)
        assert (promised >= many, size) == (True, len(changed))
    check_blocks(raw)


def test_tags_in_comments_and_brackets_in_names_hide_nothing(tmp_path):
    path = tmp_path / "a.vtp"
    written(path, appended=False, zlib=False, wide=False)
    raw = path.read_bytes().replace(b"<PointData", b'<PointData Note=">"')
    raw = raw.replace(b"<PointData", b"<!-- <AppendedData --><PointData")
    check_blocks(raw)
    changed = raw.replace(b'NumberOfComponents="20"', b'NumberOfComponents="999999"')
    promised, size = refused_numbers(changed)
    assert (promised >= 42 * 999999, size) == (True, len(changed))


@pytest.mark.parametrize("appended", [False, True])
@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("word", [0, 1, 2, 3])
def test_blocks_larger_than_the_file_are_refused(tmp_path, appended, wide, word):
    """Their number, their size, that of the last one, and that of the first one packed: VTK allocates what they say."""
    path = tmp_path / "a.vtp"
    written(path, appended=appended, zlib=True, wide=wide)
    raw, size = path.read_bytes(), 8 if wide else 4
    check_blocks(raw)
    if appended:
        at = raw.index(b"_", raw.index(b"<AppendedData")) + 1
        changed = raw[:at] + with_word(raw[at:], word, size, b"base64" in raw)
    else:
        at = raw.index(b"AQAAAA")  # one block
        changed = raw[:at] + with_word(raw[at:], word, size, True)
    found, most = refused_numbers(changed)
    if word in (1, 2):  # all arrays unpacked
        assert (found >= 2**31, most) == (True, MOST_UNPACKED_BYTES)
    else:  # blocks, and the bytes of the file
        assert (found, most) == (2**31 if word == 0 else 1, len(changed))


ONE_BLOCK, NO_BASE64 = "one block that is larger than the file", None
HIDDEN = {  # whether data are appended, what is replaced, by what, what is told
    "offset with format ascii": (True, b'format="appended"', b'format="ascii"', ONE_BLOCK),
    "offset without format": (True, b'format="appended"', b"", ONE_BLOCK),
    "string array, appended": (True, b"DataArray", b"Array", ONE_BLOCK),
    "string array, inline": (False, b"DataArray", b"Array", ONE_BLOCK),
    "any name": (False, b"DataArray", b"Numbers", ONE_BLOCK),
    "bracket in an attribute": (False, b'Name="a"', b'Name="a>AQAA"', r" Name$"),
    "bracket as an entity": (False, b'Name="a"', b'Name="a&gt;"', r" Name$"),
    "bracket before appended data": (True, b"<AppendedData ", b'<AppendedData a=">_" ', r"\bAppendedData\b.* a$"),
    "numbers as entities": (False, b"AQAAAA", b"&#65;QAAAA", NO_BASE64),
    "numbers in brackets": (False, b"AQAAAA", b"<![CDATA[AQ]]>AAAA", NO_BASE64),
    "offset with a line": (True, b'offset="0"', b'offset="0_0"', "'0_0'"),
    "offset below": (True, b'offset="0"', b'offset="-9"', "'-9'"),
    "offset without data": (False, b'format="binary"', b'format="binary" offset="0"', r"^\D*\boffset\b\D*$"),
    "letters before data": (True, b"_AQAAAA", b"x_AQAAAA", r" _$"),
}


@pytest.mark.parametrize("how", HIDDEN)
def test_blocks_do_not_hide(tmp_path, how):
    """VTK goes by the offset before the format, by the type and no name, by the first bracket after a tag begins."""
    appended, old, new, expected = HIDDEN[how]
    path = tmp_path / "a.vtp"
    written(path, appended=appended, zlib=True, wide=False)
    raw = path.read_bytes()
    at = raw.index(b"AQAAAA")
    changed = raw[:at] + with_word(raw[at:], 3, 4, True)
    assert old in changed
    changed = changed.replace(old, new)
    if expected == ONE_BLOCK:
        assert refused_numbers(changed) == [1, len(changed)]
        return
    with pytest.raises(binascii.Error if expected is NO_BASE64 else DamagedFile, match=expected):
        check_blocks(changed)


def test_numbers_in_a_point_are_times_the_points_whatever_an_array_says(tmp_path):
    path = tmp_path / "a.vtp"
    written(path, appended=False, zlib=False, wide=False)
    raw = path.read_bytes()
    many = b'NumberOfComponents="%d" NumberOfTuples="1"' % (len(raw) // 2)
    changed = raw.replace(b'NumberOfComponents="20"', many)
    promised, size = refused_numbers(changed)
    assert (promised >= 42 * (len(raw) // 2), size) == (True, len(changed))


def with_word(text, word, size, coded):
    """An array with 2^31 in place of one of the four words that it begins with."""
    letters = 4 * -(-4 * size // 3) if coded else 4 * size
    head = bytearray(base64.b64decode(text[:letters]) if coded else text[:letters])
    head[word * size : (word + 1) * size] = (2**31).to_bytes(size, "little")
    return (base64.b64encode(head) if coded else bytes(head)) + text[letters:]
