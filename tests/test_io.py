"""Files in and out: bit-equal round trips, the samples' known facts, and refusals in one clear line."""

import gzip
import json
import math
import os
import re
import shutil
import struct

import numpy as np
import pytest

import morphofold.io.files as files_module
from morphofold.io import (
    atomic_file,
    atomic_folder,
    flip_curvature_sign,
    read_annotation,
    read_cortex,
    read_label,
    read_morph,
    read_surface,
    sample_path,
    scanner_transform,
    write_annotation,
    write_gifti_map,
    write_morph,
    write_surface,
)
from morphofold.io.gifti import read_gifti_regions, write_gifti_regions, write_gifti_surface
from morphofold.io.polygons import merge_equal
from morphofold.shapes import icosphere
from morphofold.surface import Regions, Surface

FORMATS = [
    "lh.white", "bare", "a.gii", "a.surf.gii.gz", "a.ply", "a.obj", "a.off", "a.glb", "a.vtp", "a.vtk",
    "a.vtu",
]  # fmt: skip
FOOTER = {
    "head": np.array([2, 0, 20]), "valid": "1  # volume info valid", "filename": "../mri/orig.mgz",
    "volume": np.array([256, 256, 256]), "voxelsize": np.ones(3),
    "xras": np.array([-1.0, 0.0, 0.0]), "yras": np.array([0.0, 0.0, -1.0]), "zras": np.array([0.0, 1.0, 0.0]),
    "cras": np.array([-0.5, 29.25, -48.875]),
}  # fmt: skip


@pytest.fixture(scope="module")
def fsaverage5():
    return read_cortex(sample_path("fsaverage5"))


@pytest.fixture
def rough(rng):
    """A closed surface whose coordinates float32 holds exactly, near zero too."""
    verts, faces = icosphere(2, radius=40.0)
    verts = verts + 0.5 * rng.standard_normal(verts.shape)
    verts[0] *= 1e-4
    return Surface(verts.astype(np.float32), faces, "rough")


@pytest.fixture
def rng():
    return np.random.default_rng(20)


