"""Hard cases: what a test of one says about itself, and how it records the bound that it holds.

A test of a hard case is marked with :func:`hard_case` and asks the fixture ``holds`` whether its bounds hold. If it
names a guard, it is run a second time, among the slow tests, with the guard removed, and has to fail then: a bound that
nothing could break would prove nothing. ``pytest tests/hard_cases -m "" --hard-cases FILE`` writes what all of them
recorded, and ``hard_case_page.py`` makes the tables of docs/hard-cases.md, and those beside it, of that file.
"""

import math
from collections.abc import Callable

import pytest

GROUPS = ("solver", "laws", "surfaces", "files")
Removal = Callable[[pytest.MonkeyPatch], object]


def hard_case(
    group: str, case: str, *, peers: str = "–", guard: str = "", without: Removal | None = None, fails=AssertionError
):
    """Marks a test.

    Parameters
    ----------
    group : {"solver", "laws", "surfaces", "files"}
    case : str
        In the words of the table.
    peers : str
        What peers do with it, as read or measured (docs/hard-cases.md names the peers).
    guard : str
        What keeps the bound, in a few words.
    without : callable, optional
        Takes the guard away, by the monkeypatch that it is given. The bound has to break then.
    fails : exception or tuple of them
        How the test ends without the guard.
    """
    if group not in GROUPS or bool(guard) != (without is not None):
        raise ValueError(f"{case}: a hard case is of {GROUPS}, with words for its guard and its removal, or neither.")
    return pytest.mark.hard_case(group=group, case=case, peers=peers, guard=guard, without=without, fails=fails)


class Holds:
    """Asserts bounds and records them: ``holds("radius", 0.002, at_most=0.003)``."""

    def __init__(self, record: Callable[[dict[str, object]], None]):
        self.record = record

    def __call__(
        self, what: str, measured: float, *, at_most: float | None = None, at_least: float | None = None, unit: str = ""
    ) -> None:
        """A number within its bounds; NaN is within none."""
        limits = [f"{sign} {limit:g}" for sign, limit in (("≥", at_least), ("≤", at_most)) if limit is not None]
        assert limits, "a bound has a limit"
        in_unit = lambda text: f"{text} {unit}".strip()
        self.record({"what": what, "bound": in_unit(", ".join(limits)), "measured": in_unit(f"{measured:.3g}")})
        assert math.isfinite(measured), f"{what} is {measured}"
        assert at_most is None or measured <= at_most, f"{what}: {measured:g} {unit} is above {at_most:g}"
        assert at_least is None or measured >= at_least, f"{what}: {measured:g} {unit} is below {at_least:g}"

    def equal(self, what: str, first: object, other: object) -> None:
        """Two things that are to be the same: bytes, names, counts."""
        same = first == other
        self.record({"what": what, "bound": "equal", "measured": "equal" if same else "not equal"})
        assert same, f"{what}: {first!r:.200} is not {other!r:.200}"

    def says(self, what: str, message: str, *phrases: str) -> None:
        """A refusal or a warning that holds all the words: the place and the cure."""
        missing = [phrase for phrase in phrases if phrase not in message]
        bound = "says " + ", ".join(f"“{phrase}”" for phrase in phrases)
        self.record({"what": what, "bound": bound, "measured": message.strip()})
        assert phrases
        assert not missing, f"{what}: {message!r} lacks {missing}"
