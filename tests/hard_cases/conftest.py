"""Runs each hard case with its guard, and among the slow tests without it; a fixture for its bounds."""

import pytest
from hard_cases import made_surfaces
from hard_cases.cases import Holds


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