def area(surface):
    a, b, c = np.moveaxis(surface.verts[surface.faces], 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def one_line(error, limit=420):
    message = str(error.value)
    assert "\n" not in message
    assert len(message) < limit
    return message


# surfaces -----------------------------------------------------------------------------------------


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
    with pytest.warns(UserWarning, match="960 corners at exactly equal places were merged to 162 vertices"):
        again = read_surface(tmp_path / "a.stl")
    assert np.array_equal(again.verts[again.faces], rough.verts[rough.faces])
    assert len(again.verts) == len(rough.verts)


def test_merging_keeps_the_order_of_first_appearance_and_takes_minus_zero_for_zero():
    verts = np.array([[5.0, 0, 0], [1, 0, 0], [5, -0.0, 0], [3, 0, 0]])
    merged, faces = merge_equal(verts, np.array([[0, 1, 3], [2, 3, 1]]))
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
    with pytest.raises(ValueError, match="faces that are no triangles; triangulate it first") as error:
        read_surface(tmp_path / "a.vtk")
    one_line(error)


def test_a_damaged_vtp_is_refused_in_one_line_and_vtk_keeps_quiet(tmp_path, rough, capfd, caplog):
    import pyvista

    write_surface(tmp_path / "whole.vtp", rough)
    pyvista.read(tmp_path / "whole.vtp").save(tmp_path / "a.vtp", binary=False)
    text = (tmp_path / "a.vtp").read_text()
    (tmp_path / "a.vtp").write_text(text.replace('NumberOfPoints="162"', 'NumberOfPoints="170"'))
    with pytest.raises(ValueError, match=r"a\.vtp: is truncated, damaged, or not a surface in VTK format") as error:
        read_surface(tmp_path / "a.vtp")
    one_line(error)
    assert capfd.readouterr() == ("", "")
    assert not caplog.records


def test_a_volume_mesh_without_triangles_is_refused(tmp_path):
    import meshio

    meshio.Mesh(np.eye(4, 3), [("tetra", [[0, 1, 2, 3]])]).write(tmp_path / "a.vtu")
    with pytest.raises(ValueError, match=r"no triangles but \{'tetra': 1\}; extract its surface first"):
        read_surface(tmp_path / "a.vtu")


def test_an_ending_that_no_format_has_is_refused_before_anything_is_written(tmp_path, rough):
    with pytest.raises(ValueError, match=r"no format goes with the ending '\.vkt'"):
        write_surface(tmp_path / "a.vkt", rough)
    assert os.listdir(tmp_path) == []


# footer and scanner coordinates -------------------------------------------------------------------


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
        write_gifti_surface(path, Surface(rough.verts, rough.faces, geometry=FOOTER), "lh", scanner=scanner)
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
    voxel = np.array([3.0, -5.0, 7.0])      # from the centre
    tkr = np.array([-voxel[0], voxel[2], -voxel[1]])
    scanner = sum(v * cosines[k] for v, k in zip(voxel, cosines)) + FOOTER["cras"]
    np.testing.assert_allclose(transform[:3, :3] @ tkr + transform[:3, 3], scanner, atol=1e-12)


def test_an_invalid_footer_gives_no_transform(fsaverage5):
    assert fsaverage5.white.geometry["valid"].startswith("0")
    assert fsaverage5.transform is None


# maps, regions, labels ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["lh.k", "lh.k.shape.gii", "lh.k.shape.gii.gz"])
def test_a_map_comes_back_bit_for_bit(tmp_path, rng, name):
    values = rng.standard_normal(500).astype(np.float32)
    (write_gifti_map if ".gii" in name else write_morph)(tmp_path / name, values)
    assert np.array_equal(read_morph(tmp_path / name), values)


@pytest.mark.parametrize(("write", "name"), [(write_morph, "lh.k"), (write_gifti_map, "lh.k.gii")])
def test_nan_is_refused_with_its_count_unless_a_replacement_is_given(tmp_path, write, name):
    values = np.array([1.0, np.nan, 3.0, np.nan])
    with pytest.raises(ValueError, match="2 of 4 values are NaN; the first is at vertex 1"):
        write(tmp_path / name, values)
    assert os.listdir(tmp_path) == []
    write(tmp_path / name, values, nan=-1.0)
    assert read_morph(tmp_path / name).tolist() == [1, -1, 3, -1]
    write(tmp_path / name, values, nan=math.nan)
    assert np.array_equal(read_morph(tmp_path / name), values, equal_nan=True)


@pytest.mark.parametrize("value", [np.inf, -np.inf, 1e39])
def test_a_value_that_float32_cannot_hold_is_refused(tmp_path, value):
    with pytest.raises(ValueError, match=r"1 of 2 values are infinite or beyond float32.*vertex 1"):
        write_morph(tmp_path / "lh.k", [0.0, value])


def test_a_map_of_the_wrong_shape_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"one value per vertex, shape \(N,\); got \(4, 3\)"):
        write_morph(tmp_path / "lh.k", np.ones((4, 3)))


def test_flipping_the_sign_twice_gives_the_values_back(fsaverage5):
    curv = fsaverage5.maps["curv"]
    assert np.array_equal(flip_curvature_sign(flip_curvature_sign(curv)), curv)
    assert np.array_equal(flip_curvature_sign([1.0, np.nan]), [-1.0, np.nan], equal_nan=True)
    assert not np.signbit(flip_curvature_sign([0.0])[0])


def test_flipped_curv_is_positive_where_the_surface_stands_out(fsaverage5):
    """Gyral crowns lie farther from the centre than sulci: convex positive correlates with radius."""
    verts = fsaverage5.white.verts
    radius = np.linalg.norm((verts - verts.mean(0)) / verts.std(0), axis=1)
    convex = flip_curvature_sign(fsaverage5.maps["sulc"])[fsaverage5.cortex]
    assert np.corrcoef(convex, radius[fsaverage5.cortex])[0, 1] > 0.2


def some_regions():
    colours = np.array([[25, 5, 25], [0, 0, 255], [120, 70, 50]], dtype=np.uint8)
    return Regions(np.array([0, 2, -1, 1, 2, 2]), ("unknown", "ünder", "corpuscallosum"), colours, "aparc")


def test_an_annotation_comes_back_with_unlabelled_vertices(tmp_path):
    regions = some_regions()
    write_annotation(tmp_path / "lh.aparc.annot", regions)
    again = read_annotation(tmp_path / "lh.aparc.annot")
    assert again.labels.tolist() == [0, 2, -1, 1, 2, 2]
    assert (again.names, again.name) == (regions.names, "aparc")
    assert np.array_equal(again.colours, regions.colours)


def test_a_value_that_the_colour_table_lacks_is_no_region(tmp_path):
    write_annotation(tmp_path / "a.annot", some_regions())
    raw = bytearray((tmp_path / "a.annot").read_bytes())
    raw[4 + 4 : 4 + 8] = struct.pack(">i", 12345)      # the value of vertex 0
    (tmp_path / "a.annot").write_bytes(raw)
    assert read_annotation(tmp_path / "a.annot").labels.tolist() == [-1, 2, -1, 1, 2, 2]


