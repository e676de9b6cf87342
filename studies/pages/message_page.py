"""The tables of docs/messages.md: the codes of errors, of warnings about surfaces, and of the health of simulations.

``python -m morphofold.studies.pages.message_page docs/messages.md`` writes them between the marks of that page.
"""

import sys
from pathlib import Path

from morphofold.errors import Refusal
from morphofold.note_texts import LEVELS, VERDICTS, WARNINGS
from morphofold.sim.stage_checks import BOUNDS, LEAST_J, cures
from morphofold.studies.markdown import table, update_page

#: meaning of the numbers that decide on health
HEALTH_MEANING = {
    "distance_over_T": "distance of the surface from equilibrium, in thicknesses of the cortex",
    "cell_over_T": "largest edge or height of a brick of the cortex, in thicknesses of the cortex, once wrinkled",
    "cell_over_wave": "largest edge over the length of the first wrinkles by theory, once wrinkled",
    "kinetic_over_strain": "kinetic over strain energy",
    "overlap": "share of the enclosed length of rays that the surface covers twice",
    "winding_max": "largest number of times that the surface winds around a point inside it",
    "crossings": "edges and vertices that cross the surface",
    "deepest_crossing": "depth of the deepest crossing, in mean edges",
    "volume_drift": "change of volume that growth does not account for",
    "bending": "bending of the body as a whole",
    "unstable_modes": "negative eigenvalues of the stiffness: modes in which the stage would fold further by itself",
    "lowest_J": "least volume ratio of any Gauss point so far",
}


def refusals() -> str:
    """A row for each kind of error: its code, class, cause and cure."""
    return table(
        ("code", "class", "cause", "cure"),
        [
            (f"`{cls.code}`", f"`{cls.__name__}`", *(" ".join(text.split()) for text in str(cls.__doc__).split("\n\n")))
            for cls in Refusal.__subclasses__()
        ],
    )


def warnings() -> str:
    """A row for each warning about surfaces, with what it makes of them."""
    rows = [(f"`{code}`", VERDICTS[LEVELS[code]], *cause_cure) for code, cause_cure in WARNINGS.items()]
    return table(("code", "advice", "cause", "cure"), rows)


def health() -> str:
    """A row for each number that decides on the health of a stage."""
    bound_and_cures = {code: (f"{maximum:g} at most", cure_keys) for code, (maximum, cure_keys) in BOUNDS.items()}
    bound_and_cures["lowest_J"] = (f"{LEAST_J:g} at least", ("finer", "slower"))
    return table(
        ("code", "meaning", "bound", "cure"),
        [
            (f"`{code}`", HEALTH_MEANING[code], bound_text, "; or ".join(cures()[cure_key] for cure_key in cure_keys))
            for code, (bound_text, cure_keys) in bound_and_cures.items()
        ],
    )


def write(page: Path) -> None:
    """Put the tables between the marks of ``page``; raises as :func:`morphofold.studies.markdown.renewed`."""
    update_page(page, {"refusals": [refusals()], "warnings": [warnings()], "health": [health()]})


if __name__ == "__main__":
    write(Path(sys.argv[1]))
