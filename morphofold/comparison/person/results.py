"""Results of a comparison of a grown cortex with the person it grew from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from morphofold.arrays import Array
from morphofold.comparison.person.bodies import Bodies
from morphofold.comparison.person.spins import LEVEL_OF_SIGNIFICANCE, Tested
from morphofold.quantities import RELIEF

CARRIED_MAPS = ("H", "cortical_thickness", "gyral_thickness", "sulcal_depth", "local_gyrification_index", RELIEF)
#: verdicts
ABOVE_CONTROL, ABOVE_SPINS, DEEPENED, GIVEN, NONE = "above control", "above spins", "deepened", "given", "none"


@dataclass(frozen=True)
class Agreement:
    """An agreement over the cortex: ``depth`` and ``curvature`` are shares of area, ``axes`` is a mean cos 2 delta.

    ``tested`` has the smooth body as control, ``deepened`` the smooth body with its dents deepened. ``control_map`` and
    ``deepened_map`` are the maps of these that agree best with the person.
    """

    what: str
    tested: Tested
    control_map: str
    deepened: Tested
    deepened_map: str

    @property
    def verdict(self) -> str:
        """``"above control"``; ``"deepened"`` if it is no better than deepened dents of the smooth body; ``"none"``."""
        return _verdict(self.tested, self.deepened)


@dataclass(frozen=True)
class RegionAgreement:
    """Rank correlation of a measure over ``n`` regions, person with grown; ``p_corrected`` is that of Holm.

    ``given``: the body got the measure from the person, so that agreement is no result.
    """

    what: str
    tested: Tested
    deepened: Tested
    n: int
    p_corrected: float
    given: bool = False

    @property
    def verdict(self) -> str:
        """As of an :class:`Agreement`; also ``"above spins"`` where the smooth body can't have the measure, and
        ``"given"``."""
        if self.given:
            return GIVEN
        return _verdict(self.tested, self.deepened) if self.p_corrected < LEVEL_OF_SIGNIFICANCE else NONE


def _verdict(tested: Tested, deepened: Tested) -> str:
    if not tested.beats:
        return NONE
    if tested.difference is None:
        return ABOVE_SPINS
    return ABOVE_CONTROL if deepened.beats else DEEPENED


@dataclass(frozen=True, eq=False)
class PersonComparison:
    """A grown cortex beside the person it grew from.

    Attributes
    ----------
    person, grown : str
        Their names in the comparison.
    hemi : str
    level : float
        At which the person was unfolded.
    scale : float
        Factor of the lengths of the grown cortex: its hull then has the area of the person's.
    spins : int
    agreements : tuple of Agreement
        By depth, curvature and fold axes.
    forwardness : mapping of str to float
        Mean cos 2a of fold axes with the front-back axis, of ``person``, ``smooth`` and ``grown``.
    correlations : tuple of RegionAgreement
        Empty without regions.
    regions : tuple of dict
        A row for each region: each measure of each body that has it.
    bodies : Bodies
        Points, carriers and maps.
    """

    person: str
    grown: str
    hemi: str
    level: float
    scale: float
    spins: int
    agreements: tuple[Agreement, ...]
    forwardness: Mapping[str, float]
    correlations: tuple[RegionAgreement, ...]
    regions: tuple[dict[str, Any], ...] = field(repr=False)
    bodies: Bodies = field(repr=False)

    def __repr__(self) -> str:
        found = ", ".join(f"{one.what} {one.tested.value:.2f} ({one.verdict})" for one in self.agreements)
        return f"PersonComparison({self.grown!r} beside {self.person!r}, {self.hemi}: {found})"

    @property
    def verdict(self) -> str:
        """That of sulci and gyri by depth, the question that is asked first."""
        return self.agreements[0].verdict

    def carried(self) -> dict[tuple[str, str], Array]:
        """Maps of one cortex at the vertices of the other, by ("to_grown" or "to_person", map).

        ``sulc`` is the person's file, in FreeSurfer's sign.
        """
        found = {}
        for where, carrier, body in (
            ("to_grown", self.bodies.to_grown, self.bodies.person),
            ("to_person", self.bodies.to_person, self.bodies.grown),
        ):
            maps = {**body.measures.cortex.maps, **body.with_height().maps}
            for name in (*CARRIED_MAPS, "sulc"):
                if name in maps:
                    found[where, name] = carrier.values(maps[name])
        return found

    def rows(self) -> list[dict[str, Any]]:
        """A row for each agreement: the same columns for the whole cortex and for regions."""
        common = {"person": self.person, "grown": self.grown, "hemi": self.hemi}
        return [
            {
                **common,
                "over": over,
                "what": row.what,
                **asdict(row.tested),
                "control_map": getattr(row, "control_map", None),
                "deepened": row.deepened.control,
                "deepened_map": getattr(row, "deepened_map", None),
                "deepened_difference": row.deepened.difference,
                "deepened_p": row.deepened.difference_p,
                "n_regions": getattr(row, "n", None),
                "p_corrected": getattr(row, "p_corrected", None),
                "verdict": row.verdict,
            }
            for over, rows in (("cortex", self.agreements), ("regions", self.correlations))
            for row in rows
        ]

    def region_rows(self) -> list[dict[str, Any]]:
        """A row for each region, with the names of the two."""
        return [{"person": self.person, "grown": self.grown, **row} for row in self.regions]

    def to_dict(self) -> dict[str, Any]:
        """Everything but maps, as plain values for JSON."""
        return {
            "person": self.person,
            "grown": self.grown,
            "hemi": self.hemi,
            "unfold": self.level,
            "scale": self.scale,
            "spins": self.spins,
            "verdict": self.verdict,
            "agreements": [_known(row) for row in self.rows()],
            "forwardness": _known(self.forwardness),
            "regions": [_known(row) for row in self.regions],
        }


def _known(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row with None for NaN."""
    return {key: None if isinstance(v, float) and not np.isfinite(v) else v for key, v in row.items()}
