"""Runs one hard case of each kind; the others, and each without its guard, are slow. A fixture for its bounds."""

import pytest
from hard_cases import made_surfaces
from hard_cases.cases import Holds

#: tests that are not slow
BY_DEFAULT = (
    "test_cut_maps",
    "test_a_node_that_is_no_number_stops_the_run_within_a_step",
    "test_an_inverted_element_recovers_or_stops_the_run",
    "test_one_element_through_the_cortex",
    "test_a_symmetric_scene_stays_symmetric",
    "test_flipped_triangles_are_turned",
    "test_the_wall_of_a_cavity_is_measured_and_told",
    "test_a_surface_a_kilometre_away_has_the_same_measures",
    "test_white_outside_pial_is_told_with_its_place",
    "test_the_integral_of_gaussian_curvature_is_the_euler_characteristic",
)


def pytest_collection_modifyitems(items):
    for item in items:
        if item.get_closest_marker("hard_case") and item.originalname not in BY_DEFAULT:
            item.add_marker(pytest.mark.slow)


def pytest_generate_tests(metafunc):
    """Tests that name a guard are run without it, too."""
    mark = metafunc.definition.get_closest_marker("hard_case")
    if mark and mark.kwargs["without"]:
        without = pytest.param(True, id="unguarded", marks=pytest.mark.slow)
        metafunc.parametrize("unguarded", [pytest.param(False, id="guarded"), without], indirect=True)


@pytest.fixture(autouse=True)
def unguarded(request):
    """Takes the guard of the test away, if this is the run without it."""
    if not getattr(request, "param", False):
        yield False
        return
    mark = request.node.get_closest_marker("hard_case")
    if mark.kwargs["group"] == "surfaces":
        made_surfaces.clean()  # kept, so it has to be made with all guards
    with pytest.MonkeyPatch.context() as patch:
        mark.kwargs["without"](patch)
        yield True


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem):
    """Without its guard a test has to fail in the way that it names."""
    mark = pyfuncitem.get_closest_marker("hard_case")
    if not (mark and pyfuncitem.funcargs.get("unguarded")):
        return (yield)
    try:
        result = yield
    except mark.kwargs["fails"] as error:
        last = str(error).strip().splitlines()
        pyfuncitem.user_properties.append(("hard case broken", last[0] if last else type(error).__name__))
        return True
    pytest.fail(f"nothing broke without the guard ({mark.kwargs['guard']}); the test returned {result!r}")


@pytest.fixture
def holds(request, unguarded):
    """See :class:`hard_cases.cases.Holds`."""
    mark = request.node.get_closest_marker("hard_case")
    assert mark, "a test that asks whether a bound holds is marked as a hard case"
    about = {name: mark.kwargs[name] for name in ("group", "case", "peers", "guard")}
    add = request.node.user_properties.append
    return Holds(lambda row: add(("hard case", {**about, "unguarded": unguarded, **row})))


@pytest.fixture
def one_thread():
    """Scenes so tiny are done by one thread before two have met."""
    import numba

    before = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(before)
