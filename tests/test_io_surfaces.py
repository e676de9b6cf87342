"""Surfaces in and out: bit-equal round trips in every format, with the geometry of the volume they came from."""

import gzip
import math
import os

import numpy as np
import pytest
from made_surfaces import FOOTER, FORMATS, area, one_line

from morphofold.errors import DamagedFile, WrongFile
from morphofold.io import read_cortex, read_surface, sample_path, scanner_transform, write_surface
from morphofold.io.gifti import write_surface as write_gifti_surface
from morphofold.io.mesh_files import merge_corners
from morphofold.shapes import icosphere
from morphofold.surface import Surface


@pytest.mark.parametrize("name", FORMATS)
def test_a_surface_comes_back_bit_for_bit(tmp_path, rough, name):
    write_surface(tmp_path / name, rough)
    again = read_surface(tmp_path / name)
    assert np.array_equal(again.verts, rough.verts)
    assert np.array_equal(again.faces, rough.faces)
    assert again.name == name
    assert os.listdir(tmp_path) == [name]


@pytest.mark.parametrize("name", ["a.vtk", "a.vtu", "a.obj", "a.off"])
def test_formats_that_hold_float64_keep_it(tmp_path, name):
    surface = Surface(*icosphere(2, radius=math.pi))
    write_surface(tmp_path / name, surface)
    assert np.array_equal(read_surface(tmp_path / name).verts, surface.verts)


def test_an_stl_gets_its_shared_vertices_back_and_says_so(tmp_path, rough):
    write_surface(tmp_path / "a.stl", rough)
    with pytest.warns(UserWarning, match=r"a\.stl: .*\b960\b.*\b162\b"):
        again = read_surface(tmp_path / "a.stl")
    assert np.array_equal(again.verts[again.faces], rough.verts[rough.faces])
    assert len(again.verts) == len(rough.verts)


def test_merging_keeps_the_order_of_first_appearance_and_takes_minus_zero_for_zero():
    verts = np.array([[5.0, 0, 0], [1, 0, 0], [5, -0.0, 0], [3, 0, 0]])
    content = verts, np.array([[0, 1, 3], [2, 3, 1]]), None
    with pytest.warns(UserWarning, match="4 corners"):
        merged, faces, _ = merge_corners(content, "a.stl")
    assert merged.tolist() == [[5, 0, 0], [1, 0, 0], [3, 0, 0]]
    assert faces.tolist() == [[0, 1, 2], [0, 2, 1]]


def test_the_content_decides_and_not_the_ending(tmp_path, rough):
    write_surface(tmp_path / "lh.white", rough)
    os.rename(tmp_path / "lh.white", tmp_path / "a.gii")
    assert np.array_equal(read_surface(tmp_path / "a.gii").verts, rough.verts)


def test_a_quadrangle_surface_is_read_as_triangles(tmp_path):
    verts = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=">f4")
    three = lambda *numbers: b"".join(int(n).to_bytes(3, "big") for n in numbers)
    (tmp_path / "lh.orig").write_bytes(b"\xff\xff\xfd" + three(4, 1) + verts.tobytes() + three(0, 1, 2, 3))
    surface = read_surface(tmp_path / "lh.orig")
    assert len(surface.faces) == 2
    assert area(surface) == pytest.approx(1.0)


def test_a_vtk_polygon_file_of_another_writer_is_read(tmp_path):
    text = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\n"
    (tmp_path / "a.vtk").write_text(text + "POLYGONS 1 4\n3 0 1 2\n")
    assert area(read_surface(tmp_path / "a.vtk")) == pytest.approx(0.5)


def test_faces_that_are_no_triangles_are_refused_in_vtk(tmp_path):
    text = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 4 float\n0 0 0 1 0 0 1 1 0 0 1 0\n"
    (tmp_path / "a.vtk").write_text(text + "POLYGONS 1 5\n4 0 1 2 3\n")
    with pytest.raises(WrongFile, match=r"a\.vtk: ") as error:
        read_surface(tmp_path / "a.vtk")
    one_line(error)


