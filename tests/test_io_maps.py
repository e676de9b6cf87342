"""Per-vertex maps, annotations and labels in and out: bit-equal round trips, and refusals in one clear line."""

import math
import os
import struct

import nibabel as nib
import numpy as np
import pytest

from morphofold.errors import DamagedFile, Mismatch, NamedTwice, NotFinite, OutOfRange, WrongFile, WrongShape
from morphofold.io import (
    flip_curvature_sign,
    read_annotation,
    read_cortex,
    read_label,
    read_morph,
    sample_path,
    write_annotation,
    write_gifti_map,
    write_morph,
)
from morphofold.surface import Regions


@pytest.fixture(scope="module")
def fsaverage5():
    return read_cortex(sample_path("fsaverage5"))


@pytest.mark.parametrize("name", ["lh.k", "lh.k.shape.gii", "lh.k.shape.gii.gz"])
def test_a_map_comes_back_bit_for_bit(tmp_path, rng, name):
    values = rng.standard_normal(500).astype(np.float32)
    (write_gifti_map if ".gii" in name else write_morph)(tmp_path / name, values)
    assert np.array_equal(read_morph(tmp_path / name), values)


@pytest.mark.parametrize(("write", "name"), [(write_morph, "lh.k"), (write_gifti_map, "lh.k.gii")])
def test_nan_is_refused_with_its_count_unless_a_replacement_is_given(tmp_path, write, name):
    values = np.array([1.0, np.nan, 3.0, np.nan])
    with pytest.raises(NotFinite, match=r": 2 of 4\b.*\b1\b"):
        write(tmp_path / name, values)
    assert os.listdir(tmp_path) == []
    write(tmp_path / name, values, nan=-1.0)
    assert read_morph(tmp_path / name).tolist() == [1, -1, 3, -1]
    write(tmp_path / name, values, nan=math.nan)
    assert np.array_equal(read_morph(tmp_path / name), values, equal_nan=True)


@pytest.mark.parametrize(
    ("name", "values", "error", "message"),
    [
        ("lh.k", [0.0, -np.inf], NotFinite, r": 1 of 2\b.*\b1\b"),
        ("lh.k", [0.0, 1e39], NotFinite, r": 1 of 2\b.*\b1\b"),  # float32 cannot hold it
        ("lh.k", np.ones((4, 3)), WrongShape, r"lh\.k: .*\(4, 3\)"),
        ("k.mgh.gz", np.ones(12), WrongFile, r"k\.mgh\.gz: .* \.mgz"),
    ],
)
def test_what_is_no_map_or_has_no_format_is_refused_when_it_is_written(tmp_path, name, values, error, message):
    with pytest.raises(error, match=message):
        write_morph(tmp_path / name, values)
    assert list(tmp_path.iterdir()) == []


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


def test_an_annotation_comes_back_with_unlabelled_vertices_and_a_value_off_its_table_is_no_region(tmp_path):
    regions = some_regions()
    write_annotation(tmp_path / "lh.aparc.annot", regions)
    again = read_annotation(tmp_path / "lh.aparc.annot")
    assert again.labels.tolist() == [0, 2, -1, 1, 2, 2]
    assert (again.names, again.name) == (regions.names, "aparc")
    assert np.array_equal(again.colours, regions.colours)
    raw = bytearray((tmp_path / "lh.aparc.annot").read_bytes())
    raw[4 + 4 : 4 + 8] = struct.pack(">i", 12345)  # a value of vertex 0 that the table of colours lacks
    (tmp_path / "lh.aparc.annot").write_bytes(raw)
    assert read_annotation(tmp_path / "lh.aparc.annot").labels.tolist() == [-1, 2, -1, 1, 2, 2]


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
    for hemi in ("lh", "rh"):
        path = sample_path(f"fsaverage5/label/{hemi}.aparc.annot")
        labels, table, names = nib.freesurfer.read_annot(path)
        regions = read_annotation(path)
        assert np.array_equal(regions.labels, labels)
        assert np.array_equal(regions.colours, table[:, :3])
        assert regions.names == tuple(n.decode() for n in names)


