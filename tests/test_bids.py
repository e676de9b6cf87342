"""Analyses as subjects of a BIDS derivatives dataset: names, what files say of themselves, what is refused."""

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import nibabel as nib
import numpy as np
import pytest
from made_measures import made_measures

from morphofold.analysis import gyral_graph
from morphofold.analysis.measures import SCALARS
from morphofold.cli import main
from morphofold.errors import DamagedFile, Mismatch, NotFinite, NotReadable
from morphofold.io import read_cortex, read_surface, sample_path
from morphofold.quantities import COLUMN_WORDS, SCALAR_WORDS
from morphofold.results import COLUMNS, read_analysis, write_analysis, write_dataset
from morphofold.results.layouts import BIDSIGNORE_LINES

TRANSFORM = np.array([[1.0, 0, 0, 5], [0, 1, 0, -7], [0, 0, 1, 2], [0, 0, 0, 1]])
TURNED = np.array([[0.0, -1, 0, 5], [0.6, 0, 0.8, -7], [-0.8, 0, 0.6, 2], [0, 0, 0, 1]])
FILE = re.compile(
    r"sub-[A-Za-z0-9]+(_hemi-[LR])?(_seg-[A-Za-z0-9]+)?(_desc-[A-Za-z0-9]+)?_[A-Za-z]+"
    r"(\.(surf|shape|label)\.gii|\.tsv|\.json)"
)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Both hemispheres of one subject, without report."""
    pair = [made_measures("lh", transform=TRANSFORM), made_measures("rh")]
    dataset = tmp_path_factory.mktemp("bids") / "derivatives"
    return pair, dataset, write_dataset(pair, dataset, "sub-bert_01", report=False)


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """One analysis in both layouts: a turned left hemisphere with all there is, a bare right one."""
    left = made_measures("lh", level=4, transform=TURNED, info={"g": 1.8}, portion=0.125, files=("lh.white",))
    left = replace(left, graph=gyral_graph(left.cortex.pial))
    pair, out = [left, made_measures("rh", mask=False, regions=False)], tmp_path_factory.mktemp("both")
    return write_analysis(pair, out / "plain", report=False), write_dataset(pair, out / "d", "bert", report=False)


def json_of(path):
    return json.loads(path.read_text(encoding="utf-8"), parse_constant=pytest.fail)


def test_the_dataset_says_who_made_it_and_every_file_has_a_bids_name(written):
    _, dataset, place = written
    description = json_of(dataset / "dataset_description.json")
    assert (description["DatasetType"], description["GeneratedBy"][0]["Name"]) == ("derivative", "morphofold")
    assert {"Name", "BIDSVersion"} <= set(description)
    assert place == dataset / "sub-bert01"
    names = sorted(p.name for p in (place / "anat").iterdir())
    assert [n for n in names if not FILE.fullmatch(n)] == []
    assert {
        f"sub-bert01_hemi-{side}_{end}"
        for side in "LR"
        for end in (
            "white.surf.gii",
            "pial.surf.gii",
            "thickness.shape.gii",
            "curv.shape.gii",
            "desc-gyral_thickness.shape.gii",
            "desc-sulcalDepth_morph.shape.gii",
            "desc-input_thickness.shape.gii",
            "desc-cortex_mask.label.gii",
            "seg-aparc_dseg.label.gii",
        )
    } <= set(names)
    data = {n.split(".")[0] for n in names if n.endswith((".shape.gii", ".label.gii", ".tsv"))}
    assert data == {n.split(".")[0] for n in names if n.endswith(".json")} - {"sub-bert01_desc-morphofold_provenance"}


def test_every_column_of_every_table_is_described(written):
    _, _, place = written
    tables = sorted((place / "anat").glob("*_morph.tsv"))
    assert len(tables) == len(COLUMNS) + 1
    for table in tables:
        with table.open(newline="") as file:
            reader = csv.DictReader(file, delimiter="\t")
            rows = list(reader)
        sidecar = json_of(table.with_suffix(".json"))
        assert list(sidecar) == list(reader.fieldnames)
        assert all(None not in row.values() and "" not in row.values() for row in rows)
        for column in sidecar:
            assert column in COLUMN_WORDS or column in SCALAR_WORDS
            unit = {"_mm": "mm", "_mm2": "mm^2", "_mm3": "mm^3", "_per_mm": "1/mm", "_deg": "degree"}
            wanted = [u for end, u in unit.items() if column.endswith(end)]
            assert not wanted or sidecar[column]["Units"] == wanted[-1]
    assert {k for columns in COLUMNS.values() for k in columns} | set(SCALARS) <= {*COLUMN_WORDS, *SCALAR_WORDS}
    regions = (place / "anat" / "sub-bert01_desc-regions_morph.tsv").read_text()
    assert "\tn/a" in regions
    assert "nan" not in regions.lower()


def test_maps_keep_nan_and_only_curv_has_freesurfers_sign(written):
    pair, _, place = written
    for m, side, structure in zip(pair, "LR", ("CortexLeft", "CortexRight")):
        stem = place / "anat" / f"sub-bert01_hemi-{side}"
        for end, values in (("curv", -m.maps["H"]), ("desc-gyral_thickness", m.maps["gyral_thickness"])):
            image = nib.load(f"{stem}_{end}.shape.gii")
            assert image.meta["AnatomicalStructurePrimary"] == structure
            np.testing.assert_allclose(image.darrays[0].data, values, rtol=1e-6)
            assert np.isnan(values).any()
        assert "positive in sulci" in json_of(stem.with_name(f"{stem.name}_curv.json"))["Description"]
        sidecar = json_of(stem.with_name(f"{stem.name}_desc-gyral_thickness.json"))
        assert (sidecar["Units"], sidecar["Description"]) == ("mm", "Gyral thickness")


def test_surfaces_and_hinges_are_in_scanner_coordinates_where_these_are_known(written):
    pair, _, place = written
    for m, side, shift in zip(pair, "LR", ([5, -7, 2], [0, 0, 0])):
        for kind in ("white", "pial"):
            surface = read_surface(place / "anat" / f"sub-bert01_hemi-{side}_{kind}.surf.gii")
            np.testing.assert_allclose(surface.verts, getattr(m.cortex, kind).verts + shift, atol=8e-6)
            np.testing.assert_array_equal(surface.faces, m.cortex.faces)
            points = nib.load(place / "anat" / f"sub-bert01_hemi-{side}_{kind}.surf.gii").darrays[0]
            meta, space = points.meta, points.coordsys.dataspace
            assert nib.nifti1.xform_codes.label[space] == {"L": "scanner", "R": "unknown"}[side]
            assert meta["AnatomicalStructurePrimary"] == {"L": "CortexLeft", "R": "CortexRight"}[side]
            assert meta["AnatomicalStructureSecondary"] == {"white": "GrayWhite", "pial": "Pial"}[kind]
            assert surface.geometry is None  # or its c_ras would be added once more
        flat = read_surface(place / "anat" / f"sub-bert01_hemi-{side}_inflated.surf.gii")
        np.testing.assert_allclose(flat.verts, m.cortex.inflated.verts, atol=8e-6)
    with (place / "anat" / "sub-bert01_desc-hinges_morph.tsv").open(newline="") as file:
        left, right = ([float(row[k]) for k in "xyz"] for row in csv.DictReader(file, delimiter="\t"))
    assert (left, right) == ([6.5, -9.0, 32.0], [1.5, -2.0, 30.0])


def test_regions_and_mask_have_a_key_per_vertex_and_say_what_it_stands_for(written):
    pair, dataset, place = written
    for m, side in zip(pair, "LR"):
        stem = place / "anat" / f"sub-bert01_hemi-{side}"
        for end, labels in (("seg-aparc_dseg", m.cortex.regions.labels), ("desc-cortex_mask", m.cortex.cortex - 1)):
            image = nib.load(f"{stem}_{end}.label.gii")
            np.testing.assert_array_equal(image.darrays[0].data, labels + 1)
            assert image.labeltable.get_labels_as_dict()[0] == "???"
            sidecar = json_of(stem.with_name(f"{stem.name}_{end}.json"))
            assert (dataset / sidecar["SpatialReference"].removeprefix("bids::")).is_file()
        with stem.with_name(f"{stem.name}_seg-aparc_dseg.tsv").open(newline="") as file:
            rows = {int(row["index"]): row for row in csv.DictReader(file, delimiter="\t")}
        table = nib.load(f"{stem}_seg-aparc_dseg.label.gii").labeltable
        assert {k: row["name"] for k, row in rows.items() if k} == {
            label.key: label.label for label in table.labels if label.key
        }
        colours = [tuple(bytes.fromhex(rows[label.key]["color"][1:])) for label in table.labels[1:]]
        assert colours == [tuple(colour) for colour in m.cortex.regions.colours.tolist()]
        np.testing.assert_allclose([label.rgba[:3] for label in table.labels[1:]], np.array(colours) / 255, atol=1e-6)


def test_the_gyral_graph_lies_on_the_surface_beside_it(both):
    """Both are in scanner coordinates, which are far from the surface's own."""
    anat = both[1] / "anat"
    pial = read_surface(anat / "sub-bert_hemi-L_pial.surf.gii")
    nodes = json_of(anat / "sub-bert_hemi-L_desc-graph_morph.json")["nodes"]
    there = np.array([node["position"] for node in nodes])
    edges = pial.verts[pial.faces] - pial.verts[np.roll(pial.faces, 1, axis=1)]
    off = np.linalg.norm(there - pial.verts[[node["vertex"] for node in nodes]], axis=1)
    assert off.max() < np.linalg.norm(edges, axis=2).max()
    outward = np.array([node["normal"] for node in nodes])
    assert (((there - pial.verts.mean(0)) * outward).sum(1) > 0).all()  # it was turned, too


