"""Names of the surfaces of a comparison, their groups, and their colours."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from morphofold.analysis.measures import Measures
from morphofold.errors import NamedTwice, NothingToDo, NotReadable, UnknownName
from morphofold.quantities import CATEGORICAL_COLOURS
from morphofold.surface import check_kind

HemisphereNames = Mapping[
    str, tuple[str, ...]
]  # names of single hemispheres, by the name of both hemispheres or of their group


def named_surfaces(
    surfaces: Mapping[str, Measures | Sequence[Measures]],
) -> tuple[dict[str, Measures], HemisphereNames]:
    """Single hemispheres by name, and these names by the names that were given.

    Raises
    ------
    ValueError
        If there is nothing to compare, or two surfaces end up with one name.
    """
    named: dict[str, Measures] = {}
    full: dict[str, tuple[str, ...]] = {}
    for name, entry in surfaces.items():
        several: list[Any] = list(entry) if isinstance(entry, list | tuple) else [entry]
        for m in several:
            check_kind(m, Measures, f"compare: {name}")
        full[name] = tuple(name if len(several) == 1 else f"{name} {m.cortex.hemi}" for m in several)
        for own, m in zip(full[name], several):
            if own in named:
                raise NamedTwice(
                    f"{own!r} names two surfaces ({named[own].cortex.name} and {m.cortex.name}, both "
                    f"{m.cortex.hemi}). Give them different names."
                )
            named[own] = m
    if not full or not all(full.values()):
        raise NothingToDo('nothing to compare: pass at least one surface, e.g. {"model": measures}.')
    return named, full


def grouped_names(full: HemisphereNames, groups: Mapping[str, Sequence[str]] | None) -> dict[str, tuple[str, ...]]:
    """Names of the surfaces of each group; raises ``ValueError`` for a name that is not there, or in two groups."""
    if groups is None:
        return dict(full)
    asked = [name for names in groups.values() for name in names]
    for name in asked:
        if name not in full:
            raise UnknownName(f"a group has the name {name!r}, but the surfaces are {', '.join(full)}.")
        if asked.count(name) > 1:
            raise NamedTwice(f"{name!r} is in two groups; hinges can't be compared with themselves.")
    return {group: tuple(n for name in names for n in full[name]) for group, names in groups.items()}


def colours_of(full: HemisphereNames, groups: HemisphereNames, asked: Mapping[str, str]) -> dict[str, str]:
    """A colour for each surface: the one given to it or to its group, or the next of ours.

    Raises
    ------
    ValueError
        If a colour can't be read, or its name is unknown.
    """
    each = {name: (name,) for names in full.values() for name in names}
    grouped = {name for names in groups.values() for name in names}
    families = [*groups.values(), *(names for names in full.values() if not grouped & set(names))]
    colours = {n: CATEGORICAL_COLOURS[k % len(CATEGORICAL_COLOURS)] for k, names in enumerate(families) for n in names}
    for name, colour in asked.items():
        if name not in {*groups, *full, *each}:
            raise UnknownName(f"a colour is given to {name!r}, which is not among {', '.join({**groups, **full})}.")
        if not re.fullmatch("#[0-9a-fA-F]{6}", colour):
            raise NotReadable(f"{colour!r} is not a colour ({name}); write it as red, green and blue, such as #0072b2.")
    for known in (groups, full, each):
        for name in known.keys() & asked.keys():
            colours.update(dict.fromkeys(known[name], asked[name].lower()))
    return {name: colours[name] for name in each}
