"""An analysis written and read back, and what is refused."""

import csv
import hashlib
import json
import re
from dataclasses import fields, is_dataclass, replace

import networkx as nx
import nibabel as nib
import nibabel.freesurfer as fs
import numpy as np
import pytest
from made_measures import made_measures

from morphofold.analysis import gyral_graph
from morphofold.errors import NamedTwice, NothingToDo, NotReadable, OptionsClash, WrongFile
from morphofold.io import read_cortex
from morphofold.results import COLUMNS, is_analysis_of, read_analysis, write_analysis, write_dataset
from morphofold.results.analyses import read_stages


def refuse_constant(token):
    raise AssertionError(f"{token} is not JSON")


TURNED = np.array([[0.0, -1, 0, 5], [0.6, 0, 0.8, -7], [-0.8, 0, 0.6, 2], [0, 0, 0, 1]])


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Both hemispheres, written without report."""
    pair = [made_measures("lh"), made_measures("rh")]
    return pair, write_analysis(pair, tmp_path_factory.mktemp("results") / "out", report=False)


@pytest.fixture(scope="module")
def layouts(tmp_path_factory):
    """A turned left hemisphere with all there is, a bare right one; and where they were written in both layouts."""
    left = made_measures("lh", level=4, transform=TURNED, info={"g": 1.8}, portion=0.125, files=("lh.white",))
    left = replace(left, graph=gyral_graph(left.cortex.pial))
    pair, out = [left, made_measures("rh", mask=False, regions=False)], tmp_path_factory.mktemp("layouts")
    plain, place = write_analysis(pair, out / "plain", report=False), write_dataset(pair, out / "d", "b", report=False)
    return pair, {"plain": plain, "bids": place}


def check_alike(want, got, at="measures"):
    """Fail at the first part of two objects that differs by more than float32 can tell."""
    if isinstance(want, nx.Graph):
        check_alike(want.graph, got.graph, at)
        check_alike(dict(want.nodes(data=True)), dict(got.nodes(data=True)), f"{at}.nodes")
        want, got = ({edge: graph.edges[edge] for edge in graph.edges(keys=True)} for graph in (want, got))
    if is_dataclass(want):
        for name in {field.name for field in fields(want)} - {"inputs"}:  # these have digests afterwards
            check_alike(getattr(want, name), getattr(got, name), f"{at}.{name}")
    elif isinstance(want, dict):
        assert want.keys() == got.keys(), at
        for key, value in want.items():
            check_alike(value, got[key], f"{at}.{key}")
    elif isinstance(want, list | tuple):
        assert len(want) == len(got), at
        for k, values in enumerate(zip(want, got, strict=True)):
            check_alike(*values, f"{at}.{k}")
    elif isinstance(want, float | np.ndarray):
        np.testing.assert_allclose(got, want, rtol=1e-6, atol=2e-5, err_msg=at)
    else:
        assert want == got, at


def as_read(m):
    """Measures with tables as they are read: all columns, None for what is missing."""
    tables = {}
    for name, columns in COLUMNS.items():
        keys = lambda row, columns=columns: [*columns, *(key for key in row if key not in columns)]
        rows = [{key: row.get(key) for key in keys(row)} for row in getattr(m, name)]
        tables[name] = [{key: None if value != value else value for key, value in row.items()} for row in rows]
    return replace(m, **tables)


@pytest.mark.parametrize("layout", ["plain", "bids"])
def test_an_analysis_reads_back_as_it_was(layouts, layout):
    pair, folders = layouts
    for want, got in zip(pair, read_analysis(folders[layout]), strict=True):
        check_alike(as_read(want), got)


def test_json_is_strict_and_missing_values_are_null(written):
    _, out = written
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"), parse_constant=refuse_constant)
    assert summary["surfaces"][0]["measures"]["n_hinges"] is None
    assert summary["surfaces"][0]["notes"]["n_hinges"]
    assert "NaN" in summary["nan"]


def test_every_table_has_its_columns_even_when_empty(written):
    _, out = written
    for name, columns in COLUMNS.items():
        with (out / f"{name}.tsv").open(newline="") as file:
            assert tuple(next(csv.reader(file, delimiter="\t"))) == columns
    assert (out / "crests.tsv").read_text().count("\n") == 1
    assert "\tn/a\tn/a\tn/a\n" in (out / "regions.tsv").read_text()  # None and NaN alike


def test_a_missing_value_is_nan_in_gifti_and_zero_in_freesurfer(written):
    pair, out = written
    blank = np.isnan(pair[0].maps["gyral_thickness"])
    assert blank.any()
    gifti = nib.load(out / "maps" / "lh.gyral_thickness.shape.gii").darrays[0].data
    np.testing.assert_array_equal(np.isnan(gifti), blank)
    morph = fs.read_morph_data(out / "maps" / "lh.gyral_thickness")
    assert (morph[blank] == 0).all()
    np.testing.assert_allclose(morph[~blank], gifti[~blank])


def test_the_folder_is_a_freesurfer_subject(written):
    pair, out = written
    verts, faces = fs.read_geometry(out / "surf" / "rh.pial")
    np.testing.assert_allclose(verts, pair[1].cortex.pial.verts, atol=4e-6)
    np.testing.assert_array_equal(faces, pair[1].cortex.faces)
    np.testing.assert_array_equal(
        np.sort(fs.read_label(out / "label" / "lh.cortex.label")), np.flatnonzero(pair[0].cortex.cortex)
    )
    labels, _, names = fs.read_annot(out / "label" / "lh.aparc.annot")
    np.testing.assert_array_equal(labels, pair[0].cortex.regions.labels)
    assert [n.decode() for n in names] == list(pair[0].cortex.regions.names)


def test_inputs_carry_their_hash(tmp_path):
    source = tmp_path / "lh.white"
    source.write_bytes(b"some surface")
    out = write_analysis([made_measures()], tmp_path / "out", inputs=[source, "gone"], report=False)
    recorded = json.loads((out / "summary.json").read_text())["inputs"]
    assert recorded[0] == {"path": str(source), "sha256": hashlib.sha256(b"some surface").hexdigest(), "bytes": 12}
    assert recorded[1] == {"path": "gone", "sha256": None, "bytes": None}


def test_an_analysis_records_what_was_measured_and_not_what_is_there_now(subject, tmp_path):
    folder, m = subject
    m = replace(m, cortex=read_cortex(folder, hemi="lh"))
    pial = folder / "surf" / "lh.pial"
    digest = hashlib.sha256(pial.read_bytes()).hexdigest()
    pial.write_bytes(b"another")
    out = write_analysis([m], tmp_path / "out", report=False)
    dataset = write_dataset([m], tmp_path / "bids", "bert", report=False)
    (again,) = read_analysis(out)  # as `compare` reads it, for its page
    (of_dataset,) = read_analysis(dataset)
    assert again.cortex.inputs == m.cortex.inputs
    for records in (m.cortex.inputs, again.cortex.inputs, of_dataset.cortex.inputs):
        assert {row["path"]: row["sha256"] for row in records}[str(pial)] == digest
    assert not is_analysis_of(out, replace(m.cortex, inputs=()), {})
    assert is_analysis_of(out, m.cortex, {})
    with (out / "maps" / "lh.H").open("r+b") as file:  # one value, of a file as long as before
        file.seek(-3, 2)
        file.write(b"\x01")
    assert not is_analysis_of(out, m.cortex, {})


def test_a_region_whose_name_looks_like_a_number_keeps_it(tmp_path):
    m = made_measures()
    m.regions[1]["region"] = "007"
    read = read_analysis(write_analysis([m], tmp_path / "out", report=False))[0].regions
    assert [r["region"] for r in read] == ["front", "007", "back"]


def test_one_hemisphere_twice_is_refused_and_leaves_nothing(tmp_path):
    with pytest.raises(NamedTwice, match=r"\blh, lh\b"):
        write_analysis([made_measures(), made_measures()], tmp_path / "out")
    with pytest.raises(NothingToDo):
        write_analysis([], tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def subject(tmp_path):
    """A folder with surf/, and measures of the cortex read from it."""
    write_analysis([made_measures()], tmp_path / "all" / "bert", report=False)
    made = made_measures()
    read = read_cortex(tmp_path / "all" / "bert", hemi="lh")
    assert read.files
    return tmp_path / "all" / "bert", replace(made, cortex=replace(made.cortex, files=read.files))


@pytest.mark.parametrize("out", [".", "..", "surf/..", "new/deep", "surf/new"])
def test_an_analysis_is_not_written_over_into_or_around_its_input(subject, out):
    folder, measures = subject
    before = sorted(folder.parent.rglob("*"))
    with pytest.raises(OptionsClash, match=f"^{re.escape(str(folder / out))}: "):
        write_analysis([measures], folder / out, report=False)
    assert sorted(folder.parent.rglob("*")) == before


def test_a_link_to_the_input_is_no_other_folder(subject, tmp_path):
    folder, measures = subject
    (tmp_path / "link").symlink_to(folder, target_is_directory=True)
    with pytest.raises(OptionsClash, match=re.escape(str(tmp_path / "link"))):
        write_analysis([measures], tmp_path / "link", report=False)


def test_an_analysis_may_lie_beside_its_input_or_be_written_again(subject, tmp_path):
    folder, measures = subject
    beside = folder.with_name("bert-analysis")  # begins with the same letters, and is another
    for _ in range(2):
        assert write_analysis([measures], beside, report=False) == beside
    loose = tmp_path / "lh.white"
    loose.write_bytes(b"some surface")  # no subject: its folder may hold the analysis
    write_analysis([made_measures()], tmp_path / "out", inputs=[loose], report=False)
    with pytest.raises(OptionsClash, match=re.escape(str(loose))):
        write_analysis([made_measures()], tmp_path, inputs=[loose], report=False)


def test_a_failure_half_way_leaves_nothing(tmp_path):
    m = made_measures()
    m.maps["../escape"] = m.maps["H"]
    with pytest.raises(NotReadable, match=r"'\.\./escape'"):
        write_analysis([m], tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_no_analysis_is_refused_by_name(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        read_analysis(tmp_path / "nowhere")
    with pytest.raises(FileNotFoundError, match=r"\bsummary\.json\b"):
        read_analysis(tmp_path)
    (tmp_path / "summary.json").write_text('{"surfaces": 3}')
    with pytest.raises(NotReadable, match=r"summary\.json: morphofold: "):
        read_analysis(tmp_path)


@pytest.mark.parametrize("hemi", ["../../etc", "xh"])
def test_a_summary_cannot_lead_outside_its_folder(tmp_path, hemi):
    out = write_analysis([made_measures()], tmp_path / "out", report=False)
    summary = json.loads((out / "summary.json").read_text())
    summary["surfaces"][0]["hemi"] = hemi
    (out / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(NotReadable, match=rf"summary\.json: surfaces\.0\.hemi: .*'{hemi}'"):
        read_analysis(out)
    summary["surfaces"][0].update(hemi="lh", maps=["../../secret"])
    (out / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(NotReadable, match=r"summary\.json: surfaces\.0\.maps\.0: '\.\./\.\./secret'"):
        read_analysis(out)


def test_maps_are_written_as_mgh_and_regions_as_one_row_only_if_asked(written, tmp_path):
    pair, plain = written
    assert not list(plain.rglob("*.mgh"))
    assert not (plain / "regions_wide.tsv").exists()
    out = write_analysis(pair, tmp_path / "out", report=False, mgh=True, wide=True)
    values = pair[1].maps["gyral_thickness"]
    image = nib.load(out / "maps" / "rh.gyral_thickness.mgh")
    assert image.shape == (len(values), 1, 1)
    assert image.get_data_dtype() == np.dtype(">f4")
    np.testing.assert_allclose(np.squeeze(image.dataobj), np.nan_to_num(values), rtol=1e-6)
    assert np.isnan(values).any()
    assert {p.name.count(".") for p in (out / "maps").glob("?h.H*")} == {1, 2, 3}  # rh.H, .mgh, .shape.gii
    with (out / "regions_wide.tsv").open(newline="") as file:
        (row,) = csv.DictReader(file, delimiter="\t")
    assert row["subject"] == "bump"
    assert float(row["rh_middle_thickness"]) == 2.5
    assert row["lh_front_n_hinges"] == "n/a"
    assert set(read_analysis(out)[0].maps) == set(pair[0].maps)


def test_the_volume_geometry_of_a_surface_stays_with_it(tmp_path):
    """c_ras and the rest of the footer: read, measured, written, read again."""
    footer = {
        "head": np.array([2, 0, 20]),
        "valid": "1  # volume info valid",
        "filename": "../mri/filled-pretess255.mgz",
        "volume": np.array([256, 256, 256]),
        "voxelsize": np.ones(3),
        "xras": np.array([-1.0, 0, 0]),
        "yras": np.array([0.0, 0, -1]),
        "zras": np.array([0.0, 1, 0]),
        "cras": np.array([-0.5, 29.25, -48.875]),
    }
    m = made_measures()
    surfaces = {k: replace(getattr(m.cortex, k), geometry=footer) for k in ("white", "pial", "inflated")}
    write_analysis([replace(m, cortex=replace(m.cortex, **surfaces))], tmp_path / "once", report=False)
    again = read_cortex(tmp_path / "once")
    np.testing.assert_array_equal(again.transform[:3, 3], footer["cras"])
    write_analysis([replace(m, cortex=again)], tmp_path / "twice", report=False)
    for name in surfaces:
        verts, _, found = fs.read_geometry(tmp_path / "twice" / "surf" / f"lh.{name}", read_metadata=True)
        assert {k: np.array_equal(v, found[k]) for k, v in footer.items()} == dict.fromkeys(footer, True)
        np.testing.assert_allclose(verts, getattr(m.cortex, name).verts, atol=8e-6)  # still in the surface's frame


def test_an_analysis_of_two_hemispheres_is_no_stage(tmp_path):
    write_analysis([made_measures("lh", level=1), made_measures("rh", level=1)], tmp_path / "g1.20", report=False)
    with pytest.raises(WrongFile, match=r"g1\.20"):
        read_stages(tmp_path)