def test_names_stay_with_their_colours_when_the_table_has_gaps(tmp_path):
    def text(s):
        return struct.pack(">i", len(s) + 1) + s.encode() + b"\0"

    entries = [(5, "late", (9, 0, 0)), (2, "early", (7, 0, 0))]
    raw = struct.pack(">8i", 2, 0, 9, 1, 7, 1, -2, 6) + text("table") + struct.pack(">i", 2)
    for slot, name, rgb in entries:
        raw += struct.pack(">i", slot) + text(name) + struct.pack(">4i", *rgb, 0)
    (tmp_path / "lh.x.annot").write_bytes(raw)
    regions = read_annotation(tmp_path / "lh.x.annot")
    assert [regions.names[i] for i in regions.labels] == ["late", "early"]


def test_the_reader_of_annotations_agrees_with_nibabel_on_fsaverage5():
    import nibabel.freesurfer as fs

    for hemi in ("lh", "rh"):
        path = sample_path(f"fsaverage5/label/{hemi}.aparc.annot")
        labels, table, names = fs.read_annot(path)
        regions = read_annotation(path)
        assert np.array_equal(regions.labels, labels)
        assert np.array_equal(regions.colours, table[:, :3])
        assert regions.names == tuple(n.decode() for n in names)


@pytest.mark.parametrize(
    ("colours", "labels", "message"),
    [
        ([[1, 1, 1], [1, 1, 1]], [0, 1], "two regions have the same colour"),
        ([[0, 0, 0], [1, 1, 1]], [0, -1], "means 'no region'"),
        ([[2, 2, 2], [1, 1, 1]], [0, 2], r"labels are 0\.\.2, allowed -1\.\.1"),
        ([[2, 2, 2]], [0, 0], r"2 region names, but colours of shape \(1, 3\)"),
    ],
)
def test_regions_that_the_format_cannot_hold_are_refused(tmp_path, colours, labels, message):
    regions = Regions(np.array(labels), ("a", "b"), np.array(colours, dtype=np.uint8))
    with pytest.raises(ValueError, match=message):
        write_annotation(tmp_path / "a.annot", regions)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("#!ascii label\n3\n0 0 0 0 0\n1 0 0 0 0\n", "promises 3 vertices, it has 2"),
        ("#!ascii label\n1\n42 0 0 0 0\n", r"names vertices 42\.\.42, the surface has 0\.\.41"),
        ("hello\nworld\n", "is not a FreeSurfer label"),
    ],
)
def test_a_label_that_does_not_fit_is_refused(tmp_path, text, message):
    (tmp_path / "a.label").write_text(text)
    with pytest.raises(ValueError, match=message):
        read_label(tmp_path / "a.label", 42)


def test_a_label_becomes_a_mask(tmp_path):
    (tmp_path / "a.label").write_text("#!ascii label\n2\n1 0 0 0 0\n3 0 0 0 0\n")
    assert read_label(tmp_path / "a.label", 5).tolist() == [False, True, False, True, False]
    (tmp_path / "b.label").write_text("#!ascii label\n0\n")
    assert not read_label(tmp_path / "b.label", 5).any()


# cortices -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("hemi", "white", "pial", "thickness", "cortex"),
    [("lh", 66661.8, 76345.4, 2.3351, 9354), ("rh", 66619.2, 76671.8, 2.3502, 9361)],
)
def test_fsaverage5_has_the_known_counts_areas_and_thickness(hemi, white, pial, thickness, cortex):
    c = read_cortex(sample_path("fsaverage5"), hemi)
    assert (c.n_vertices, len(c.faces), c.hemi) == (10242, 20480, hemi)
    assert (c.name, c.origin) == ("fsaverage5", "FreeSurfer")
    assert area(c.white) == pytest.approx(white, abs=0.05)
    assert area(c.pial) == pytest.approx(pial, abs=0.05)
    assert set(c.maps) == {"thickness", "curv", "sulc", "area"}
    t = c.maps["thickness"]
    assert t[t > 0].mean() == pytest.approx(thickness, abs=5e-5)
    assert c.cortex.sum() == cortex
    assert c.inflated is not None
    assert len(c.regions.names) == 36
    assert {"unknown", "corpuscallosum", "precentral"} <= set(c.regions.names)
    precentral = c.regions.labels == c.regions.names.index("precentral")
    assert t[precentral].mean() == pytest.approx({"lh": 2.445, "rh": 2.432}[hemi], abs=5e-4)
    assert len(c.files) == 9


