"""Analyses written and read back in both layouts: a FreeSurfer subject, and a subject of a BIDS dataset."""

import csv
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import networkx as nx
import nibabel as nib
import nibabel.freesurfer as fs
import numpy as np
import pytest
from made_measures import made_measures

from morphofold.analysis import gyral_graph, measuring
from morphofold.analysis.maps import each_map
from morphofold.analysis.measures_result import SCALARS
from morphofold.cli import main
from morphofold.errors import (
    DamagedFile,
    Mismatch,
    NamedTwice,
    NotFinite,
    NothingToDo,
    NotReadable,
    OptionsClash,
    WrongFile,
)
from morphofold.io import read_cortex, read_surface, sample_path
from morphofold.quantities import COLUMN_WORDS, SCALAR_WORDS
from morphofold.results import COLUMNS, is_analysis_of, read_analysis, write_analysis, write_dataset
from morphofold.results.analysis_files import read_stages
from morphofold.results.layouts import BIDSIGNORE_LINES, map_ending

TRANSFORM = np.array([[1.0, 0, 0, 5], [0, 1, 0, -7], [0, 0, 1, 2], [0, 0, 0, 1]])
ROTATED = np.array([[0.0, -1, 0, 5], [0.6, 0, 0.8, -7], [-0.8, 0, 0.6, 2], [0, 0, 0, 1]])
FILE = re.compile(
    r"sub-[A-Za-z0-9]+(_hemi-[LR])?(_seg-[A-Za-z0-9]+)?(_desc-[A-Za-z0-9]+)?_[A-Za-z]+"
    r"(\.(surf|shape|label)\.gii|\.tsv|\.json)"
)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Both hemispheres of one subject, and their analysis as a folder, without report."""
    pair = [made_measures("lh", transform=TRANSFORM), made_measures("rh")]
    return pair, write_analysis(pair, tmp_path_factory.mktemp("results") / "out", report=False)


@pytest.fixture(scope="module")
def dataset(written, tmp_path_factory):
    """The same pair in a BIDS dataset, and the folder of the subject there."""
    folder = tmp_path_factory.mktemp("bids") / "derivatives"
    return written[0], folder, write_dataset(written[0], folder, "sub-bert_01", report=False)


@pytest.fixture(scope="module")
def layouts(tmp_path_factory):
    """A rotated left hemisphere with all there is, a bare right one; and where they were written in both layouts."""
    left = made_measures("lh", level=4, transform=ROTATED, info={"g": 1.8}, portion=0.125, files=("lh.white",))
    left = replace(left, graph=gyral_graph(left.cortex.pial))
    left.regions[1]["region"] = "007"  # a name that looks like a number
    pair, out = [left, made_measures("rh", mask=False, regions=False)], tmp_path_factory.mktemp("layouts")
    plain = write_analysis(pair, out / "plain", report=False)
    return pair, {"plain": plain, "bids": write_dataset(pair, out / "d", "bert", report=False)}


@pytest.fixture
def copied(layouts, tmp_path):
    """Copies of the two that a test may change, each with its table of regions and its summary."""
    plain, bids = (shutil.copytree(layouts[1][name], tmp_path / name / "sub-bert") for name in ("plain", "bids"))
    stem = bids / "anat" / "sub-bert_desc-"
    return {
        "plain": (plain, plain / "regions.tsv", plain / "summary.json"),
        "bids": (bids, Path(f"{stem}regions_morph.tsv"), Path(f"{stem}morphofold_provenance.json")),
    }


def json_of(path):
    return json.loads(path.read_text(encoding="utf-8"), parse_constant=pytest.fail)


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file, delimiter="\t"))


def check_equal(want, got, name="measures"):
    """Fail at the first part of two objects that differs by more than float32 can tell."""
    if isinstance(want, nx.Graph):
        check_equal(want.graph, got.graph, name)
        check_equal(dict(want.nodes(data=True)), dict(got.nodes(data=True)), f"{name}.nodes")
        want, got = ({edge: graph.edges[edge] for edge in graph.edges(keys=True)} for graph in (want, got))
    if is_dataclass(want):
        for field in {field.name for field in fields(want)} - {"inputs"}:  # these have digests afterwards
            check_equal(getattr(want, field), getattr(got, field), f"{name}.{field}")
    elif isinstance(want, dict):
        assert want.keys() == got.keys(), name
        for key, value in want.items():
            check_equal(value, got[key], f"{name}.{key}")
    elif isinstance(want, list | tuple):
        assert len(want) == len(got), name
        for k, values in enumerate(zip(want, got, strict=True)):
            check_equal(*values, f"{name}.{k}")
    elif isinstance(want, float | np.ndarray):
        np.testing.assert_allclose(got, want, rtol=1e-6, atol=2e-5, err_msg=name)
    else:
        assert want == got, name


def as_read(m):
    """Measures with tables as they are read: all columns, None for missing values."""
    tables = {}
    for name, columns in COLUMNS.items():
        keys = lambda row, columns=columns: [*columns, *(key for key in row if key not in columns)]
        rows = [{key: row.get(key) for key in keys(row)} for row in getattr(m, name)]
        tables[name] = [{key: None if value != value else value for key, value in row.items()} for row in rows]
    return replace(m, **tables)


# both layouts ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("layout", ["plain", "bids"])
def test_an_analysis_reads_back_as_it_was(layouts, layout):
    pair, folders = layouts
    for want, got in zip(pair, read_analysis(folders[layout]), strict=True):
        check_equal(as_read(want), got)


@pytest.mark.parametrize("layout", ["plain", "bids"])
def test_a_table_that_lost_whole_lines_and_a_summary_of_others_are_refused(copied, layout):
    folder, table, summary = copied[layout]
    lines, content = table.read_text().splitlines(keepends=True), json_of(summary)
    table.write_text("".join(lines[:-1]))
    with pytest.raises(DamagedFile, match=rf"{table.name}: \D*\b{len(lines) - 2}\b\D*\b{len(lines) - 1}\b"):
        read_analysis(folder)
    for key, value in (("hemi", "../../etc"), ("maps", ["../../secret"])):
        entry = content["surfaces"][0] | {key: value}
        summary.write_text(json.dumps(content | {"surfaces": [entry, *content["surfaces"][1:]]}))
        with pytest.raises(NotReadable, match=rf"{summary.name}: surfaces\.0\.{key}"):
            read_analysis(folder)


def test_an_analysis_records_the_bytes_that_were_measured(subject, tmp_path):
    folder, m = subject
    m = replace(m, cortex=read_cortex(folder, hemi="lh"))
    pial = folder / "surf" / "lh.pial"
    digest = hashlib.sha256(pial.read_bytes()).hexdigest()
    pial.write_bytes(b"another")
    out = write_analysis([m], tmp_path / "out", report=False)
    for written in (out, write_dataset([m], tmp_path / "bids", "bert", report=False)):
        (again,) = read_analysis(written)
        assert {row["path"]: row["sha256"] for row in again.cortex.inputs}[str(pial)] == digest
    assert not is_analysis_of(out, replace(m.cortex, inputs=()), {})
    assert is_analysis_of(out, m.cortex, {})
    with (out / "maps" / "lh.H").open("r+b") as file:  # one value, of a file as long as before
        file.seek(-3, 2)
        file.write(b"\x01")
    assert not is_analysis_of(out, m.cortex, {})


def test_a_failure_half_way_and_a_hemisphere_twice_leave_nothing(tmp_path):
    infinite = made_measures()
    infinite.maps["H"][3] = np.inf
    with pytest.raises(NotFinite, match=r"_curv\S*: 1 of \d+\b.*\b3\b"):
        write_dataset([infinite, made_measures("rh")], tmp_path / "d", "bert", report=False)
    for hemispheres, error in (([], NothingToDo), ([made_measures(), made_measures()], NamedTwice)):
        with pytest.raises(error):
            write_analysis(hemispheres, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


# a folder ----------------------------------------------------------------------------------------------------


def test_json_is_strict_and_tables_have_their_columns_even_when_empty(written):
    _, out = written
    summary = json_of(out / "summary.json")
    assert summary["surfaces"][0]["measures"]["n_hinges"] is None
    assert summary["surfaces"][0]["notes"]["n_hinges"]
    assert "NaN" in summary["nan"]
    for name, columns in COLUMNS.items():
        assert tuple((out / f"{name}.tsv").read_text().splitlines()[0].split("\t")) == columns
    assert "\tn/a\tn/a\tn/a\n" in (out / "regions.tsv").read_text()  # None and NaN both


def test_the_folder_is_a_freesurfer_subject_whose_missing_values_are_nan_in_gifti_and_zero_elsewhere(written):
    pair, out = written
    left, right = pair
    verts, faces = fs.read_geometry(out / "surf" / "rh.pial")
    np.testing.assert_allclose(verts, right.cortex.pial.verts, atol=4e-6)
    np.testing.assert_array_equal(faces, right.cortex.faces)
    label = np.sort(fs.read_label(out / "label" / "lh.cortex.label"))
    np.testing.assert_array_equal(label, np.flatnonzero(left.cortex.cortex))
    labels, _, names = fs.read_annot(out / "label" / "lh.aparc.annot")
    np.testing.assert_array_equal(labels, left.cortex.regions.labels)
    assert [n.decode() for n in names] == list(left.cortex.regions.names)
    blank = np.isnan(left.maps["gyral_thickness"])
    assert blank.any()
    gifti = nib.load(out / "maps" / "lh.gyral_thickness.shape.gii").darrays[0].data
    np.testing.assert_array_equal(np.isnan(gifti), blank)
    morph = fs.read_morph_data(out / "maps" / "lh.gyral_thickness")
    assert (morph[blank] == 0).all()
    np.testing.assert_allclose(morph[~blank], gifti[~blank])


@pytest.fixture
def subject(tmp_path):
    """A folder with surf/, and measures of the cortex read from it."""
    m = made_measures()
    folder = write_analysis([m], tmp_path / "all" / "bert", report=False)
    return folder, replace(m, cortex=replace(m.cortex, files=read_cortex(folder, hemi="lh").files))


@pytest.mark.parametrize("out", [".", "..", "surf/new"])
def test_an_analysis_is_written_beside_its_input_and_not_over_into_or_around_it(subject, out):
    folder, measures = subject
    before = sorted(folder.parent.rglob("*"))
    with pytest.raises(OptionsClash, match=f"^{re.escape(str(folder / out))}: "):
        write_analysis([measures], folder / out, report=False)
    assert sorted(folder.parent.rglob("*")) == before
    sibling = folder.with_name("bert-analysis")  # begins with the same letters, and is another
    for _ in range(2):
        assert write_analysis([measures], sibling, report=False) == sibling


def test_a_folder_that_is_no_analysis_is_refused_by_name(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        read_analysis(tmp_path / "nowhere")
    with pytest.raises(FileNotFoundError, match=r"\bsummary\.json\b"):
        read_analysis(tmp_path)
    pair = [made_measures("lh", level=1), made_measures("rh", level=1)]
    write_analysis(pair, tmp_path / "stages" / "g1.20", report=False)
    with pytest.raises(WrongFile, match=r"g1\.20"):  # two hemispheres are no stage
        read_stages(tmp_path / "stages")


def test_mgh_maps_and_one_row_of_regions_are_written_on_request_only(written, tmp_path):
    pair, plain = written
    assert not [*plain.rglob("*.mgh"), *plain.rglob("regions_wide.tsv")]
    out = write_analysis(pair, tmp_path / "out", report=False, mgh=True, wide=True)
    values = pair[1].maps["gyral_thickness"]
    image = nib.load(out / "maps" / "rh.gyral_thickness.mgh")
    assert (image.shape, image.get_data_dtype()) == ((len(values), 1, 1), np.dtype(">f4"))
    np.testing.assert_allclose(np.squeeze(image.dataobj), np.nan_to_num(values), rtol=1e-6)
    (row,) = rows_of(out / "regions_wide.tsv")
    assert (row["subject"], float(row["rh_middle_thickness"]), row["lh_front_n_hinges"]) == ("bump", 2.5, "n/a")


def test_the_volume_geometry_of_a_surface_stays_with_it(tmp_path):
    """c_ras and the rest of the footer: read, measured, written, read again."""
    footer = {"head": np.array([2, 0, 20]), "valid": "1  # volume info valid", "filename": "../mri/filled.mgz"}
    footer |= {"volume": np.array([256, 256, 256]), "voxelsize": np.ones(3)}
    footer |= dict(zip(("xras", "yras", "zras"), np.array([[-1.0, 0, 0], [0, 0, -1], [0, 1, 0]])))
    footer["cras"] = np.array([-0.5, 29.25, -48.875])
    m = made_measures()
    surfaces = {k: replace(getattr(m.cortex, k), geometry=footer) for k in ("white", "pial", "inflated")}
    write_analysis([replace(m, cortex=replace(m.cortex, **surfaces))], tmp_path / "once", report=False)
    again = read_cortex(tmp_path / "once")
    np.testing.assert_array_equal(again.transform[:3, 3], footer["cras"])
    write_analysis([replace(m, cortex=again)], tmp_path / "twice", report=False)
    for name in surfaces:
        verts, _, copy = fs.read_geometry(tmp_path / "twice" / "surf" / f"lh.{name}", read_metadata=True)
        assert {k: np.array_equal(v, copy[k]) for k, v in footer.items()} == dict.fromkeys(footer, True)
        np.testing.assert_allclose(verts, getattr(m.cortex, name).verts, atol=8e-6)  # still in the surface's frame


# a dataset ---------------------------------------------------------------------------------------------------


def test_the_dataset_names_its_maker_and_every_file_has_a_bids_name(dataset):
    _, folder, person = dataset
    description = json_of(folder / "dataset_description.json")
    assert (description["DatasetType"], description["GeneratedBy"][0]["Name"]) == ("derivative", "morphofold")
    assert person == folder / "sub-bert01"
    names = sorted(p.name for p in (person / "anat").iterdir())
    assert [n for n in names if not FILE.fullmatch(n)] == []
    data = {n.split(".")[0] for n in names if n.endswith((".shape.gii", ".label.gii", ".tsv"))}
    assert data == {n.split(".")[0] for n in names if n.endswith(".json")} - {"sub-bert01_desc-morphofold_provenance"}


def test_every_column_of_every_table_is_described(dataset):
    tables = sorted((dataset[2] / "anat").glob("*_morph.tsv"))
    assert len(tables) == len(COLUMNS) + 1
    unit = {"_mm": "mm", "_mm2": "mm^2", "_mm3": "mm^3", "_per_mm": "1/mm", "_deg": "degree"}
    for table in tables:
        sidecar = json_of(table.with_suffix(".json"))
        assert list(sidecar) == table.read_text().splitlines()[0].split("\t")
        assert not {None, "", "nan"} & {value for row in rows_of(table) for value in row.values()}
        for column in sidecar:
            expected = [u for end, u in unit.items() if column.endswith(end)]
            assert not expected or sidecar[column]["Units"] == expected[-1]
    assert {k for columns in COLUMNS.values() for k in columns} | set(SCALARS) <= {*COLUMN_WORDS, *SCALAR_WORDS}


def test_maps_keep_nan_and_only_curv_has_freesurfers_sign(dataset):
    pair, _, person = dataset
    for m, side, structure in zip(pair, "LR", ("CortexLeft", "CortexRight")):
        stem = person / "anat" / f"sub-bert01_hemi-{side}"
        for end, values in (("curv", -m.maps["H"]), ("desc-gyral_thickness", m.maps["gyral_thickness"])):
            image = nib.load(f"{stem}_{end}.shape.gii")
            assert image.meta["AnatomicalStructurePrimary"] == structure
            np.testing.assert_allclose(image.darrays[0].data, values, rtol=1e-6)
            assert np.isnan(values).any()
        assert "positive in sulci" in json_of(stem.with_name(f"{stem.name}_curv.json"))["Description"]
        sidecar = json_of(stem.with_name(f"{stem.name}_desc-gyral_thickness.json"))
        assert (sidecar["Units"], sidecar["Description"]) == ("mm", "Gyral thickness")


def test_surfaces_and_hinges_are_in_scanner_coordinates_where_these_are_known(dataset):
    pair, _, person = dataset
    for m, side, shift in zip(pair, "LR", ([5, -7, 2], [0, 0, 0])):
        for kind in ("white", "pial"):
            file = person / "anat" / f"sub-bert01_hemi-{side}_{kind}.surf.gii"
            surface, points = read_surface(file), nib.load(file).darrays[0]
            np.testing.assert_allclose(surface.verts, getattr(m.cortex, kind).verts + shift, atol=8e-6)
            np.testing.assert_array_equal(surface.faces, m.cortex.faces)
            space = nib.nifti1.xform_codes.label[points.coordsys.dataspace]
            assert space == {"L": "scanner", "R": "unknown"}[side]
            assert points.meta["AnatomicalStructurePrimary"] == {"L": "CortexLeft", "R": "CortexRight"}[side]
            assert points.meta["AnatomicalStructureSecondary"] == {"white": "GrayWhite", "pial": "Pial"}[kind]
            assert surface.geometry is None  # or its c_ras would be added once more
        flat = read_surface(person / "anat" / f"sub-bert01_hemi-{side}_inflated.surf.gii")
        np.testing.assert_allclose(flat.verts, m.cortex.inflated.verts, atol=8e-6)
    hinges = rows_of(person / "anat" / "sub-bert01_desc-hinges_morph.tsv")
    left, right = ([float(row[k]) for k in "xyz"] for row in hinges)
    assert (left, right) == ([6.5, -9.0, 32.0], [1.5, -2.0, 30.0])


def test_regions_and_mask_have_a_key_per_vertex_and_its_meaning(dataset):
    pair, folder, person = dataset
    for m, side in zip(pair, "LR"):
        stem = person / "anat" / f"sub-bert01_hemi-{side}"
        for end, labels in (("seg-aparc_dseg", m.cortex.regions.labels), ("desc-cortex_mask", m.cortex.cortex - 1)):
            image = nib.load(f"{stem}_{end}.label.gii")
            np.testing.assert_array_equal(image.darrays[0].data, labels + 1)
            assert image.labeltable.get_labels_as_dict()[0] == "???"
            sidecar = json_of(stem.with_name(f"{stem.name}_{end}.json"))
            assert (folder / sidecar["SpatialReference"].removeprefix("bids::")).is_file()
        rows = {int(row["index"]): row for row in rows_of(stem.with_name(f"{stem.name}_seg-aparc_dseg.tsv"))}
        labels = nib.load(f"{stem}_seg-aparc_dseg.label.gii").labeltable.labels
        assert {k: row["name"] for k, row in rows.items() if k} == {e.key: e.label for e in labels if e.key}
        colours = [tuple(bytes.fromhex(rows[entry.key]["color"][1:])) for entry in labels[1:]]
        assert colours == [tuple(colour) for colour in m.cortex.regions.colours.tolist()]
        np.testing.assert_allclose([entry.rgba[:3] for entry in labels[1:]], np.array(colours) / 255, atol=1e-6)


def test_the_gyral_graph_lies_on_the_surface_beside_it(layouts):
    """Both are in scanner coordinates, which are far from the surface's own."""
    anat = layouts[1]["bids"] / "anat"
    pial = read_surface(anat / "sub-bert_hemi-L_pial.surf.gii")
    nodes = json_of(anat / "sub-bert_hemi-L_desc-graph_morph.json")["nodes"]
    positions = np.array([node["position"] for node in nodes])
    edges = pial.verts[pial.faces] - pial.verts[np.roll(pial.faces, 1, axis=1)]
    off = np.linalg.norm(positions - pial.verts[[node["vertex"] for node in nodes]], axis=1)
    assert off.max() < np.linalg.norm(edges, axis=2).max()
    outward = np.array([node["normal"] for node in nodes])
    assert (((positions - pial.verts.mean(0)) * outward).sum(1) > 0).all()  # it was rotated, too


