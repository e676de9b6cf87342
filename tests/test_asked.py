"""``measure(cortex, only=[...])``: the same numbers as the whole measurement, and no step that they do not need."""

from dataclasses import replace

import numpy as np
import pytest

from morphofold.analysis import measure, measuring
from morphofold.analysis.graph.hinge_shapes import hinge_shapes
from morphofold.analysis.measures import COLUMNS, SCALARS
from morphofold.analysis.measuring import STEPS
from morphofold.analysis.steps import steps_for
from morphofold.comparison import compare, compare_with_person
from morphofold.errors import MissingPart, NothingToDo, UnknownName
from morphofold.io import read_cortex, sample_path
from morphofold.report.pages.templates import methods_of
from morphofold.results import read_analysis, write_analysis
from morphofold.shapes import icosphere
from morphofold.shapes.folded_ball import folded_ball
from morphofold.surface import Cortex, Regions, Surface

NAMES = [name for step in STEPS for name in step.makes]
#: of each kind of step one; the others are slow
COMMON = ("surfaces", "cortical thickness", "gyral graph", "crests", "slopes")
MAKERS = [
    pytest.param(step, id=step.name, marks=() if step.name in COMMON else pytest.mark.slow)
    for step in STEPS
    if step.makes
]


@pytest.fixture(scope="module")
def cortex():
    """A folded ball with five regions and a thickness of its own."""
    ball = folded_ball(2500)
    labels = np.digitize(ball.pial.verts[:, 2], [-30.0, -10.0, 10.0, 30.0])
    regions = Regions(labels, ("a", "b", "c", "d", "e"), np.zeros((5, 3), dtype=np.uint8))
    return replace(ball, regions=regions, maps={"thickness": np.full(ball.n_vertices, 3.0)})


@pytest.fixture(scope="module")
def whole(cortex):
    return measure(cortex)


def same(value, other):
    """Whether two values are the same bit for bit."""
    if isinstance(value, np.ndarray):
        return value.tobytes() == other.tobytes()
    return repr(value) == repr(other)


def value_of(m, name):
    return m.maps[name] if name in m.maps else m.scalars[name] if name in m.scalars else getattr(m, name)


def test_every_number_map_and_table_can_be_asked_for_once(whole):
    assert sorted(NAMES) == sorted({*whole.maps, *SCALARS, *COLUMNS})


@pytest.mark.parametrize("step", MAKERS)
def test_what_is_asked_for_is_the_same_bit_for_bit_and_nothing_else_is_there(cortex, whole, step):
    m = measure(cortex, only=step.makes)
    for name in step.makes:
        assert same(value_of(m, name), value_of(whole, name)), name
    rest = set(NAMES) - set(step.makes)
    assert not rest & set(m.maps)
    assert all(m.scalars[name] is None for name in rest & set(SCALARS))
    assert all(getattr(m, table) == [] for table in rest & set(COLUMNS))
    assert m.parameters["only"] == list(step.makes)
    shared = m.parameters.keys() & whole.parameters.keys()
    assert all(same(m.parameters[name], whole.parameters[name]) for name in shared)
    assert all(name in m.notes["only"] for name in step.makes)
    assert {name for name in m.notes if name in step.makes and m.scalars.get(name, 0) is None} <= set(whole.notes)


def test_the_reason_for_an_empty_map_stays():
    verts, faces = icosphere(3)
    shell = Cortex(Surface(47 * verts, faces), Surface(50 * verts, faces))
    m = measure(shell, only=["gyral_thickness"])
    assert np.isnan(m.maps["gyral_thickness"]).all()
    assert m.notes["median_gyral_thickness_mm"] == measure(shell).notes["median_gyral_thickness_mm"]