def test_the_individual_hemisphere_has_the_known_counts_and_areas():
    c = read_cortex(sample_path("S1"))
    assert (c.n_vertices, len(c.faces), c.hemi, c.name, c.origin) == (152893, 305782, "lh", "S1", "files")
    assert area(c.white) == pytest.approx(91471.5, abs=0.05)
    assert area(c.pial) == pytest.approx(119337.2, abs=0.05)
    assert (c.maps, c.regions, c.cortex) == ({}, None, None)


@pytest.mark.parametrize("name", ["fsaverage5/surf/lh.white", "S1/lh.pial.surf.gii"])
def test_samples_are_closed_spheres_with_outward_faces(name):
    surface = read_surface(sample_path(name))
    assert len(surface.verts) - len(surface.faces) / 2 == 2
    a, b, c = np.moveaxis(surface.verts[surface.faces], 1, 0)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0


def test_two_files_make_a_cortex_with_the_hemisphere_that_they_name():
    folder = sample_path("fsaverage5/surf")
    c = read_cortex(white=folder / "rh.white", pial=folder / "rh.pial")
    assert (c.hemi, c.origin, c.maps) == ("rh", "files", {})
    for wrong in ({"pial": folder / "rh.pial"}, {"pial": folder / "lh.pial", "hemi": "rh"}):
        with pytest.raises(ValueError, match=r"is named .h, but .h was asked for"):
            read_cortex(**{"white": folder / "lh.white", **wrong})


def test_the_surf_folder_itself_stands_for_its_subject():
    assert read_cortex(sample_path("fsaverage5/surf")).regions is not None


def simulation(folder, growths=(1.2, 1.8, 9.5, 10.0)):
    verts, faces = icosphere(1, radius=50.0)
    for g in growths:
        stage = folder / "stages" / f"g{g:.2f}"
        (stage / "surf").mkdir(parents=True)
        write_surface(stage / "surf" / "lh.white", Surface(verts, faces))
        write_surface(stage / "surf" / "lh.pial", Surface(verts * 1.04, faces))
        write_morph(stage / "surf" / "lh.thickness", np.full(len(verts), 2.0))
        facts = {"name": "fig5", "g": g, "portion": 0.125, "units": "mm", "law": "isotropic", "mu_ratio": 2.0}
        (stage / "stage.json").write_text(json.dumps(facts))
    return folder


def test_a_simulation_reads_as_its_last_stage(tmp_path):
    c = read_cortex(simulation(tmp_path / "out"))
    assert (c.origin, c.name, c.hemi, c.units, c.portion) == ("simulation", "fig5 g10.00", "lh", "mm", 0.125)
    assert (c.info["g"], c.info["law"], c.info["mu_ratio"]) == (10.0, "isotropic", 2.0)
    assert c.maps["thickness"].tolist() == [2.0] * 42


def test_one_stage_of_a_simulation_can_be_named(tmp_path):
    assert read_cortex(simulation(tmp_path) / "stages" / "g1.20").info["g"] == 1.2


def test_a_simulation_without_a_stage_says_so(tmp_path):
    (tmp_path / "stages" / ".g1.20.half").mkdir(parents=True)
    with pytest.raises(FileNotFoundError, match=r"no stage .* is written yet"):
        read_cortex(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [("{", "not JSON"), ("[]", "portion in"), ('{"portion": 0}', "got 0"), ('{"portion": "1"}', "got '1'")],
)
def test_a_damaged_stage_record_is_refused(tmp_path, text, message):
    stage = simulation(tmp_path) / "stages" / "g1.80"
    (stage / "stage.json").write_text(text)
    with pytest.raises(ValueError, match=message):
        read_cortex(stage)


def test_a_map_of_another_surface_is_refused_when_a_cortex_is_read(tmp_path):
    stage = simulation(tmp_path) / "stages" / "g1.80"
    write_morph(stage / "surf" / "lh.thickness", np.ones(41))
    with pytest.raises(ValueError, match=r"thickness has shape \(41,\), the surfaces have 42 vertices"):
        read_cortex(stage)


def test_white_and_pial_of_two_subjects_are_refused():
    with pytest.raises(ValueError, match=r"has 10242 vertices and pial .* has 152893"):
        read_cortex(white=sample_path("fsaverage5/surf/lh.white"), pial=sample_path("S1/lh.pial.surf.gii"))