@pytest.mark.parametrize(
    ("colours", "labels", "error", "message"),
    [
        ([[1, 1, 1], [1, 1, 1]], [0, 1], NamedTwice, r"a\.annot: "),
        ([[0, 0, 0], [1, 1, 1]], [0, -1], OutOfRange, r"\(0, 0, 0\)"),
        ([[2, 2, 2], [1, 1, 1]], [0, 2], OutOfRange, r" 0\.\.2\b.* -1\.\.1\b"),
        ([[2, 2, 2]], [0, 0], WrongShape, r"a\.annot: 2\b.*\(1, 3\)"),
    ],
)
def test_regions_that_the_format_cannot_hold_are_refused(tmp_path, colours, labels, error, message):
    regions = Regions(np.array(labels), ("a", "b"), np.array(colours, dtype=np.uint8))
    with pytest.raises(error, match=message):
        write_annotation(tmp_path / "a.annot", regions)
    assert os.listdir(tmp_path) == []


def test_of_regions_of_one_colour_the_first_is_read_and_can_be_written(tmp_path):
    colours = np.array([[9, 9, 9], [1, 1, 1], [1, 1, 2]], dtype=np.uint8)
    write_annotation(tmp_path / "lh.a.annot", Regions(np.array([0, 1, 2, 1]), ("a", "b", "c"), colours))
    data = (tmp_path / "lh.a.annot").read_bytes()
    (other, same), zero = (np.array(colour, ">i4").tobytes() for colour in ([1, 1, 2], [1, 1, 1])), bytes(4)
    assert data.count(other + zero) == 1
    (tmp_path / "lh.b.annot").write_bytes(data.replace(other + zero, same + zero))
    regions = read_annotation(tmp_path / "lh.b.annot")
    assert regions.names == ("a", "b")
    assert regions.labels.tolist() == [0, 1, -1, 1]  # the colour of c is in the table no more
    write_annotation(tmp_path / "lh.c.annot", regions)
    assert read_annotation(tmp_path / "lh.c.annot").names == ("a", "b")


def test_regions_come_back_from_gifti_whatever_their_names(tmp_path, fsaverage5):
    names = ("???", "a&b <c>", "", *fsaverage5.regions.names[3:])
    labels = np.where(fsaverage5.pial.verts[:, 2] > 0, fsaverage5.regions.labels, -1)
    regions = Regions(labels, names, fsaverage5.regions.colours, "aparc")
    write_annotation(tmp_path / "lh.aparc.label.gii", regions)
    again = read_annotation(tmp_path / "lh.aparc.label.gii")
    assert (again.names, again.name) == (names, "aparc")
    assert np.array_equal(again.labels, labels)
    assert np.array_equal(again.colours, regions.colours)


def test_a_gifti_without_whole_regions_is_refused(tmp_path):
    regions = Regions(np.array([0, 1, -1]), ("front", "back"), np.zeros((2, 3), np.uint8))
    path = tmp_path / "lh.a.label.gii"
    write_annotation(path, regions)
    path.write_text(path.read_text().replace('Key="2"', 'Key="7"'))
    with pytest.raises(DamagedFile, match=r"lh\.a\.label\.gii: \D*\b1\b\D*\b2\b"):
        read_annotation(path)
    write_annotation(path, regions)
    path.write_text(path.read_text()[:-200])
    with pytest.raises(DamagedFile, match=r"lh\.a\.label\.gii: "):
        read_annotation(path)
    write_gifti_map(path, np.ones(3))
    with pytest.raises(WrongFile, match=r"lh\.a\.label\.gii: .*\bshape \(3,\)"):
        read_annotation(path)
    with pytest.raises(OutOfRange, match=r" -1\.\.1\b.* -1\.\.0\b"):
        write_annotation(path, Regions(regions.labels, ("front",), regions.colours[:1]))


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("#!ascii label\n3\n0 0 0 0 0\n1 0 0 0 0\n", DamagedFile, r"a\.label: .*\b3\b.*\b2\b"),
        ("#!ascii label\n1\n42 0 0 0 0\n", Mismatch, r"\b42 to 42\b.*\b0 to 41\b"),
        ("hello\nworld\n", WrongFile, r"a\.label: .*\bhello\b"),
    ],
)
def test_a_label_that_does_not_fit_is_refused(tmp_path, text, error, message):
    (tmp_path / "a.label").write_text(text)
    with pytest.raises(error, match=message):
        read_label(tmp_path / "a.label", 42)


def test_a_label_becomes_a_mask(tmp_path):
    (tmp_path / "a.label").write_text("#!ascii label\n2\n1 0 0 0 0\n3 0 0 0 0\n")
    assert read_label(tmp_path / "a.label", 5).tolist() == [False, True, False, True, False]
    (tmp_path / "b.label").write_text("#!ascii label\n0\n")
    assert not read_label(tmp_path / "b.label", 5).any()
