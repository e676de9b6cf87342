"""How wrong measures of a surface are expected to be, from the stored table: one person's hemisphere, measured so."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from morphofold.forecasts.table import table

if TYPE_CHECKING:
    from morphofold.surface import Cortex

ALIKE = 1.5             # ratio of numbers of vertices beyond which a surface is not said to be like the table's
#: what the study held a measure against, in words
AGAINST = {
    "split surface": "the same surface with every triangle cut in four", "whole mesh": "the mesh before it was thinned",
    "smallest voxels": "the smallest voxels",
}  # fmt: skip


@dataclass(frozen=True)
class Measured:
    """A relative error (0.01 is 1 %) of a measure, and what it was held against, in words."""

    error: float
    against: str


@dataclass(frozen=True)
class MeasuredErrors:
    """Errors of an accuracy.

    Attributes
    ----------
    subject : str
        Whose hemisphere they were measured on.
    vertices : int
        Of that.
    errors : mapping
        Quantity to ``Measured``; empty where none are known.
    how : str
        How they were obtained.
    doubts : tuple of str
        Why they may not hold for the surfaces at hand, one sentence each.
    """

    subject: str
    vertices: int
    errors: Mapping[str, Measured]
    how: str
    doubts: tuple[str, ...]


def measured_errors(cortices: Iterable[Cortex], accuracy: str) -> MeasuredErrors:
    """Expected errors of an accuracy: those of the hemisphere in the table that has about as many vertices.

    Of several cortices the one of fewest vertices chooses; every other one that is not like it is doubted. Beyond the
    meshes of the table by more than ``ALIKE`` none are known: a mesh of 42 vertices is off by 26 % in thickness, where
    that of 10,001 is by 5 %.

    Raises
    ------
    ValueError
        If there is no cortex, or no such accuracy.
    """
    from morphofold.analysis.resampling import accuracy_of

    accuracy_of(accuracy)
    cortices = list(cortices)
    sizes = sorted({cortex.n_vertices for cortex in cortices})
    if not sizes:
        raise ValueError("there is no cortex to expect errors of. Pass one at least.")
    persons = table()["errors"]["measuring"]
    least, most = (of(person["vertices"] for person in persons) for of in (min, max))
    nearest = min(persons, key=lambda person: abs(math.log(person["vertices"] / sizes[0])))
    vertices = nearest["vertices"]
    errors = {
        name: Measured(law[accuracy], AGAINST.get(law["against"], law["against"]))
        for name, law in nearest["quantities"].items()
    }
    if not least / ALIKE <= sizes[0] <= most * ALIKE:
        how = f"not known of meshes of {sizes[0]:,} vertices: measured on those of {least:,} to {most:,} only"
        return MeasuredErrors(nearest["subject"], vertices, {}, how, ())
    said = []
    if any(cortex.origin == "simulation" for cortex in cortices):
        said.append("The errors are those of a person's hemisphere, not of a simulated cortex.")
    if unlike := [n for n in sizes if not 1 / ALIKE <= n / vertices <= ALIKE]:
        said.append(
            f"The errors are those of a mesh of {vertices:,} vertices; how much they differ on one of "
            f"{' or '.join(f'{n:,}' for n in unlike)} is not known."
        )
    how = (
        f"what the mesh changes, not noise of the image: measured at {accuracy} on one person's hemisphere "
        f"({nearest['subject']}: {vertices:,} vertices) for docs/accuracy.md, once each, and "
        "no accuracy is told to be better than a dearer one"
    )
    return MeasuredErrors(nearest["subject"], vertices, errors, how, tuple(said))