@pytest.mark.parametrize("arguments", [{}, {"white": "lh.white"}, {"path": "x", "white": "w", "pial": "p"}])
def test_neither_or_both_ways_to_name_a_cortex_are_refused(arguments):
    with pytest.raises(TypeError, match="white="):
        read_cortex(**arguments)


# refusals -----------------------------------------------------------------------------------------


def test_a_missing_surface_is_named_with_what_lies_beside_it():
    folder = sample_path("fsaverage5/surf")
    with pytest.raises(FileNotFoundError, match=r"surf.lh\.wite: no such surface\. Close to it.*lh\.white"):
        read_surface(folder / "lh.wite")


def test_a_missing_hemisphere_says_what_was_looked_for():
    with pytest.raises(FileNotFoundError, match=r"rh\.white: no such surface.*tried: rh\.white\.surf\.gii"):
        read_cortex(sample_path("S1"), "rh")


def test_a_missing_folder_says_how_far_the_path_exists(tmp_path):
    with pytest.raises(FileNotFoundError, match=f"exists up to {re.escape(str(tmp_path))}"):
        read_cortex(tmp_path / "no" / "such" / "subject")


def test_a_folder_instead_of_a_surface_and_a_file_instead_of_a_folder_are_refused():
    with pytest.raises(IsADirectoryError, match="is a folder, looked for a surface"):
        read_surface(sample_path("fsaverage5"))
    with pytest.raises(NotADirectoryError, match=r"is a file. Pass its folder"):
        read_cortex(sample_path("fsaverage5/surf/lh.white"))


def test_an_empty_file_is_refused(tmp_path):
    (tmp_path / "lh.white").touch()
    with pytest.raises(ValueError, match=r"is empty \(0 bytes\)"):
        read_surface(tmp_path / "lh.white")


def test_a_file_beyond_the_stated_size_is_refused_unread(tmp_path, monkeypatch):
    with (tmp_path / "lh.white").open("wb") as file:
        file.truncate(3 * 2**30)    # sparse: takes no space
    with pytest.raises(ValueError, match=r"has 3\.0 GiB; a surface may have 2 GiB at most"):
        read_surface(tmp_path / "lh.white")


def test_a_device_is_refused():
    with pytest.raises(ValueError, match="is not a regular file"):
        read_surface(os.devnull)


TEXT = "Dear colleague,\n\nplease find the surface attached.\n" * 40


@pytest.mark.parametrize("name", [*FORMATS, "a.stl", "a.txt"])
@pytest.mark.parametrize("content", [TEXT.encode(), bytes(range(256)) * 8, b"\n"], ids=["a", "b", "c"])
def test_something_else_than_a_surface_is_refused_in_one_line(tmp_path, capfd, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=re.escape(name)) as error:
        read_surface(tmp_path / name)
    one_line(error)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", [*(f for f in FORMATS if f != "a.obj"), "a.stl"])
@pytest.mark.parametrize("share", [0.001, 0.02, 0.2, 0.5, 0.9, 0.995])
def test_a_truncated_surface_is_refused_in_one_line(tmp_path, capfd, rough, name, share):
    write_surface(tmp_path / name, Surface(rough.verts, rough.faces, geometry=FOOTER))
    raw = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(raw[: max(1, int(share * len(raw)))])
    with pytest.raises(ValueError, match=re.escape(name)) as error:
        read_surface(tmp_path / name)
    one_line(error)
    assert capfd.readouterr() == ("", "")


def test_a_truncated_freesurfer_surface_is_told_its_bytes(tmp_path):
    raw = sample_path("fsaverage5/surf/lh.white").read_bytes()
    (tmp_path / "lh.white").write_bytes(raw[:200_000])
    with pytest.raises(ValueError, match=r"20480 triangles need 3687\d\d bytes, it has 200000"):
        read_surface(tmp_path / "lh.white")


def test_a_truncated_footer_is_refused_and_a_missing_one_is_not(tmp_path):
    raw = sample_path("fsaverage5/surf/lh.white").read_bytes()
    end = raw.index(struct.pack(">3i", 2, 0, 20))
    (tmp_path / "lh.white").write_bytes(raw[: end + 60])
    with pytest.raises(ValueError, match="truncated inside its volume-geometry footer"):
        read_surface(tmp_path / "lh.white")
    (tmp_path / "lh.white").write_bytes(raw[:end])
    assert read_surface(tmp_path / "lh.white").geometry is None


