"""Which of the compared cortices grew from which of the compared people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from morphofold.analysis.measures import Measures


class Pair(NamedTuple):
    """Names of a person and of a cortex that grew from it, and the level at which the person was unfolded."""

    person: str
    grown: str
    level: float


def find_pairs(named: Mapping[str, Measures]) -> tuple[list[Pair], list[str]]:
    """Pairs among measured cortices, and a remark for each cortex that grew from someone who is not among them.

    A cortex is the person if its white surface has the SHA-256 of the surface that grew, byte for byte, and the same
    hemisphere. ``info["grown_from"]`` has what grew; the records of the files that were read have the digests.
    """
    pairs, remarks = [], []
    for name, m in named.items():
        source = m.cortex.info.get("grown_from")
        if not source:
            continue
        wanted = source["sha256"].get("surface")
        people = [
            other
            for other, of in named.items()
            if other != name and of.cortex.hemi == m.cortex.hemi and wanted and white_digest(of) == wanted
        ]
        pairs += [Pair(person, name, float(source["unfold"])) for person in people[:1]]
        if not people:
            remarks.append(
                f"{name} grew from {m.cortex.hemi} of {source['subject']}, but no compared analysis is of the surface "
                f"that it grew from (SHA-256 {str(wanted)[:12]}). Analyze that subject and add it, to see its own "
                "folds beside the grown ones."
            )
    return pairs, remarks


def white_digest(m: Measures) -> str | None:
    """SHA-256 of the file of the white surface; None if it was not read from a file."""
    records = {record["path"]: record["sha256"] for record in m.cortex.inputs}
    return records.get(m.cortex.files[0]) if m.cortex.files else None
