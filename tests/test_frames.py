"""Tables of measures as DataFrames."""

from dataclasses import replace

import pandas as pd
import pytest
from made_measures import made_measures

from morphofold.analysis.measures import COLUMNS, FRAMES, SCALARS, column_type
from morphofold.errors import UnknownName


def types(frame):
    return {column: str(kind) for column, kind in frame.dtypes.items()}


def test_scalars_are_one_row_with_the_numbers_of_freesurfer_beside_them():
    row = made_measures(info={"etiv_mm3": 1.5e6, "surface_holes": 7, "g": 2.0}).to_frame()
    assert tuple(row) == FRAMES["scalars"]
    assert len(row) == 1
    assert row.loc[0, ["name", "hemi", "euler_characteristic", "surface_holes"]].tolist() == ["bump", "lh", 2, 7]
    assert row.at[0, "etiv_mm3"] == 1.5e6
    assert row.at[0, "gyrification_index"] == 1.25


def test_what_cannot_be_computed_is_missing_and_not_zero():
    row = made_measures().to_frame()
    known = [name for name in SCALARS if made_measures().scalars[name] is not None]
    assert row[known].notna().all(axis=None)
    assert row[[name for name in FRAMES["scalars"] if name not in ("name", "hemi", *known)]].isna().all(axis=None)
    assert made_measures().to_frame("regions")["n_hinges"].isna().all()


@pytest.mark.parametrize("table", FRAMES)
def test_a_table_without_rows_has_its_columns_with_their_types(table):
    empty = replace(made_measures(), regions=[], crests=[], hinges=[], arms=[]).to_frame(table)
    assert len(empty) == (table == "scalars")
    assert types(empty) == types(made_measures().to_frame(table))
    assert types(empty) == {column: column_type(column) for column in FRAMES[table]}


@pytest.mark.parametrize("table", COLUMNS)
def test_a_frame_holds_every_number_of_its_table(measured_average, table):
    average, _ = measured_average
    rows, frame = getattr(average, table), average.to_frame(table)
    assert len(rows) > 3
    assert {key for row in rows for key in row} <= set(frame)  # nothing is left out
    for column in COLUMNS[table]:
        assert [None if pd.isna(x) else x for x in frame[column]] == [row.get(column) for row in rows]
    assert set(frame["name"]) == {"fsaverage5"}


@pytest.mark.parametrize("table", FRAMES)
def test_the_columns_of_whole_numbers_are_those_that_count_or_number(measured_average, table):
    average, _ = measured_average
    rows = [average.scalars] if table == "scalars" else getattr(average, table)
    whole = {key for row in rows for key, value in row.items() if isinstance(value, int)}
    parts = {key for row in rows for key, value in row.items() if isinstance(value, float)}
    assert whole
    assert {column_type(key) for key in whole} == {"Int64"}
    assert {column_type(key) for key in parts} <= {"float64"}


def test_frames_of_two_subjects_are_put_together_and_keep_their_types():
    one, two = (made_measures(hemi, name=name).to_frame("hinges") for hemi, name in (("lh", "anna"), ("rh", "ben")))
    both = pd.concat([one, two], ignore_index=True)
    assert types(both) == types(one)
    assert list(both[["name", "hemi"]].itertuples(index=False, name=None)) == [("anna", "lh"), ("ben", "rh")]


def test_a_table_that_does_not_exist_is_refused_by_name():
    with pytest.raises(UnknownName, match="scalars, regions, crests, hinges, arms"):
        made_measures().to_frame("vertices")