@pytest.mark.parametrize("counts", [(2**31 - 1, 2**31 - 1), (-5, 80), (42, 0), (43, 80)])
def test_counts_that_the_file_cannot_hold_are_refused_before_anything_is_allocated(tmp_path, counts):
    write_surface(tmp_path / "lh.white", Surface(*icosphere(1)))
    raw = (tmp_path / "lh.white").read_bytes()
    at = raw.index(b"\n\n") + 2
    (tmp_path / "lh.white").write_bytes(raw[:at] + struct.pack(">2i", *counts) + raw[at + 8 :])
    with pytest.raises(ValueError, match=r"vertices and -?[0-9]+ triangles"):
        read_surface(tmp_path / "lh.white")


def test_a_face_out_of_range_is_refused_with_the_path(tmp_path):
    write_surface(tmp_path / "lh.white", Surface(*icosphere(1)))
    raw = (tmp_path / "lh.white").read_bytes()
    (tmp_path / "lh.white").write_bytes(raw[:-4] + struct.pack(">i", 42))
    with pytest.raises(ValueError, match=re.escape(f"{tmp_path / 'lh.white'}: 1 of 80 faces name a vertex")):
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
    with pytest.raises(ValueError, match="promises 99999999999 elements"):
        read_surface(tmp_path / "a.x")


def test_a_gifti_that_unpacks_to_more_than_it_says_is_refused(tmp_path, rough):
    write_surface(tmp_path / "a.gii", rough)
    text = (tmp_path / "a.gii").read_text().replace('Dim0="162"', 'Dim0="161"')
    (tmp_path / "a.gii").write_text(text)
    with pytest.raises(ValueError, match="161 x 3 values needs 1932 bytes, it unpacks to more"):
        read_surface(tmp_path / "a.gii")


def test_a_compressed_file_that_unpacks_beyond_the_bound_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("morphofold.io.gifti.MAX_BYTES", 2**20)
    (tmp_path / "a.gii.gz").write_bytes(gzip.compress(bytes(2**21)))
    with pytest.raises(ValueError, match="it unpacks to more than"):
        read_surface(tmp_path / "a.gii.gz")


def test_a_gifti_that_keeps_its_data_in_another_file_is_refused(tmp_path, rough):
    write_surface(tmp_path / "a.gii", rough)
    text = (tmp_path / "a.gii").read_text().replace("GZipBase64Binary", "ExternalFileBinary")
    (tmp_path / "a.gii").write_text(text.replace('ExternalFileName=""', 'ExternalFileName="../secret"'))
    with pytest.raises(ValueError, match="ExternalFileBinary is not supported"):
        read_surface(tmp_path / "a.gii")


def test_a_map_in_place_of_a_surface_and_the_reverse_are_told_apart():
    with pytest.raises(ValueError, match="holds one value for each of 10242 vertices, not a surface"):
        read_surface(sample_path("fsaverage5/surf/lh.thickness"))
    with pytest.raises(ValueError, match=r"Is it a surface?"):
        read_morph(sample_path("fsaverage5/surf/lh.white"))
    with pytest.raises(ValueError, match="a map has one array with one value per vertex"):
        read_morph(sample_path("S1/lh.white.surf.gii"))


def test_regions_come_back_from_gifti_whatever_their_names(tmp_path, fsaverage5):
    names = ("???", "a&b <c>", "", *fsaverage5.regions.names[3:])
    labels = np.where(fsaverage5.pial.verts[:, 2] > 0, fsaverage5.regions.labels, -1)
    regions = Regions(labels, names, fsaverage5.regions.colours, "aparc")
    write_gifti_regions(tmp_path / "lh.aparc.label.gii", regions)
    again = read_gifti_regions(tmp_path / "lh.aparc.label.gii", "aparc")
    assert (again.names, again.name) == (names, "aparc")
    assert np.array_equal(again.labels, labels)
    assert np.array_equal(again.colours, regions.colours)


def test_a_gifti_without_whole_regions_is_refused(tmp_path):
    regions = Regions(np.array([0, 1, -1]), ("front", "back"), np.zeros((2, 3), np.uint8))
    path = tmp_path / "lh.a.label.gii"
    write_gifti_regions(path, regions)
    path.write_text(path.read_text().replace('Key="2"', 'Key="7"'))
    with pytest.raises(ValueError, match="its table lacks 1 of its keys, the first is 2"):
        read_gifti_regions(path)
    path.write_text(path.read_text()[:-200])
    with pytest.raises(ValueError, match=r"lh\.a\.label\.gii: is truncated, damaged, or not a GIFTI label file"):
        read_gifti_regions(path)
    write_gifti_map(path, np.ones(3))
    with pytest.raises(ValueError, match="regions are one array with one key per vertex"):
        read_gifti_regions(path)
    with pytest.raises(ValueError, match=r"labels are -1\.\.1, allowed -1\.\.0"):
        write_gifti_regions(path, Regions(regions.labels, ("front",), regions.colours[:1]))