@pytest.mark.slow
def test_compare_takes_a_subject_beside_an_analysis_and_names_those_of_a_dataset(both, tmp_path, capsys):
    plain, place = both
    assert main(["compare", f"a={place}", f"b={plain}", "-o", str(tmp_path / "out"), "-q"]) == 0
    comparison = json_of(tmp_path / "out" / "comparison.json")
    assert comparison["names"] == ["a lh", "a rh", "b lh", "b rh"]
    assert all(row["a lh"] == row["b lh"] for row in comparison["table"])
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000
    assert main(["compare", f"a={place.parent}", "-o", str(tmp_path / "out2")]) == 2
    assert f" {place}." in capsys.readouterr().err


def test_a_file_that_is_missing_or_cut_short_is_named(both, tmp_path):
    place = tmp_path / "sub-bert"
    shutil.copytree(both[1], place)
    files = [
        file
        for file in sorted((place / "anat").iterdir())
        if ("hemi-L" in file.name and (file.name.endswith(".gii") or "graph" in file.name))
        or file.name.endswith(("hinges_morph.tsv", "provenance.json"))
    ]
    assert len(files) == 13
    for file in files:
        content = file.read_bytes()
        file.write_bytes(content[: len(content) * 2 // 3])
        with pytest.raises(DamagedFile, match=re.escape(str(file))):
            read_analysis(place)
        file.unlink()
        name = file.name.replace("bert", "NAME") if "provenance" in file.name else file.name
        with pytest.raises(FileNotFoundError, match=re.escape(name)):
            read_analysis(place)
        file.write_bytes(content)
    read_analysis(place)


@pytest.mark.parametrize("layout", [0, 1])
def test_a_table_that_lost_whole_lines_is_refused_where_the_number_of_rows_is_known(both, tmp_path, layout):
    place = tmp_path / "sub-bert"
    shutil.copytree(both[layout], place)
    table, summary = (
        (place / "regions.tsv", place / "summary.json"),
        (place / "anat" / "sub-bert_desc-regions_morph.tsv", place / "anat/sub-bert_desc-morphofold_provenance.json"),
    )[layout]
    lines = table.read_text().splitlines(keepends=True)
    table.write_text("".join(lines[:-1]))
    with pytest.raises(DamagedFile, match=rf"{table.name}: \D*\b{len(lines) - 2}\b\D*\b{len(lines) - 1}\b"):
        read_analysis(place)
    summary.write_text(json.dumps({key: value for key, value in json_of(summary).items() if key != "rows"}))
    with pytest.raises(NotReadable, match=rf"{summary.name}: rows: "):
        read_analysis(place)


@pytest.mark.parametrize(
    ("key", "value", "kind", "expected"),
    [("hemi", "xh", NotReadable, r"\bhemi: .*'xh'"), ("maps", 3, NotReadable, r"\bmaps: .*\b3\b")],
)
def test_a_provenance_that_morphofold_did_not_write_is_refused(both, tmp_path, key, value, kind, expected):
    place = tmp_path / "sub-bert"
    shutil.copytree(both[1], place)
    path = place / "anat" / "sub-bert_desc-morphofold_provenance.json"
    provenance = json_of(path)
    provenance["surfaces"][0][key] = value
    path.write_text(json.dumps(provenance))
    with pytest.raises(kind, match=rf"sub-bert.anat.*{expected}"):
        read_analysis(place)


def test_files_of_two_analyses_are_not_taken_for_one(both, written, tmp_path):
    place = tmp_path / "sub-bert"
    for end in ("thickness.shape.gii", "seg-aparc_dseg.label.gii"):
        shutil.copytree(both[1], place)
        shutil.copy(written[2] / "anat" / f"sub-bert01_hemi-L_{end}", place / "anat" / f"sub-bert_hemi-L_{end}")
        with pytest.raises(Mismatch, match=rf"sub-bert_hemi-L_{re.escape(end)}: .*\(642,\).*\b2562\b"):
            read_analysis(place)
        shutil.rmtree(place)


# the official validator -------------------------------------------------------------------------------------


@pytest.fixture
def validate(tmp_path):
    """Runs the validator on a dataset: codes and places of errors, codes of warnings, and the subjects it saw."""
    where = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    command = shutil.which("bids-validator-deno", path=where)
    if command is None:
        pytest.skip("the BIDS validator is not installed: pip install bids-validator-deno")
    quiet = {"DENO_DIR": str(tmp_path / "deno"), "DENO_NO_UPDATE_CHECK": "1", "NO_COLOR": "1"}

    def run(dataset):
        words = [command, str(dataset), "--format", "json"]
        done = subprocess.run(words, capture_output=True, text=True, env={**os.environ, **quiet}, check=False)
        assert done.stdout.startswith("{"), done.stderr
        answer = json.loads(done.stdout)
        issues = [(i["severity"], i["code"], i["location"]) for i in answer["issues"]["issues"]]
        return (
            [(code, place) for severity, code, place in issues if severity == "error"],
            {code for severity, code, _ in issues if severity != "error"},
            answer["summary"]["subjects"],
        )

    return run


def test_the_official_validator_finds_no_error(written, validate, tmp_path):
    dataset = tmp_path / "d"
    shutil.copytree(written[1], dataset)
    (dataset / "sub-bert01" / "figures").mkdir()
    for name in ("report.html", "figures/H.png"):
        (dataset / "sub-bert01" / name).write_text("as with a report")
    errors, warnings, subjects = validate(dataset)
    assert (errors, subjects) == ([], ["bert01"])
    assert warnings <= {"TOO_FEW_AUTHORS"}  # which we cannot know
    regions = dataset / "sub-bert01" / "anat" / "sub-bert01_hemi-L_seg-aparc_dseg.label.gii"
    regions.rename(regions.with_name("sub-bert01_hemi-L_parcellation-aparc_dseg.label.gii"))
    assert validate(dataset)[0]  # it looks at names, and at this one


def test_a_pair_of_its_surfaces_is_read_as_a_cortex(written):
    _, _, place = written
    white, pial = (place / "anat" / f"sub-bert01_hemi-R_{kind}.surf.gii" for kind in ("white", "pial"))
    assert read_cortex(white=white, pial=pial).hemi == "rh"


def test_other_subjects_stay_and_the_same_one_is_replaced(tmp_path):
    for name in ("anna", "bert", "anna"):
        write_dataset([made_measures()], tmp_path / "d", name, report=False)
        (tmp_path / "d" / f"sub-{name}" / "anat" / "more.txt").write_text(name)
        (tmp_path / "d" / "participants.tsv").write_text("participant_id\n")
    (tmp_path / "d" / "sub-anna" / "anat" / "more.txt").unlink()
    write_dataset([made_measures("rh")], tmp_path / "d", "anna", report=False)
    assert sorted(p.name for p in (tmp_path / "d").iterdir()) == [
        ".bidsignore",
        "README.md",
        "dataset_description.json",
        "participants.tsv",
        "sub-anna",
        "sub-bert",
    ]
    assert (tmp_path / "d" / "sub-bert" / "anat" / "more.txt").is_file()
    assert not list((tmp_path / "d" / "sub-anna").rglob("*hemi-L*"))


def test_what_was_added_to_the_description_of_a_dataset_stays(tmp_path):
    write_dataset([made_measures()], tmp_path / "d", "anna", report=False)
    (tmp_path / "d" / ".bidsignore").write_text("*.html\nmine\n")
    description = json_of(tmp_path / "d" / "dataset_description.json") | {"Authors": ["A. One", "B. Two"]}
    (tmp_path / "d" / "dataset_description.json").write_text(json.dumps(description))
    write_dataset([made_measures()], tmp_path / "d", "bert", report=False)
    assert json_of(tmp_path / "d" / "dataset_description.json") == description
    lines = (tmp_path / "d" / ".bidsignore").read_text().splitlines()
    assert "mine" in lines
    assert sorted(lines) == sorted({*BIDSIGNORE_LINES, "mine"})  # those of an older version are renewed


def test_what_is_no_dataset_of_ours_is_refused_and_left_alone(tmp_path):
    m = [made_measures()]
    write_analysis(m, tmp_path / "plain", report=False)
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw" / "dataset_description.json").write_text('{"Name": "raw", "BIDSVersion": "1.8.0"}')
    (tmp_path / "file").write_text("")
    before = sorted(tmp_path.rglob("*"))
    for name in ("plain", "raw", "file"):
        with pytest.raises(FileExistsError, match=re.escape(f"{tmp_path / name}: ")):
            write_dataset(m, tmp_path / name, "bert", report=False)
    with pytest.raises(NotReadable, match="'sub-__'"):
        write_dataset(m, tmp_path / "new", "sub-__", report=False)
    assert sorted(tmp_path.rglob("*")) == before
    write_dataset(m, tmp_path / "ours", "a-b", report=False)
    with pytest.raises(FileExistsError, match=r"'a-b'.*'ab'"):
        write_dataset(m, tmp_path / "ours", "ab", report=False)
    with pytest.raises(FileExistsError, match=re.escape(f"{tmp_path / 'ours'}: ")):
        write_analysis(m, tmp_path / "ours", report=False)  # with its subjects


def test_a_failure_half_way_leaves_neither_subject_nor_dataset(tmp_path):
    m = made_measures()
    with pytest.raises(NotFinite, match=r"_curv\S*: 1 of \d+\b.*\b3\b"):
        write_dataset([m, made_measures("rh")], _spoil(m, tmp_path / "d"), "bert", report=False)
    assert list(tmp_path.iterdir()) == []


def _spoil(m, path):
    m.maps["H"][3] = np.inf
    return path


@pytest.mark.slow
def test_analyze_writes_a_subject_with_its_page_into_a_dataset(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    argv = ["analyze", str(sample_path("simulated")), "--name", "fig5 g1.8", "--layout", "bids", "-q"]
    assert main([*argv, "-o", "d", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert summary["subject"] == "fig5 g1.8"
    assert summary["surfaces"][0]["measures"]["n_hinges"] > 0
    place = tmp_path / "d" / "sub-fig5g18"
    assert (place / "report.html").stat().st_size > 10_000
    assert list((place / "figures").glob("*.png"))
    monkeypatch.setattr("morphofold.analysis.measuring.measure", lambda *a, **k: pytest.fail("was measured"))
    assert main([*argv, "-o", str(place)]) == 2
    assert f"{place}: " in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["d"]
