"""VTK's files are read without VTK, which ends the process on damaged ones: every layout that it writes, bounded."""

import base64
import re
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest

from morphofold.errors import DamagedFile, WrongFile
from morphofold.io import read_surface, write_surface
from morphofold.io.vtk_files import read_grid
from morphofold.shapes import icosphere
from morphofold.surface import Surface

LEGACY = [(version, binary) for version in (42, 51) for binary in (False, True)]


def sphere():
    import pyvista

    verts, faces = icosphere(1, radius=3.0)
    mesh = pyvista.PolyData.from_regular_faces(verts, faces)
    mesh.point_data["a"] = np.arange(20.0 * len(verts)).reshape(-1, 20)
    mesh.cell_data["b"] = np.ones((len(faces), 3), dtype=np.uint8)
    return mesh


def written_legacy(path, version, binary):
    from vtkmodules.vtkIOLegacy import vtkPolyDataWriter

    writer = vtkPolyDataWriter()
    writer.SetInputData(sphere())
    writer.SetFileName(str(path))
    writer.SetFileVersion(version)
    writer.SetFileTypeToBinary() if binary else writer.SetFileTypeToASCII()
    assert writer.Write()


def written(path, *, mode="Binary", compressor="ZLib", wide=False, big=False, encoded=True):
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

    flat = path.suffix == ".vtp"
    writer = (vtkXMLPolyDataWriter if flat else vtkXMLUnstructuredGridWriter)()
    writer.SetInputData(sphere() if flat else sphere().cast_to_unstructured_grid())
    writer.SetFileName(str(path))
    getattr(writer, f"SetDataModeTo{mode}")()
    getattr(writer, f"SetCompressorTypeTo{compressor}")()
    writer.SetHeaderTypeToUInt64() if wide else writer.SetHeaderTypeToUInt32()
    writer.SetByteOrderToBigEndian() if big else writer.SetByteOrderToLittleEndian()
    writer.SetEncodeAppendedData(encoded)
    assert writer.Write()


def is_the_sphere(path):
    verts, faces = icosphere(1, radius=3.0)
    got = read_surface(path)
    np.testing.assert_allclose(got.verts, verts, atol=1e-6)
    np.testing.assert_array_equal(got.faces, faces)


@pytest.mark.parametrize(("version", "binary"), LEGACY)
def test_legacy_polygons_of_both_layouts_are_read(tmp_path, version, binary):
    written_legacy(tmp_path / "a.vtk", version, binary)
    is_the_sphere(tmp_path / "a.vtk")


@pytest.mark.parametrize("name", ["a.vtp", "a.vtu"])
@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("compressor", ["None", "ZLib", "LZMA"])
@pytest.mark.parametrize(
    ("mode", "encoded"), [("Ascii", True), ("Binary", True), ("Appended", True), ("Appended", False)]
)
def test_every_layout_of_xml_is_read(tmp_path, name, mode, encoded, compressor, wide):
    written(tmp_path / name, mode=mode, compressor=compressor, wide=wide, encoded=encoded, big=wide)
    is_the_sphere(tmp_path / name)
    if name == "a.vtu":
        mesh = read_grid((tmp_path / name).read_bytes())
        np.testing.assert_array_equal(mesh.point_data["a"], np.arange(840.0).reshape(42, 20))
        assert [values.shape for values in mesh.cell_data["b"]] == [(80, 3)]


def test_a_length_that_is_encoded_with_its_numbers_is_read(tmp_path):
    """As meshio writes arrays: one base64 text for both."""
    numbers = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype="<f4").tobytes()
    text = lambda raw: base64.b64encode(struct.pack("<I", len(raw)) + raw).decode()
    corners, ends = (np.array(a, dtype="<i4").tobytes() for a in ([0, 1, 2], [3]))
    array = '<DataArray type="{}" Name="{}" NumberOfComponents="{}" format="binary">{}</DataArray>'
    (tmp_path / "a.vtp").write_text(
        '<VTKFile type="PolyData" byte_order="LittleEndian"><PolyData><Piece NumberOfPoints="3" NumberOfPolys="1">'
        f"<Points>{array.format('Float32', 'p', 3, text(numbers))}</Points><Polys>"
        f"{array.format('Int32', 'connectivity', 1, text(corners))}{array.format('Int32', 'offsets', 1, text(ends))}"
        "</Polys></Piece></PolyData></VTKFile>"
    )
    assert read_surface(tmp_path / "a.vtp").faces.tolist() == [[0, 1, 2]]


def test_sections_without_arrays_are_empty(tmp_path):
    written(tmp_path / "a.vtp", mode="Ascii")
    text = re.sub(r"<(Strips|Lines|Verts)>.*?</\1>", r"<\1></\1>", (tmp_path / "a.vtp").read_text(), flags=re.DOTALL)
    (tmp_path / "a.vtp").write_text(text)
    is_the_sphere(tmp_path / "a.vtp")


def test_a_compressor_that_is_not_known_is_named(tmp_path):
    written(tmp_path / "a.vtp", compressor="LZ4")
    with pytest.raises(WrongFile, match="vtkLZ4DataCompressor"):
        read_surface(tmp_path / "a.vtp")