def test_a_damaged_vtp_is_refused_in_one_line_and_vtk_keeps_quiet(tmp_path, rough, capfd, caplog):
    import pyvista

    write_surface(tmp_path / "whole.vtp", rough)
    pyvista.read(tmp_path / "whole.vtp").save(tmp_path / "a.vtp", binary=False)
    text = (tmp_path / "a.vtp").read_text()
    (tmp_path / "a.vtp").write_text(text.replace('NumberOfPoints="162"', 'NumberOfPoints="170"'))
    with pytest.raises(DamagedFile, match=r"a\.vtp: ") as error:
        read_surface(tmp_path / "a.vtp")
    one_line(error)
    assert capfd.readouterr() == ("", "")
    assert not caplog.records


def test_a_volume_mesh_without_triangles_is_refused(tmp_path):
    import meshio

    meshio.Mesh(np.eye(4, 3), [("tetra", [[0, 1, 2, 3]])]).write(tmp_path / "a.vtu")
    with pytest.raises(WrongFile, match=r"a\.vtu: "):
        read_surface(tmp_path / "a.vtu")


def test_an_ending_that_no_format_has_is_refused_before_anything_is_written(tmp_path, rough):
    with pytest.raises(WrongFile, match=r"a\.vkt: .*'\.vkt'"):
        write_surface(tmp_path / "a.vkt", rough)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", ["lh.white", "lh.white.surf.gii"])
def test_the_volume_geometry_survives_a_round_trip(tmp_path, rough, name):
    write_surface(tmp_path / name, Surface(rough.verts, rough.faces, geometry=FOOTER))
    again = read_surface(tmp_path / name).geometry
    assert again is not None
    assert list(again) == list(FOOTER)
    for key, value in FOOTER.items():
        assert np.array_equal(again[key], value), key


def test_a_gifti_in_the_scanner_frame_is_not_moved_there_again(tmp_path, rough):
    """Its ``C_RAS`` says how it came there; that of one in FreeSurfer's frame, how to go."""
    path = tmp_path / "lh.pial.surf.gii"
    for scanner in (False, True):
        write_gifti_surface(path, Surface(rough.verts, rough.faces, geometry=FOOTER), scanner=scanner)
        assert b"VolGeomC_R" in path.read_bytes()
        assert (read_surface(path).geometry is None) == scanner


def test_c_ras_becomes_the_shift_to_scanner_coordinates(tmp_path, rough):
    surface = Surface(rough.verts, rough.faces, geometry=FOOTER)
    for name in ("lh.white", "lh.pial"):
        write_surface(tmp_path / name, surface)
    transform = read_cortex(tmp_path).transform
    want = np.eye(4)
    want[:3, 3] = FOOTER["cras"]
    assert np.array_equal(transform, want)


def test_an_oblique_volume_turns_as_its_direction_cosines_say():
    """Both frames reach the same voxel: its first axis is -x in the tkr frame, ``xras`` in the scanner."""
    c, s = math.cos(0.3), math.sin(0.3)
    cosines = {"xras": np.array([-c, -s, 0]), "yras": np.array([0, 0, -1.0]), "zras": np.array([-s, c, 0])}
    transform = scanner_transform({**FOOTER, **cosines})
    assert transform is not None
    voxel = np.array([3.0, -5.0, 7.0])  # from the centre
    tkr = np.array([-voxel[0], voxel[2], -voxel[1]])
    scanner = sum(v * cosines[k] for v, k in zip(voxel, cosines)) + FOOTER["cras"]
    np.testing.assert_allclose(transform[:3, :3] @ tkr + transform[:3, 3], scanner, atol=1e-12)


def test_an_invalid_footer_gives_no_transform():
    average = read_cortex(sample_path("fsaverage5"))
    assert average.white.geometry["valid"].startswith("0")
    assert average.transform is None


@pytest.mark.parametrize("name", ["lh.white", "a.vtk", "a.ply", "a.surf.gii"])
def test_a_compressed_surface_is_read_as_the_same_one(tmp_path, name):
    write_surface(tmp_path / name, Surface(*icosphere(2)))
    (tmp_path / f"{name}.gz").write_bytes(gzip.compress((tmp_path / name).read_bytes()))
    plain, compressed = read_surface(tmp_path / name), read_surface(tmp_path / f"{name}.gz")
    np.testing.assert_array_equal(compressed.verts, plain.verts)
    np.testing.assert_array_equal(compressed.faces, plain.faces)