@pytest.mark.parametrize(
    ("name", "steps"),
    [
        ("gyrification_index", {"surfaces", "hull"}),
        ("gyral_thickness", {"surfaces", "operators", "resampling", "gyral thickness"}),
        ("n_hinges", {"surfaces", "operators", "resampling", "self-crossings", "gyral graph"}),
        ("regions", {step.name for step in STEPS} - {"depth", "hull", "folding", "crests", "slopes", "shapes"}),
        ("shapes", {"surfaces", "operators", "depth", "curvature", "cortical thickness", "resampling", "shapes"}),
    ],
)
def test_only_the_steps_that_a_name_needs_run(name, steps):
    assert {step.name for step in steps_for([name], STEPS)} == steps


def test_a_step_that_is_not_needed_is_not_called(cortex, monkeypatch):
    """Every step that gyral thickness does not need fails."""

    def fail(*_):
        raise LookupError

    needed = {step.name for step in steps_for(["gyral_thickness"], STEPS)}
    steps = [step if step.name in needed else step._replace(run=fail) for step in STEPS]
    monkeypatch.setattr(measuring, "STEPS", steps)
    measure(cortex, only=["gyral_thickness"])
    with pytest.raises(LookupError):
        measure(cortex, only=["gyral_thickness", "cortical_thickness"])


def test_a_repaired_surface_has_what_was_asked_for(cortex):
    faces = cortex.faces.copy()
    faces[7] = faces[7, ::-1]
    flipped = replace(cortex, white=replace(cortex.white, faces=faces), pial=replace(cortex.pial, faces=faces))
    m = measure(flipped, only=["cortical_thickness"])
    assert set(m.maps) == {"cortical_thickness"}
    assert m.parameters["repaired_flipped_triangles"] == 1
    assert same(m.maps["cortical_thickness"], measure(flipped).maps["cortical_thickness"])


@pytest.mark.parametrize(
    ("only", "kind"), [(["gyral_thicknes"], UnknownName), ([], NothingToDo), ("H", TypeError), ([3], UnknownName)]
)
def test_an_unknown_name_is_refused_before_anything_is_measured(cortex, only, kind):
    with pytest.raises(kind):
        measure(cortex, only=only)


def test_a_refusal_lists_what_can_be_asked_for(cortex):
    with pytest.raises(UnknownName) as error:
        measure(replace(cortex, maps={}), only=["thickness_file", "n_hinges"])
    refused_names, can = str(error.value).split("Name some of these: ")
    assert "'thickness_file'" in refused_names
    assert can.rstrip(".").split(", ") == [name for name in NAMES if name != "thickness_file"]


def test_a_part_is_not_compared_with_the_person_it_grew_from(cortex):
    part = measure(cortex, only=["H"])
    with pytest.raises(MissingPart):
        compare_with_person(part, part, 0.1)


@pytest.mark.slow
def test_a_part_is_written_read_and_compared(tmp_path):
    """Beside a whole one, with the page; the numbers that only one has are missing for the other."""
    average = read_cortex(sample_path("fsaverage5"), hemi="lh")
    part = measure(average, only=["gyral_thickness", "median_gyral_thickness_mm", "n_hinges_4", "area"])
    write_analysis([part], tmp_path / "part")
    (read,) = read_analysis(tmp_path / "part")
    assert same(read.maps["gyral_thickness"].astype(np.float32), part.maps["gyral_thickness"].astype(np.float32))
    assert read.scalars == part.scalars
    both = compare({"part": read, "whole": measure(average)})
    row = {row["measure"]: (row["part"], row["whole"]) for row in both.table}
    assert row["median_gyral_thickness_mm"][0] == row["median_gyral_thickness_mm"][1]
    assert row["n_hinges"][0] is None
    assert row["n_hinges"][1] > 0
    assert hinge_shapes(part) is None  # only their number was asked for
    assert both.report(tmp_path / "page").is_file()


def test_the_methods_of_a_page_name_only_what_was_measured(cortex):
    m = measure(cortex, only=["cortical_thickness"])
    sentences, _ = methods_of([m])
    assert "Cortical thickness" in sentences
    assert not any(word in sentences for word in ("Gyral thickness", "Curvature", "gyrification", "depth"))