@pytest.mark.parametrize("what", ["strips", "two pieces"])
def test_what_is_not_one_piece_of_triangles_is_refused_and_not_read_in_part(tmp_path, what):
    written(tmp_path / "a.vtp", mode="Ascii")
    text = (tmp_path / "a.vtp").read_text()
    if what == "strips":
        written_legacy(tmp_path / "a.vtk", 42, False)
        raw = (tmp_path / "a.vtk").read_text().replace("\nPOLYGONS", "\nTRIANGLE_STRIPS 1 5\n4 0 1 2 3\nPOLYGONS")
        (tmp_path / "a.vtk").write_text(raw)
        with pytest.raises(WrongFile):
            read_surface(tmp_path / "a.vtk")
        piece = text.replace('NumberOfStrips="0"', 'NumberOfStrips="1"')
        at = piece.index("</DataArray>", piece.index('Name="offsets"', piece.index("<Strips>")))
        text = piece[:at] + "4" + piece[at:]
    else:
        piece = text[text.index("<Piece") : text.index("</Piece>") + len("</Piece>")]
        text = text.replace(piece, piece + piece)
    (tmp_path / "a.vtp").write_text(text)
    with pytest.raises(WrongFile):
        read_surface(tmp_path / "a.vtp")


@pytest.mark.parametrize("name", ["a.vtp", "a.vtu"])
@pytest.mark.parametrize("mode", ["Binary", "Appended"])
def test_arrays_that_unpack_to_much_are_refused(tmp_path, monkeypatch, name, mode):
    written(tmp_path / name, mode=mode)
    monkeypatch.setattr("morphofold.io.vtk_files.MOST_UNPACKED_BYTES", 1000)  # points alone have 1008
    with pytest.raises(DamagedFile, match=r"\b1000\b"):
        read_surface(tmp_path / name)


@pytest.mark.parametrize(("word", "size"), [(0, 4), (1, 8), (2, 4), (3, 8)])
def test_a_false_size_of_a_block_is_refused(tmp_path, word, size):
    """The number of blocks, the size of one, of the last one, and that of the first one packed, are 2^31."""
    written(tmp_path / "a.vtp", wide=size == 8)
    raw = (tmp_path / "a.vtp").read_bytes()
    at = raw.index(b"AQAAAA", raw.index(b"<Points>"))
    letters = 4 * -(-4 * size // 3)
    head = bytearray(base64.b64decode(raw[at : at + letters]))
    head[word * size : (word + 1) * size] = (2**31).to_bytes(size, "little")
    (tmp_path / "a.vtp").write_bytes(raw[:at] + base64.b64encode(head) + raw[at + letters :])
    with pytest.raises(DamagedFile):
        read_surface(tmp_path / "a.vtp")


def test_a_block_never_unpacks_to_more_than_it_declares(tmp_path):
    written(tmp_path / "a.vtp")
    raw = (tmp_path / "a.vtp").read_bytes()
    start = raw.index(b"AQAAAA", raw.index(b"<Points>"))
    block = zlib.compress(bytes(2**24))
    head = base64.b64encode(struct.pack("<4I", 1, 1008, 1008, len(block)))
    more = raw[:start] + head + base64.b64encode(block) + raw[raw.index(b"</DataArray>", start) :]
    (tmp_path / "a.vtp").write_bytes(more)
    got = read_surface(tmp_path / "a.vtp")  # the numbers that it declares, here zeros
    assert (got.verts.shape, float(np.abs(got.verts).max())) == ((42, 3), 0.0)


@pytest.mark.parametrize("name", ["a.vtk", "a.vtu"])
@pytest.mark.parametrize(("cells", "taken"), [("line", True), ("tetra", True), ("quad", False), (None, False)])
def test_a_grid_is_read_if_its_faces_are_triangles(tmp_path, name, cells, taken):
    """A legacy file holds nothing else than triangles; VTU may have points, lines and tetrahedra beside them."""
    import meshio

    verts, faces = icosphere(1, radius=3.0)
    corners = {"line": [[0, 1]], "tetra": [[0, 1, 2, 3]], "quad": [[0, 1, 2, 3]]}
    blocks = [("tetra", corners["tetra"])] if cells is None else [(cells, corners[cells]), ("triangle", faces)]
    meshio.Mesh(verts, blocks).write(tmp_path / name)
    if taken and name == "a.vtu":
        is_the_sphere(tmp_path / name)
        return
    with pytest.raises(WrongFile):
        read_surface(tmp_path / name)


def test_a_version_5_file_that_says_version_4_is_read(tmp_path):
    """VTK's own reader ends the process on it."""
    written_legacy(tmp_path / "a.vtk", 51, True)
    raw = (tmp_path / "a.vtk").read_bytes()
    (tmp_path / "a.vtk").write_bytes(raw.replace(b"Version 5.1", b"Version 4.2"))
    is_the_sphere(tmp_path / "a.vtk")


def test_vtk_reads_nothing(tmp_path):
    written_legacy(tmp_path / "a.vtk", 42, True)
    written(tmp_path / "a.vtp")
    written(tmp_path / "a.vtu")
    write_surface(tmp_path / "grid.vtk", Surface(*icosphere(1)))
    code = (
        "import sys; from morphofold.io import read_surface\n"
        "for name in sys.argv[1:]: read_surface(name)\n"
        "print([name for name in sys.modules if name.startswith(('vtk', 'pyvista'))])"
    )
    names = [str(tmp_path / name) for name in ("a.vtk", "a.vtp", "a.vtu", "grid.vtk")]
    done = subprocess.run([sys.executable, "-c", code, *names], capture_output=True, text=True, check=True)
    assert re.findall(r"\w+", done.stdout) == []
