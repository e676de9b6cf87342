"""Surfaces in and out: bit-equal round trips in every format, with the geometry of the volume they came from."""

import gzip
import math
import os
import re

import meshio
import numpy as np
import pytest
import pyvista
from made_surfaces import FOOTER, FORMATS, area, is_small_sphere, one_line, small_sphere, write_legacy_vtk

from morphofold.errors import DamagedFile, WrongFile
from morphofold.io import read_cortex, read_surface, sample_path, scanner_transform, write_surface
from morphofold.io.gifti import write_surface as write_gifti_surface
from morphofold.io.mesh_files import merge_corners
from morphofold.shapes import icosphere
from morphofold.surface import Surface


@pytest.mark.parametrize("name", FORMATS)
def test_a_surface_comes_back_bit_for_bit_compressed_or_not(tmp_path, rough, name):
    path = tmp_path / name
    write_surface(path, rough)
    assert os.listdir(tmp_path) == [name]
    surface = read_surface(path)
    assert surface.name == name
    assert np.array_equal(surface.verts, rough.verts)
    assert np.array_equal(surface.faces, rough.faces)
    if name in ("lh.white", "a.ply", "a.vtk", "a.gii"):
        path.with_name(f"{name}.gz").write_bytes(gzip.compress(path.read_bytes()))
        assert np.array_equal(read_surface(path.with_name(f"{name}.gz")).verts, rough.verts)


@pytest.mark.parametrize("name", ["a.vtk", "a.vtu", "a.obj", "a.off"])
def test_formats_that_hold_float64_keep_it(tmp_path, name):
    surface = Surface(*icosphere(2, radius=math.pi))
    write_surface(tmp_path / name, surface)
    assert np.array_equal(read_surface(tmp_path / name).verts, surface.verts)


def test_an_stl_gets_its_shared_vertices_back_and_says_so(tmp_path, rough):
    write_surface(tmp_path / "a.stl", rough)
    with pytest.warns(UserWarning, match=r"a\.stl: .*\b960\b.*\b162\b"):
        surface = read_surface(tmp_path / "a.stl")
    assert np.array_equal(surface.verts[surface.faces], rough.verts[rough.faces])
    assert len(surface.verts) == len(rough.verts)


def test_merging_keeps_the_order_of_first_appearance_and_takes_minus_zero_for_zero():
    verts = np.array([[5.0, 0, 0], [1, 0, 0], [5, -0.0, 0], [3, 0, 0]])
    with pytest.warns(UserWarning, match="4 corners"):
        merged, faces, _ = merge_corners((verts, np.array([[0, 1, 3], [2, 3, 1]]), None), "a.stl")
    assert merged.tolist() == [[5, 0, 0], [1, 0, 0], [3, 0, 0]]
    assert faces.tolist() == [[0, 1, 2], [0, 2, 1]]


def test_the_content_decides_and_not_the_ending(tmp_path, rough):
    write_surface(tmp_path / "lh.white", rough)
    os.rename(tmp_path / "lh.white", tmp_path / "a.gii")
    assert np.array_equal(read_surface(tmp_path / "a.gii").verts, rough.verts)


def test_an_ending_that_no_format_has_is_refused_before_anything_is_written(tmp_path, rough):
    with pytest.raises(WrongFile, match=r"a\.vkt: .*'\.vkt'"):
        write_surface(tmp_path / "a.vkt", rough)
    assert os.listdir(tmp_path) == []


# --- VTK, whose files another process reads, which ends on damaged ones


@pytest.mark.parametrize(("version", "binary"), [(42, False), (51, True)])
def test_legacy_polygons_of_both_layouts_are_read(tmp_path, version, binary):
    write_legacy_vtk(tmp_path / "a.vtk", version, binary)
    is_small_sphere(read_surface(tmp_path / "a.vtk"))


@pytest.mark.parametrize(
    ("name", "cells"), [("a.vtk", "tetra"), ("a.vtu", "line"), ("a.vtu", "quad"), ("a.vtu", None), ("a.vtp", "strips")]
)
def test_a_grid_is_read_if_its_faces_are_triangles(tmp_path, name, cells):
    verts, faces = icosphere(1, radius=3.0)
    corners = {"line": [[0, 1]], "tetra": [[0, 1, 2, 3]], "quad": [[0, 1, 2, 3]]}
    if cells == "strips":
        small_sphere().strip().save(tmp_path / name)
    else:
        blocks = [("tetra", corners["tetra"])] if cells is None else [(cells, corners[cells]), ("triangle", faces)]
        meshio.Mesh(verts, blocks).write(tmp_path / name)
    if cells in ("line", "tetra"):
        return is_small_sphere(read_surface(tmp_path / name))
    with pytest.raises(WrongFile, match=re.escape(f"{name}: ")) as error:
        read_surface(tmp_path / name)
    one_line(error)