def test_a_gifti_map_is_no_surface(tmp_path):
    write_gifti_map(tmp_path / "lh.k.shape.gii", np.ones(10))
    with pytest.raises(ValueError, match="holds 0 arrays of points and 0 of triangles"):
        read_surface(tmp_path / "lh.k.shape.gii")


@pytest.mark.parametrize("length", [1, 5, 14, 15, 1000, 40982])
@pytest.mark.parametrize("kind", ["thickness", "annotation"])
def test_a_truncated_map_or_annotation_is_refused_in_one_line(tmp_path, kind, length):
    read = {"thickness": read_morph, "annotation": read_annotation}[kind]
    source = {"thickness": "surf/lh.thickness", "annotation": "label/lh.aparc.annot"}[kind]
    (tmp_path / "lh.x").write_bytes(sample_path(f"fsaverage5/{source}").read_bytes()[:length])
    with pytest.raises(ValueError, match=r"lh\.x") as error:
        read(tmp_path / "lh.x")
    one_line(error)


@pytest.mark.parametrize("cut", [1, 30, 500, 1400])
def test_a_truncated_colour_table_is_refused(tmp_path, cut):
    (tmp_path / "a.annot").write_bytes(sample_path("fsaverage5/label/lh.aparc.annot").read_bytes()[:-cut])
    with pytest.raises(ValueError, match="truncated, damaged, or not a FreeSurfer annotation"):
        read_annotation(tmp_path / "a.annot")


@pytest.mark.parametrize("read", [read_morph, read_annotation])
def test_text_is_neither_a_map_nor_an_annotation(tmp_path, read):
    (tmp_path / "lh.x").write_text(TEXT)
    with pytest.raises(ValueError, match=r"lh\.x") as error:
        read(tmp_path / "lh.x")
    one_line(error)


# whole or not at all ------------------------------------------------------------------------------


def interrupt_while_writing(path):
    path.write_text("half")
    raise KeyboardInterrupt


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(KeyboardInterrupt), atomic_file(tmp_path / "a.txt") as temporary:
        interrupt_while_writing(temporary)
    assert os.listdir(tmp_path) == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"


def test_writing_into_a_folder_that_is_not_there_is_refused(tmp_path, rough):
    with pytest.raises(FileNotFoundError, match=r"no such folder to write lh.white into"):
        write_surface(tmp_path / "no" / "lh.white", rough)


def write_folder(out, content="new"):
    with atomic_folder(out) as folder:
        (folder / "a.txt").write_text(content)
        assert not (out / "a.txt").is_file() or (out / "a.txt").read_text() != content


def test_a_folder_appears_whole_and_is_replaced_whole(tmp_path):
    out = tmp_path / "deep" / "out"
    write_folder(out, "first")
    (out / "stale.txt").touch()
    write_folder(out, "second")
    assert sorted(os.listdir(out)) == [".morphofold", "a.txt"]
    assert (out / "a.txt").read_text() == "second"
    assert os.listdir(tmp_path / "deep") == ["out"]


def test_a_failed_folder_leaves_the_old_one_and_nothing_else(tmp_path):
    write_folder(tmp_path / "out", "first")
    for out in (tmp_path / "out", tmp_path / "new" / "deep"):
        with pytest.raises(KeyboardInterrupt), atomic_folder(out) as folder:
            interrupt_while_writing(folder / "a.txt")
    assert os.listdir(tmp_path) == ["out"]
    assert (tmp_path / "out" / "a.txt").read_text() == "first"


def test_an_empty_folder_and_one_with_our_summary_are_replaced(tmp_path):
    (tmp_path / "empty").mkdir()
    write_folder(tmp_path / "empty")
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "summary.json").write_text('{"morphofold": "0.1.0"}')
    write_folder(tmp_path / "old")
    assert not (tmp_path / "old" / "summary.json").exists()


