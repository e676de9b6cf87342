"""VTK file formats: VTP, VTU and legacy files. VTK itself ends the process on damaged ones: it only writes VTP."""

from __future__ import annotations

import base64
import importlib
import io
import lzma
import re
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold.errors import DamagedFile, WrongFile
from morphofold.io.files import SurfaceContent, atomic_file, check_counts, from_words, write_and_look
from morphofold.surface import Surface

MOST_UNPACKED_BYTES = 2**29  # bytes of all arrays of a file together
_COMPRESSORS: dict[str | None, Any] = {
    "vtkZLibDataCompressor": zlib.decompressobj,
    "vtkLZMADataCompressor": lzma.LZMADecompressor,
}
_HEAD = re.compile(rb"# vtk[^\n]*\n[^\n]*\n\s*(ASCII|BINARY)\s+DATASET\s+(POLYDATA|UNSTRUCTURED_GRID)\b", re.I)
_TYPES = {"float": ">f4", "double": ">f8", "long": ">i8", "vtktypeint64": ">i8", "int": ">i4", "vtkidtype": ">i4"}

Numbers = NDArray[Any]


def read(raw: bytes, path: Path) -> SurfaceContent:
    """Vertices and triangles of VTK polygons, or of an unstructured grid without its lines, points and tetrahedra.

    Raises ``WrongFile`` if the file has faces other than triangles, or no triangles.
    """
    verts, corners, ends = _legacy_faces(raw) if raw.startswith(b"# vtk") else _xml_faces(raw)
    if not len(ends):
        raise WrongFile("it holds no triangles; extract its surface first")
    if not np.array_equal(ends, 3 * np.arange(1, len(ends) + 1)):
        raise WrongFile("it holds faces that are not triangles; triangulate it first")
    faces = corners[: 3 * len(ends)].reshape(len(ends), 3).astype(np.int64)
    return verts.astype(np.float64), faces, None


def read_grid(raw: bytes) -> Any:
    """The ``meshio.Mesh`` in the bytes of a VTU file; of damaged ones, any exception, which ``decoding`` explains."""
    import meshio
    from meshio._vtk_common import vtk_cells_from_data

    piece = _piece(raw, ("Points", "Cells", "PointData", "CellData"))
    cells = (piece["Cells"][name] for name in ("connectivity", "offsets", "types"))
    blocks, of_blocks = vtk_cells_from_data(*cells, piece.get("CellData", {}))
    return meshio.Mesh(piece["Points"]["offsets"], blocks, piece.get("PointData"), of_blocks)


def _xml_faces(raw: bytes) -> tuple[Numbers, Numbers, Numbers]:
    """Points (N, 3), corners of all faces, and where each face ends among them."""
    piece = _piece(raw, ("Points", "Polys", "Strips", "Cells"))
    if len(piece.get("Strips", {}).get("offsets", ())):
        raise WrongFile("it holds strips of triangles; triangulate it first")
    faces = piece.get("Polys") or piece["Cells"]
    corners, ends = faces["connectivity"], faces["offsets"]
    if "types" in faces:
        if not set(faces["types"].tolist()) <= {1, 3, 5, 10}:  # points, lines, triangles, tetrahedra
            raise WrongFile("it holds faces that are not triangles; triangulate it first")
        corners = corners[ends[faces["types"] == 5, None] - [3, 2, 1]].ravel()
        ends = np.arange(3, len(corners) + 1, 3)
    return piece["Points"]["offsets"], corners, ends


def _piece(raw: bytes, sections: Collection[str]) -> dict[str, dict[str, Numbers]]:
    """The arrays of VTK's XML, by element and name; that of the element Points is called offsets, too."""
    head, end = re.search(rb"<AppendedData[^>]*>\s*_", raw), raw.rfind(b"</AppendedData>")
    appended = b"" if head is None else raw[head.end() : end]  # raw bytes, which are no XML, or text
    root = ET.fromstring(raw if head is None else raw[: head.end()] + raw[end:])
    pieces = list(root.iter("Piece"))
    if len(pieces) != 1:
        raise WrongFile(f"it has {len(pieces)} pieces; merge them into one")
    decoder = _Decoder(root, appended, head is not None and b"raw" in head[0])
    sections_read: dict[str, dict[str, Numbers]] = {}
    for section in (element for element in pieces[0] if element.tag in sections):
        arrays = sections_read[section.tag] = {}
        for array in section.iter("DataArray"):
            values, width = decoder.numbers(array), int(array.get("NumberOfComponents") or 1)
            name = "offsets" if section.tag == "Points" else array.get("Name", "")
            arrays[name] = values.reshape(-1, width) if width > 1 else values
        count, number = pieces[0].get(f"NumberOf{section.tag}"), len(arrays.get("offsets", ()))
        if count is not None and number != int(count):
            raise DamagedFile(f"its header declares {count} {section.tag}, but it has {number}")
    return sections_read


