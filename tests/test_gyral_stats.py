"""Regions in FreeSurfer's stats format, read by the rules of its aparcstats2table."""

import math
from dataclasses import replace

import numpy as np
import pytest
from made_measures import REGIONS, made_measures

from morphofold.analysis.regions import region_table
from morphofold.geometry import vertex_areas
from morphofold.io import read_annotation, write_annotation
from morphofold.results import read_analysis, write_analysis
from morphofold.results.subject_files import stats_name, write_gyral_stats
from morphofold.surface import Regions

#: position in a row of what --meas asks for, from the source of aparcstats2table
POSITIONS = {"area": 2, "volume": 3, "thickness": 4, "thicknessstd": 5, "meancurv": 6, "gauscurv": 7}
POSITIONS |= {"foldind": 8, "curvind": 9}
#: values of the head that it takes: of every table, of areas, of thickness
OF_HEAD = {"EstimatedTotalIntraCranialVol, eTIV": "", "BrainSegNotVent, BrainSegVolNotVent": ""}
OF_HEAD |= {"Cortex, WhiteSurfArea,": "area", "Cortex, MeanThickness,": "thickness"}


def read_stats(path, measure):
    """A line without ``#`` is a row, its words are split at blanks; of a line of the head the fourth part is taken."""
    found = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if "#" not in line:
            words = line.split()
            found[words[0]] = float(words[POSITIONS[measure]])
        for words, wanted in OF_HEAD.items():
            if line.startswith(f"# Measure {words}") and wanted in ("", measure):
                found[words.split(",")[1].strip()] = float(line.split(",")[3])
    return found


def made(**options):
    """Made-up thickness on a made cortex, whose areas and volumes are its own."""
    m = made_measures(**options)
    m.maps["gyral_thickness"][m.cortex.regions.labels == 0] = 12.5
    rows = region_table(m.cortex, m.maps)
    return replace(m, regions=rows)


@pytest.fixture
def stats(tmp_path):
    path = tmp_path / "lh.aparc.gyral.stats"
    write_gyral_stats(path, made(info={"etiv_mm3": 1534567.890123}))
    return path


def test_areas_and_volumes_of_regions_are_read_as_freesurfer_reads_them(stats):
    m = made()
    for measure, column in (("area", "area_mm2"), ("volume", "gray_volume_mm3")):
        found = read_stats(stats, measure)
        for row in m.regions:
            assert found[row["region"]] == pytest.approx(row[column], abs=0.5)  # whole numbers, as FreeSurfer's
    inside = m.cortex.cortex
    area = vertex_areas(m.cortex.white.verts, m.cortex.faces)[inside].sum()
    assert read_stats(stats, "area")["WhiteSurfArea"] == pytest.approx(area, rel=1e-9)


def test_thickness_is_the_gyral_thickness_of_the_table_of_regions(stats):
    m = made()
    found = read_stats(stats, "thickness")
    for row in m.regions:
        assert found[row["region"]] == pytest.approx(row["gyral_thickness_mm"], abs=5e-4)
    assert found["front"] == 12.5
    assert read_stats(stats, "thicknessstd")["front"] == 0
    widths = m.maps["gyral_thickness"][m.cortex.regions.labels == 1]
    assert read_stats(stats, "thicknessstd")["middle"] == pytest.approx(np.nanstd(widths), abs=5e-4)
    assert found["MeanThickness"] == m.scalars["median_gyral_thickness_mm"]


def test_a_region_without_gyral_thickness_keeps_its_row_and_is_nan_and_not_zero(tmp_path):
    m = made()
    m.regions[1]["gyral_thickness_mm"] = None
    write_gyral_stats(tmp_path / "stats", m)
    for measure in ("thickness", "thicknessstd"):
        found = read_stats(tmp_path / "stats", measure)
        assert [math.isnan(found[name]) for name in REGIONS] == [False, True, False]
    assert read_stats(tmp_path / "stats", "area")["middle"] > 100


@pytest.mark.parametrize("measure", ["meancurv", "gauscurv", "foldind", "curvind"])
def test_curvature_that_is_not_freesurfers_is_nan(stats, measure):
    assert all(math.isnan(read_stats(stats, measure)[name]) for name in REGIONS)


def test_volumes_of_the_brain_are_in_the_head_where_they_are_known(stats, tmp_path):
    assert read_stats(stats, "volume")["eTIV"] == 1534567.890
    assert "BrainSegVolNotVent" not in read_stats(stats, "volume")
    write_gyral_stats(tmp_path / "none", made())
    assert "eTIV" not in read_stats(tmp_path / "none", "volume")


def test_the_head_says_what_the_columns_are_as_freesurfer_does(stats):
    lines = stats.read_text().splitlines()
    heads = [line.split()[-1] for line in lines if line.startswith("# TableCol") and " ColHeader " in line]
    assert f"# ColHeaders {' '.join(heads)}" in lines
    assert f"# NTableCols {len(heads)}" in lines
    assert heads[4:6] == ["ThickAvg", "ThickStd"]
    assert "# hemi lh" in lines
    assert all(lines)  # an empty line would end aparcstats2table


def test_a_region_with_blanks_in_its_name_is_one_word(tmp_path):
    m = made()
    regions = Regions(m.cortex.regions.labels, ("G and S # 1", "middle", "back"), m.cortex.regions.colours)
    m.regions[0]["region"] = "G and S # 1"
    write_gyral_stats(tmp_path / "stats", replace(m, cortex=replace(m.cortex, regions=regions)))
    assert read_stats(tmp_path / "stats", "thickness")["G_and_S_1"] == 12.5


def test_an_analysis_has_the_stats_of_its_parcellation_and_the_same_again_from_its_own_files(tmp_path):
    m = made()
    write_analysis([m], tmp_path / "out")
    written = tmp_path / "out" / "stats" / "lh.aparc.gyral.stats"
    (again,) = read_analysis(tmp_path / "out")
    write_gyral_stats(tmp_path / "again", again)
    for measure in POSITIONS:
        first, second = (read_stats(path, measure) for path in (written, tmp_path / "again"))
        assert first.keys() == second.keys()
        np.testing.assert_allclose(list(first.values()), list(second.values()), atol=2e-3, rtol=1e-6)
    write_analysis([made_measures(regions=False)], tmp_path / "none")
    assert not (tmp_path / "none" / "stats").exists()


def test_names_of_an_annotation_control_no_terminal(tmp_path):
    m = made()
    regions = m.cortex.regions
    names = ("a\x1b[31m\nb", *regions.names[1:])
    write_annotation(tmp_path / "lh.x\x1b[2J.annot", replace(regions, names=names))
    cortex = replace(m.cortex, regions=read_annotation(tmp_path / "lh.x\x1b[2J.annot"))
    m = replace(m, cortex=cortex, regions=region_table(cortex, m.maps))
    write_gyral_stats(tmp_path / stats_name(m), m)
    text = (tmp_path / stats_name(m)).read_text(encoding="utf-8")
    assert all(line.isprintable() for line in [stats_name(m), *text.split("\n")])
    assert len(read_stats(tmp_path / stats_name(m), "area")) == len(read_stats_of(made(), tmp_path))


def read_stats_of(m, folder):
    write_gyral_stats(folder / "known.stats", m)
    return read_stats(folder / "known.stats", "area")