@pytest.mark.parametrize("content", ["{}", "[]", "not json"])
def test_a_folder_of_somebody_else_is_never_replaced(tmp_path, content):
    (tmp_path / "summary.json").write_text(content)
    with pytest.raises(FileExistsError, match=r"morphofold did not write this folder.*summary.json"):
        write_folder(tmp_path)
    assert (tmp_path / "summary.json").read_text() == content
    with pytest.raises(FileExistsError, match="is a file; name a folder"):
        write_folder(tmp_path / "summary.json")


def test_a_folder_that_somebody_fills_meanwhile_is_not_replaced(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(FileExistsError, match="did not write"), atomic_folder(out):
        shutil.copytree(sample_path("S1"), out)
    assert os.listdir(tmp_path) == ["out"]
    assert sorted(os.listdir(out)) == sorted(os.listdir(sample_path("S1")))


def test_a_move_that_fails_puts_the_old_folder_back(tmp_path, monkeypatch):
    out = tmp_path / "out"
    write_folder(out, "first")
    replace = os.replace

    def fail_once(source, target):
        if os.fspath(target) == os.fspath(out) and not os.fspath(source).endswith(".old"):
            raise OSError("disk full")
        replace(source, target)

    monkeypatch.setattr(files_module.os, "replace", fail_once)
    with pytest.raises(OSError, match="disk full"):
        write_folder(out, "second")
    assert os.listdir(tmp_path) == ["out"]
    assert (out / "a.txt").read_text() == "first"


# samples ------------------------------------------------------------------------------------------


def test_every_sample_travels_with_its_origin_and_licence():
    table = sample_path("README.md").read_text()
    for folder in (p for p in sample_path().iterdir() if p.is_dir() and not p.name.startswith(("_", "."))):
        made_elsewhere = f"`{folder.name}/`" in table
        assert made_elsewhere == bool(list(folder.glob("LICENSE*"))), folder.name
        assert (folder / "README.md").is_file() or not made_elsewhere, folder.name
    assert "`fsaverage5/`" in table
    assert "`S1/`" in table


def test_the_licence_of_fsaverage5_begins_with_the_words_it_asks_for():
    text = sample_path("fsaverage5/LICENSE.FreeSurfer.txt").read_text()
    assert text.startswith("All or portions of this licensed product")
    readme = " ".join(sample_path("fsaverage5/README.md").read_text().split())
    assert "average of 40 people" in readme
    assert "obtained under license from The General Hospital Corporation" in readme


def test_a_sample_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(FileNotFoundError, match=r"bert: no such sample\. There are S1, .*fsaverage5"):
        sample_path("bert")


def test_an_analysis_folder_reads_back_with_what_its_surfaces_were(tmp_path):
    """Origin, portion and info decide how a cortex is measured, so measuring an analysis again changes nothing."""
    (tmp_path / "surf").mkdir()
    stage = sample_path("simulated")
    for name in ("lh.white", "lh.pial"):
        (tmp_path / "surf" / name).write_bytes((stage / "surf" / name).read_bytes())
    entry = {"hemi": "lh", "name": "mine", "origin": "simulation", "units": "mm", "portion": 0.5, "info": {"g": 1.9}}
    (tmp_path / "summary.json").write_text(json.dumps({"morphofold": "0", "surfaces": [entry]}))
    cortex = read_cortex(tmp_path)
    assert (cortex.name, cortex.origin, cortex.portion, cortex.info) == ("mine", "simulation", 0.5, {"g": 1.9})
    (tmp_path / "summary.json").write_text(json.dumps({"surfaces": [{**entry, "portion": 7}]}))
    with pytest.raises(ValueError, match=r"summary.json: is not the summary of an analysis of lh \(portion"):
        read_cortex(tmp_path)


@pytest.mark.parametrize("name", ["rh.white", "sub-01_hemi-R_white.surf.gii", "100307.R.white.surf.gii"])
def test_the_hemisphere_is_told_by_the_names_of_a_pair(tmp_path, name):
    cortex = read_cortex(sample_path("fsaverage5"), hemi="rh")
    white, pial = tmp_path / name, tmp_path / name.replace("white", "pial")
    write_surface(white, cortex.white)
    write_surface(pial, cortex.pial)
    assert read_cortex(white=white, pial=pial).hemi == "rh"
    with pytest.raises(ValueError, match="is named rh, but lh was asked for"):
        read_cortex(white=white, pial=pial, hemi="lh")


def test_a_simulation_has_no_right_hemisphere_and_says_so():
    with pytest.raises(ValueError, match="one closed surface named lh"):
        read_cortex(sample_path("simulated"), hemi="rh")