class _Decoder:
    """Reads the arrays of VTK's XML: text, or base64 or bytes in their element or appended, compressed or not."""

    def __init__(self, root: ET.Element, appended: bytes, is_raw: bool) -> None:
        self.appended, self.is_raw, self.left = appended, is_raw, MOST_UNPACKED_BYTES
        self.compressor = root.get("compressor")
        if self.compressor not in (None, *_COMPRESSORS):
            raise WrongFile(f"it is compressed by {self.compressor}; save it with zlib, or uncompressed")
        self.order = ">" if root.get("byte_order") == "BigEndian" else "<"
        self.word = np.dtype(f"{self.order}u{8 if root.get('header_type') == 'UInt64' else 4}")

    def numbers(self, array: ET.Element) -> Numbers:
        kind, form, text = np.dtype(array.get("type", "").lower()), array.get("format", "ascii"), array.text or ""
        if form == "ascii":
            return from_words(text.split(), kind)
        inline = form != "appended"
        data = "".join(text.split()).encode() if inline else self.appended[int(array.get("offset", "")) :]
        unpacked = self._unpacked(data, self.is_raw and not inline)
        return np.frombuffer(unpacked, f"{self.order}{kind.str[1:]}").astype(kind)

    def _unpacked(self, data: bytes, is_raw: bool) -> bytes:
        def part(at: int, size: int) -> tuple[bytes, int]:
            """Bytes that were encoded together, and where they end in the file."""
            end = at + (size if is_raw else 4 * -(-size // 3))
            decoded = data[at:end] if is_raw else base64.b64decode(data[at:end], validate=True)
            if len(decoded) < size:
                raise DamagedFile(f"an array declares {size} bytes, but has {len(decoded)}")
            return decoded[:size], end

        def words(count: int) -> tuple[list[int], int]:
            head, end = part(0, count * self.word.itemsize)
            return np.frombuffer(head, self.word).tolist(), end

        if self.compressor is None:
            (size,), end = words(1)
            if is_raw or data[end - 1 : end] == b"=":
                return part(end, size)[0]
            return part(0, self.word.itemsize + size)[0][self.word.itemsize :]
        blocks, each, last = words(3)[0]
        sizes, end = words(3 + blocks)
        self.left -= max(blocks * each, last)
        if self.left < 0:
            raise DamagedFile(f"its arrays unpack to more than {MOST_UNPACKED_BYTES} bytes")
        packed = io.BytesIO(part(end, sum(sizes[3:]))[0])
        start = _COMPRESSORS[self.compressor]
        return b"".join(start().decompress(packed.read(size), max(each, last, 1)) for size in sizes[3:])


def _legacy_faces(raw: bytes) -> tuple[Numbers, Numbers, Numbers]:
    """As :func:`_xml_faces`, for a legacy file: text or binary, with the layout of version 5 or that of older ones."""
    check_counts(raw)
    head = _HEAD.match(raw)
    at = 0 if head is None else head.end()

    def find(pattern: bytes) -> tuple[bytes, ...]:
        """Words of the next line of this pattern; the next numbers begin after it."""
        nonlocal at
        line = re.compile(rb"\s%b[ \t]*\r?\n" % pattern, re.IGNORECASE).search(raw, at)
        if head is None or line is None:
            raise DamagedFile(f"it has no {pattern[:8].decode()}")
        at = line.end()
        return line.groups()

    def numbers(count: int, kind: bytes) -> Numbers:
        nonlocal at
        dtype = np.dtype(_TYPES[kind.decode().lower()])
        if head is not None and head[1].upper() == b"ASCII":
            values = from_words(raw[at:].split(maxsplit=count)[:count], dtype)
            if len(values) < count:
                raise DamagedFile(f"its header declares {count} numbers, but it has {len(values)}")
            return values
        values = np.frombuffer(raw, dtype, count, at)
        at += values.nbytes - 1  # the next line begins with white space
        return values

    n, kind = find(rb"POINTS\s+(\d+)\s+(\w+)")
    points = numbers(3 * int(n), kind).reshape(-1, 3)
    if re.compile(rb"\n\s*TRIANGLE_STRIPS\s").search(raw, at):
        raise WrongFile("it holds strips of triangles; triangulate it first")
    m, size = map(int, find(rb"(?:POLYGONS|CELLS)\s+(\d+)\s+(\d+)"))
    if raw[at : at + 7].upper() == b"OFFSETS":
        at -= 1
        ends = numbers(m, *find(rb"OFFSETS\s+(\w+)"))[1:]
        corners = numbers(size, *find(rb"CONNECTIVITY\s+(\w+)"))
    else:  # each face is its number of corners, and then these
        table = numbers(size, b"int")
        if size != 4 * m or (table[::4] != 3).any():
            raise WrongFile("it holds faces that are not triangles; triangulate it first")
        corners, ends = table.reshape(m, 4)[:, 1:].ravel(), np.arange(3, 3 * m + 1, 3)
    is_grid = head is not None and head[2].upper() != b"POLYDATA"
    if is_grid and (numbers(int(find(rb"CELL_TYPES\s+(\d+)")[0]), b"int") != 5).any():
        raise WrongFile("it holds other cells than triangles; extract its surface first")
    return points, corners, ends


def write(path: Path, surface: Surface) -> None:
    """Write a surface as VTK or VTU, or as VTP in float32, by the ending of the path."""
    import meshio

    if path.suffix.lower() == ".vtp":
        return _write_polygons(path, surface)
    to_file = importlib.import_module(f"meshio.{path.suffix[1:].lower()}").write
    mesh = meshio.Mesh(surface.verts, [("triangle", surface.faces)])
    return write_and_look(path, lambda name: to_file(name, mesh), read)


def _write_polygons(path: Path, surface: Surface) -> None:
    import pyvista
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    with atomic_file(path) as temporary:
        writer = vtkXMLPolyDataWriter()
        writer.SetInputData(pyvista.PolyData.from_regular_faces(surface.verts, surface.faces.astype(int)))
        writer.SetDataModeToBinary()
        writer.WriteToOutputStringOn()  # into memory: VTK ends the process if the disk is full
        writer.Write()
        temporary.write_text(writer.GetOutputString(), encoding="ascii")