@pytest.mark.parametrize(
    "end", ["L_pial.surf.gii", "L_seg-aparc_dseg.label.gii", "hinges_morph.tsv", "provenance.json"]
)
def test_a_file_that_is_missing_cut_short_or_of_another_analysis_is_named(copied, dataset, end):
    folder = copied["bids"][0]
    (file,) = (folder / "anat").glob(f"*{end}")
    content = file.read_bytes()
    file.write_bytes(content[: len(content) * 2 // 3])
    with pytest.raises(DamagedFile, match=re.escape(str(file))):
        read_analysis(folder)
    file.unlink()
    name = file.name.replace("bert", "NAME") if "provenance" in file.name else file.name
    with pytest.raises(FileNotFoundError, match=re.escape(name)):
        read_analysis(folder)
    if end.endswith("label.gii"):
        shutil.copy(dataset[2] / "anat" / file.name.replace("bert", "bert01"), file)
        with pytest.raises(Mismatch, match=rf"{re.escape(file.name)}: .*\(642,\).*\b2562\b"):
            read_analysis(folder)


def test_other_subjects_and_additions_to_a_dataset_stay_and_the_same_subject_is_replaced(tmp_path):
    folder = tmp_path / "d"
    write_dataset([made_measures()], folder, "anna", report=False)
    (folder / "participants.tsv").write_text("participant_id\n")
    (folder / ".bidsignore").write_text("*.html\nnotes\n")
    description = json_of(folder / "dataset_description.json") | {"Authors": ["A. One", "B. Two"]}
    (folder / "dataset_description.json").write_text(json.dumps(description))
    write_dataset([made_measures()], folder, "bert", report=False)
    write_dataset([made_measures("rh")], folder, "anna", report=False)
    files = {".bidsignore", "README.md", "dataset_description.json", "participants.tsv"}
    assert {p.name for p in folder.iterdir()} == {*files, "sub-anna", "sub-bert"}
    assert not list((folder / "sub-anna").rglob("*hemi-L*"))
    assert json_of(folder / "dataset_description.json") == description
    lines = (folder / ".bidsignore").read_text().splitlines()
    assert sorted(lines) == sorted({*BIDSIGNORE_LINES, "notes"})  # those of an older version are renewed


def test_datasets_and_files_of_others_are_refused_and_left_alone(tmp_path):
    m = [made_measures()]
    write_analysis(m, tmp_path / "plain", report=False)
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw" / "dataset_description.json").write_text('{"Name": "raw", "BIDSVersion": "1.8.0"}')
    before = sorted(tmp_path.rglob("*"))
    for name in ("plain", "raw"):
        with pytest.raises(FileExistsError, match=re.escape(f"{tmp_path / name}: ")):
            write_dataset(m, tmp_path / name, "bert", report=False)
    assert sorted(tmp_path.rglob("*")) == before
    write_dataset(m, tmp_path / "ours", "a-b", report=False)
    with pytest.raises(FileExistsError, match=r"'a-b'.*'ab'"):
        write_dataset(m, tmp_path / "ours", "ab", report=False)
    with pytest.raises(FileExistsError, match=re.escape(f"{tmp_path / 'ours'}: ")):
        write_analysis(m, tmp_path / "ours", report=False)  # with its subjects


def test_the_official_validator_finds_no_error(dataset, tmp_path):
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    command = shutil.which("bids-validator-deno", path=path)
    if command is None:
        pytest.skip("the BIDS validator is not installed: pip install bids-validator-deno")
    quiet = {"DENO_DIR": str(tmp_path / "deno"), "DENO_NO_UPDATE_CHECK": "1", "NO_COLOR": "1"}
    folder = shutil.copytree(dataset[1], tmp_path / "d")

    def codes(severity):
        argv = [command, str(folder), "--format", "json"]
        done = subprocess.run(argv, capture_output=True, text=True, env={**os.environ, **quiet}, check=False)
        issues = json.loads(done.stdout)["issues"]["issues"]
        return {issue["code"] for issue in issues if issue["severity"] == severity}

    (folder / "sub-bert01" / "report.html").write_text("as with a report")
    assert codes("error") == set()
    assert codes("warning") <= {"TOO_FEW_AUTHORS"}  # which we cannot know
    regions = folder / "sub-bert01" / "anat" / "sub-bert01_hemi-L_seg-aparc_dseg.label.gii"
    regions.rename(regions.with_name("sub-bert01_hemi-L_parcellation-aparc_dseg.label.gii"))
    assert codes("error")  # it looks at names, and at this one


#: names of extension proposal 11 (BIDS's pull request 518), and of BIDS 1.11 itself: _dseg; white for wm, as fMRIPrep
PROPOSED = (
    r"hemi-[LR](_desc-[A-Za-z0-9]+)?_(white|pial|inflated|sphere)\.surf\.gii",
    r"hemi-[LR](_desc-[A-Za-z0-9]+)?_(curv|thickness|area|sulc)\.shape\.gii",
    r"desc-[a-z]+_morph\.tsv",
    r"hemi-[LR]_seg-[A-Za-z0-9]+_dseg\.(label\.gii|tsv)",
)
OURS = {"desc-localGyrificationIndex_morph.shape.gii", "desc-cortex_mask.label.gii"}  # what it has no name for


def test_names_are_those_of_the_extension_proposal_for_structural_derivatives(layouts):
    names = [file.name.removeprefix("sub-bert_") for file in (layouts[1]["bids"] / "anat").iterdir()]
    names = [name for name in names if not name.endswith(".json")]
    maps = [*measuring.CURVATURE_MAPS, *each_map(), "area", "cortical_thickness", "gyral_thickness", "thickness_file"]
    names += [f"hemi-L_{map_ending('map', name)}.shape.gii" for name in (*maps, "local_gyrification_index")]
    names += [f"hemi-L_{map_ending('input_map', name)}.shape.gii" for name in ("thickness", "curv", "sulc", "area")]
    assert len(names) > 40
    others = [name for name in names if not any(re.fullmatch(pattern, name) for pattern in PROPOSED)]
    assert {name.partition("_")[2] for name in others} <= OURS


@pytest.mark.slow
def test_analyze_writes_a_subject_with_its_page_into_a_dataset(cwd, capsys):
    argv = ["analyze", str(sample_path("simulated")), "--name", "fig5 g1.8", "--layout", "bids", "-q"]
    assert main([*argv, "-o", "d", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert summary["subject"] == "fig5 g1.8"
    folder = cwd / "d" / "sub-fig5g18"
    assert (folder / "report.html").stat().st_size > 10_000
    assert main([*argv, "-o", str(folder)]) == 2
    assert f"{folder}: " in capsys.readouterr().err
