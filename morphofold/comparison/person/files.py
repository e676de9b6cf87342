"""Files of comparisons with people: tables of agreements and regions, and carried maps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from morphofold.comparison.person.results import PersonComparison
from morphofold.io import write_gifti_map
from morphofold.tables import write_table


def write_people(people: Sequence[PersonComparison], folder: Path) -> None:
    """Write ``person.tsv``, ``person_regions.tsv`` and ``carried/``; nothing if there is no comparison.

    ``carried/K/to_grown/?h.NAME.shape.gii`` has maps of the person at the vertices of the grown cortex of comparison K,
    counted from 1, and ``carried/K/to_person`` those of the grown cortex at the person's vertices.
    """
    if not people:
        return
    write_table(folder / "person.tsv", ("person", "grown", "hemi"), [row for found in people for row in found.rows()])
    rows = [row for found in people for row in found.region_rows()]
    write_table(folder / "person_regions.tsv", ("person", "grown", "hemi", "region"), rows)
    for number, found in enumerate(people, start=1):
        for (where, name), values in found.carried().items():
            place = folder / "carried" / str(number) / where
            place.mkdir(parents=True, exist_ok=True)
            write_gifti_map(place / f"{found.hemi}.{name}.shape.gii", values, nan=np.nan, hemi=found.hemi)