def test_a_damaged_vtp_is_refused_in_one_line_and_vtk_keeps_quiet(tmp_path, rough, capfd, caplog):
    write_surface(tmp_path / "whole.vtp", rough)
    pyvista.read(tmp_path / "whole.vtp").save(tmp_path / "a.vtp", binary=False)
    text = (tmp_path / "a.vtp").read_text()
    (tmp_path / "a.vtp").write_text(text.replace('NumberOfPoints="162"', 'NumberOfPoints="170"'))
    with pytest.raises(DamagedFile, match=r"a\.vtp: ") as error:
        read_surface(tmp_path / "a.vtp")
    one_line(error)
    assert capfd.readouterr() == ("", "")
    assert not caplog.records


# --- the geometry of the volume


@pytest.mark.parametrize("name", ["lh.white", "lh.white.surf.gii"])
def test_the_volume_geometry_survives_a_round_trip(tmp_path, rough, name):
    write_surface(tmp_path / name, Surface(rough.verts, rough.faces, geometry=FOOTER))
    geometry = read_surface(tmp_path / name).geometry
    assert list(geometry) == list(FOOTER)
    for key, value in FOOTER.items():
        assert np.array_equal(geometry[key], value), key


def test_a_gifti_in_the_scanner_frame_is_not_moved_there_again(tmp_path, rough):
    """Its ``C_RAS`` says how it came there; that of one in FreeSurfer's frame, how to go."""
    path = tmp_path / "lh.pial.surf.gii"
    for scanner in (False, True):
        write_gifti_surface(path, Surface(rough.verts, rough.faces, geometry=FOOTER), scanner=scanner)
        assert b"VolGeomC_R" in path.read_bytes()
        assert (read_surface(path).geometry is None) == scanner


def test_only_gifti_says_the_scanners_frame_and_a_sphere_is_one_by_any_of_its_names(tmp_path, rough):
    with pytest.raises(WrongFile):
        write_surface(tmp_path / "lh.white", rough, scanner=True)
    for name in ("lh.sphere.gii", "lh.sphere.surf.gii", "sub-1_hemi-L_sphere.surf.gii", "lh.sphere.gii.gz"):
        write_surface(tmp_path / name, rough)
        raw = (tmp_path / name).read_bytes()
        assert b"Spherical" in (gzip.decompress(raw) if name.endswith(".gz") else raw), name


def test_c_ras_becomes_the_shift_to_scanner_coordinates(tmp_path, rough):
    surface = Surface(rough.verts, rough.faces, geometry=FOOTER)
    for name in ("lh.white", "lh.pial"):
        write_surface(tmp_path / name, surface)
    shift = np.eye(4)
    shift[:3, 3] = FOOTER["cras"]
    assert np.array_equal(read_cortex(tmp_path).transform, shift)


def test_an_oblique_volume_turns_as_its_direction_cosines_say():
    """Both frames reach the same voxel: its first axis is -x in the tkr frame, ``xras`` in the scanner."""
    c, s = math.cos(0.3), math.sin(0.3)
    cosines = {"xras": np.array([-c, -s, 0]), "yras": np.array([0, 0, -1.0]), "zras": np.array([-s, c, 0])}
    transform = scanner_transform({**FOOTER, **cosines})
    voxel = np.array([3.0, -5.0, 7.0])  # from the centre
    tkr = np.array([-voxel[0], voxel[2], -voxel[1]])
    scanner = sum(v * cosines[k] for v, k in zip(voxel, cosines)) + FOOTER["cras"]
    np.testing.assert_allclose(transform[:3, :3] @ tkr + transform[:3, 3], scanner, atol=1e-12)


def test_an_invalid_footer_gives_no_transform():
    average = read_cortex(sample_path("fsaverage5"))
    assert average.white.geometry["valid"].startswith("0")
    assert average.transform is None


# --- samples


@pytest.mark.parametrize("name", ["fsaverage5/surf/lh.white", "S1/lh.pial.surf.gii"])
def test_samples_are_closed_spheres_with_outward_faces(name):
    surface = read_surface(sample_path(name))
    assert len(surface.verts) - len(surface.faces) / 2 == 2
    a, b, c = np.moveaxis(surface.verts[surface.faces], 1, 0)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0
    if name.startswith("S1"):
        assert (len(surface.verts), area(surface)) == (152893, pytest.approx(119337.2, abs=0.05))
