"""Analyses as subjects of a BIDS derivatives dataset: names, what files say of themselves, what is refused."""

import csv
import json
import re

import nibabel as nib
import numpy as np
import pytest
from made_measures import made_measures

from morphofold.analysis.measures import SCALARS
from morphofold.bids import write_dataset
from morphofold.cli import main
from morphofold.io import read_cortex, read_surface, sample_path
from morphofold.report.quantities import COLUMN_WORDS, SCALAR_WORDS
from morphofold.results import COLUMNS, write_analysis

TRANSFORM = np.array([[1.0, 0, 0, 5], [0, 1, 0, -7], [0, 0, 1, 2], [0, 0, 0, 1]])
FILE = re.compile(
    r"sub-[A-Za-z0-9]+(_hemi-[LR])?(_desc-[A-Za-z0-9]+)?_[A-Za-z]+(\.surf\.gii|\.shape\.gii|\.tsv|\.json)"
)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Both hemispheres of one subject, without report."""
    pair = [made_measures("lh", transform=TRANSFORM), made_measures("rh")]
    dataset = tmp_path_factory.mktemp("bids") / "derivatives"
    return pair, dataset, write_dataset(pair, dataset, "sub-bert_01", report=False)


def json_of(path):
    return json.loads(path.read_text(encoding="utf-8"), parse_constant=pytest.fail)


def test_the_dataset_says_who_made_it_and_every_file_has_a_bids_name(written):
    _, dataset, place = written
    said = json_of(dataset / "dataset_description.json")
    assert (said["DatasetType"], said["GeneratedBy"][0]["Name"]) == ("derivative", "morphofold")
    assert {"Name", "BIDSVersion"} <= set(said)
    assert place == dataset / "sub-bert01"
    names = sorted(p.name for p in (place / "anat").iterdir())
    assert [n for n in names if not FILE.fullmatch(n)] == []
    assert {f"sub-bert01_hemi-{side}_{end}" for side in "LR" for end in (
        "white.surf.gii", "pial.surf.gii", "thickness.shape.gii", "curv.shape.gii", "desc-gyral_thickness.shape.gii",
        "desc-sulcalDepth_morph.shape.gii",
    )} <= set(names)  # fmt: skip
    data = {n.split(".")[0] for n in names if n.endswith((".shape.gii", ".tsv"))}
    assert data == {n.split(".")[0] for n in names if n.endswith(".json")} - {"sub-bert01_desc-morphofold_provenance"}


def test_every_column_of_every_table_is_described(written):
    _, _, place = written
    tables = sorted((place / "anat").glob("*.tsv"))
    assert len(tables) == len(COLUMNS) + 1
    for table in tables:
        with table.open(newline="") as file:
            reader = csv.DictReader(file, delimiter="\t")
            rows = list(reader)
        said = json_of(table.with_suffix(".json"))
        assert list(said) == list(reader.fieldnames)
        assert all(None not in row.values() and "" not in row.values() for row in rows)
        for column in said:
            assert column in COLUMN_WORDS or column in SCALAR_WORDS
            unit = {"_mm": "mm", "_mm2": "mm^2", "_mm3": "mm^3", "_per_mm": "1/mm", "_deg": "degree"}
            wanted = [u for end, u in unit.items() if column.endswith(end)]
            assert not wanted or said[column]["Units"] == wanted[-1]
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
        said = json_of(stem.with_name(f"{stem.name}_desc-gyral_thickness.json"))
        assert (said["Units"], said["Description"]) == ("mm", "Gyral thickness")


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
            assert surface.geometry is None                         # or its c_ras would be added once more
        flat = read_surface(place / "anat" / f"sub-bert01_hemi-{side}_inflated.surf.gii")
        np.testing.assert_allclose(flat.verts, m.cortex.inflated.verts, atol=8e-6)
    with (place / "anat" / "sub-bert01_desc-hinges_morph.tsv").open(newline="") as file:
        left, right = ([float(row[k]) for k in "xyz"] for row in csv.DictReader(file, delimiter="\t"))
    assert (left, right) == ([6.5, -9.0, 32.0], [1.5, -2.0, 30.0])


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
        ".bidsignore", "dataset_description.json", "participants.tsv", "sub-anna", "sub-bert"]  # fmt: skip
    assert (tmp_path / "d" / "sub-bert" / "anat" / "more.txt").is_file()
    assert not list((tmp_path / "d" / "sub-anna").rglob("*hemi-L*"))


def test_what_is_no_dataset_of_ours_is_refused_and_left_alone(tmp_path):
    m = [made_measures()]
    write_analysis(m, tmp_path / "plain", report=False)
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw" / "dataset_description.json").write_text('{"Name": "raw", "BIDSVersion": "1.8.0"}')
    (tmp_path / "file").write_text("")
    before = sorted(tmp_path.rglob("*"))
    for name in ("plain", "raw", "file"):
        with pytest.raises(FileExistsError, match=f"{name}: is not a BIDS dataset that morphofold wrote"):
            write_dataset(m, tmp_path / name, "bert", report=False)
    with pytest.raises(ValueError, match="letters and digits, and it has none"):
        write_dataset(m, tmp_path / "new", "sub-__", report=False)
    assert sorted(tmp_path.rglob("*")) == before
    write_dataset(m, tmp_path / "ours", "a-b", report=False)
    with pytest.raises(FileExistsError, match="holds 'a-b', and BIDS shortens 'ab' to the same"):
        write_dataset(m, tmp_path / "ours", "ab", report=False)
    with pytest.raises(FileExistsError, match="morphofold did not write this folder"):
        write_analysis(m, tmp_path / "ours", report=False)                         # with its subjects


def test_a_failure_half_way_leaves_neither_subject_nor_dataset(tmp_path):
    m = made_measures()
    with pytest.raises(ValueError, match="infinite"):
        write_dataset([m, made_measures("rh")], _spoil(m, tmp_path / "d"), "bert", report=False)
    assert list(tmp_path.iterdir()) == []


def _spoil(m, path):
    m.maps["H"][3] = np.inf
    return path


def test_analyze_writes_a_subject_with_its_page_into_a_dataset(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    argv = ["analyze", str(sample_path("simulated")), "--name", "fig5 g1.8", "--layout", "bids", "-q"]
    assert main([*argv, "-o", "d", "--json"]) == 0
    said = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert said["subject"] == "fig5 g1.8"
    assert said["surfaces"][0]["measures"]["n_hinges"] > 0
    place = tmp_path / "d" / "sub-fig5g18"
    assert (place / "report.html").stat().st_size > 10_000
    assert list((place / "figures").glob("*.png"))
    for more in ([], ["-o", "d", "--mgh"], ["-o", "d", "--wide"]):
        assert main([*argv, *more]) == 2
        assert "--layout bids takes -o DATASET" in capsys.readouterr().err
    monkeypatch.setattr("morphofold.analysis.measures.measure", lambda *a, **k: pytest.fail("was measured"))
    assert main([*argv, "-o", str(place)]) == 2
    assert "is not a BIDS dataset that morphofold wrote" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["d"]
