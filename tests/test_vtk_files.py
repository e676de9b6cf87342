"""VTK's files are read by VTK in another process, which ends on damaged ones: every layout that it writes."""

import base64
import re
import struct

import numpy as np
import pytest

from morphofold.errors import DamagedFile, WrongFile
from morphofold.io import read_surface
from morphofold.shapes import icosphere

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
@pytest.mark.parametrize("compressor", ["None", "LZ4", "LZMA"])
@pytest.mark.parametrize(
    ("mode", "encoded"), [("Ascii", True), ("Binary", True), ("Appended", True), ("Appended", False)]
)
def test_every_layout_of_xml_is_read(tmp_path, name, mode, encoded, compressor):
    wide = compressor == "LZMA"
    written(tmp_path / name, mode=mode, compressor=compressor, wide=wide, encoded=encoded, big=wide)
    is_the_sphere(tmp_path / name)


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


@pytest.mark.slow
@pytest.mark.parametrize(("word", "size"), [(0, 4), (2, 4), (3, 8)])
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


@pytest.mark.parametrize("name", ["a.vtk", "a.vtu"])
@pytest.mark.parametrize(("cells", "taken"), [("line", True), ("tetra", True), ("quad", False), (None, False)])
def test_a_grid_is_read_if_its_faces_are_triangles(tmp_path, name, cells, taken):
    import meshio

    verts, faces = icosphere(1, radius=3.0)
    corners = {"line": [[0, 1]], "tetra": [[0, 1, 2, 3]], "quad": [[0, 1, 2, 3]]}
    blocks = [("tetra", corners["tetra"])] if cells is None else [(cells, corners[cells]), ("triangle", faces)]
    meshio.Mesh(verts, blocks).write(tmp_path / name)
    if taken:
        is_the_sphere(tmp_path / name)
        return
    with pytest.raises(WrongFile):
        read_surface(tmp_path / name)


@pytest.mark.parametrize("name", ["a.vtk", "a.vtp"])
def test_strips_are_refused(tmp_path, name):
    sphere().strip().save(tmp_path / name)
    with pytest.raises(WrongFile):
        read_surface(tmp_path / name)
