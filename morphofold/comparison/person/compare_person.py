"""Compare a cortex with the folds of the person it grew from, and both with the smooth body as control.

``side_by_side`` passes measured cortices by name, and gets a ``PersonComparison`` for each that grew from another one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphofold.analysis.measures_result import Measures
from morphofold.comparison.person.common_sphere import Bodies, bodies_of
from morphofold.comparison.person.fold_axes import Axes, agreement_of_axes, axes_of_bodies, forwardness
from morphofold.comparison.person.fold_heights import (
    FOLD_DEGREES,
    agreement_of_crests,
    agreement_of_heights,
    agreement_of_valleys,
    bands_of,
    heights_of_bodies,
    same_side,
)
from morphofold.comparison.person.grown_regions import numbers_of_regions
from morphofold.comparison.person.person_agreement import (
    SPINS,
    Agreement,
    Statistic,
    agreement_of_classes,
    agreement_with_controls,
    classes,
    null_values,
)
from morphofold.digests_and_json import Row, json_value
from morphofold.errors import MissingPart, Refusal
from morphofold.frozen_arrays import Array
from morphofold.io import write_gifti_map
from morphofold.number_texts import listed, number
from morphofold.quantities import RELIEF
from morphofold.tables import write_table
from morphofold.unfolding.harmonics import Expansion

MeasuresByName = Mapping[str, Measures]
CARRIED_MAPS = (
    "H",
    "cortical_thickness",
    "gyral_thickness",
    "sulcal_depth",
    "local_gyrification_index",
    RELIEF,
    "sulc",
)
LIKE_SIZES = (0.8, 1.25)  # of a grown cortex over the person's, within which maps in mm are compared as they are
#: agreements over the cortex, and the maps of a smooth body that are their controls; both maps of both agreements of
#: sulci and gyri, so that growth does not win by another measure of the same folds
CONTROLS = {
    "folds": (RELIEF,),
    "valleys": (RELIEF,),
    "depth": (RELIEF, "H"),
    "curvature": (RELIEF, "H"),
    "axes": ("axes",),
    "crests": ("crests",),
}


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
        Of heights of folds in harmonic degrees 7 to 30, their valleys, depth, curvature, fold axes and, if both have a
        gyral net, its crests.
    bands : tuple of dict
        Correlation of heights in each band of degrees (``low`` to ``high``): of ``grown``, ``smooth`` and
        ``deepened`` body with the person.
    forwardness : mapping of str to float
        Mean cos 2a of fold axes with the front-back axis, of ``person``, ``smooth`` and ``grown``.
    correlations : tuple of Agreement
        Empty without regions.
    regions : tuple of dict
        A row for each region: each measure of each body that has it.
    bodies : Bodies
        Points, carriers and maps.
    same_side : (N,) float64
        At the vertices of the grown cortex: 1 where both are gyrus or both sulcus by the heights of folds, -1 where
        they are not, NaN off the cortex.
    """

    person: str
    grown: str
    hemi: str
    level: float
    scale: float
    spins: int
    agreements: tuple[Agreement, ...]
    bands: tuple[Row, ...]
    forwardness: Mapping[str, float]
    correlations: tuple[Agreement, ...]
    regions: tuple[Row, ...]
    bodies: Bodies
    same_side: Array

    def __repr__(self) -> str:
        agreements = ", ".join(f"{row.what} {row.tested.value:.2f} ({row.verdict})" for row in self.agreements)
        return f"PersonComparison({self.grown!r} beside {self.person!r}, {self.hemi}: {agreements})"

    @property
    def verdict(self) -> str:
        """That of the heights of folds, the question that is asked first."""
        return self.agreements[0].verdict

    def carried(self) -> dict[tuple[str, str], Array]:
        """Maps of one cortex at the vertices of the other, by ("to_grown" or "to_person", map).

        ``sulc`` is the person's file, in FreeSurfer's sign.
        """
        bodies, carried_maps = self.bodies, {}
        for direction, body in (("to_grown", bodies.person), ("to_person", bodies.grown)):
            maps = {**body.measures.cortex.maps, **body.measures.maps}
            for name in filter(maps.__contains__, CARRIED_MAPS):
                carried_maps[direction, name] = getattr(bodies, direction).values(maps[name])
        return carried_maps

    def rows(self) -> list[Row]:
        """A row for each agreement: the same columns for the whole cortex and for regions."""
        return [
            {
                "person": self.person,
                "grown": self.grown,
                "hemi": self.hemi,
                "over": scope,
                "what": row.what,
                **vars(row.tested),
                "deepened": row.deepened.control,
                "deepened_map": row.deepened.control_map,
                "deepened_difference": row.deepened.difference,
                "deepened_p": row.deepened.difference_p,
                "n_regions": row.n,
                "p_corrected": row.p_corrected,
                "verdict": row.verdict,
            }
            for scope, rows in (("cortex", self.agreements), ("regions", self.correlations))
            for row in rows
        ]

    def to_dict(self) -> Row:
        """Everything but maps, as plain values for JSON."""
        content = {
            "person": self.person,
            "grown": self.grown,
            "hemi": self.hemi,
            "unfold": self.level,
            "scale": self.scale,
            "spins": self.spins,
            "verdict": self.verdict,
            "agreements": self.rows(),
            "bands": self.bands,
            "forwardness": self.forwardness,
            "regions": self.regions,
        }
        return json_value(content)


def compare_people(measures_of: MeasuresByName, *, spins: int, seed: int) -> tuple[list[PersonComparison], list[str]]:
    """Each cortex that grew from a person who is also there, with that person; and remarks, as on who is missing."""
    pairs, remarks = find_pairs(measures_of)
    people = []
    for person, grown, level in pairs:
        try:
            comparison = compare_with_person(
                measures_of[person], measures_of[grown], level, names=(person, grown), spins=spins, seed=seed
            )
        except Refusal as error:
            remarks.append(f"{grown} is not compared with the folds of {person}, from which it grew: {error}")
            continue
        people.append(comparison)
        if not LIKE_SIZES[0] <= comparison.scale <= LIKE_SIZES[1]:
            remarks.append(
                f"The hull of {grown} has the area of {person}'s only if its lengths are multiplied by "
                f"{number(comparison.scale, 2)}, but curvature and local gyrification were measured at the same scales "
                "in mm. Grow it with a radius multiplied by that."
            )
    return people, remarks


def find_pairs(measures_of: MeasuresByName) -> tuple[list[tuple[str, str, float]], list[str]]:
    """Pairs among measured cortices, and a remark for each cortex that grew from someone who is not among them.

    A pair is the name of a person, that of a cortex that grew from it, and the level at which the person was unfolded.
    A cortex is the person if its white surface has the SHA-256 of the surface that grew, byte for byte, and the same
    hemisphere. ``info["grown_from"]`` has what grew; the records of the files that were read have the digests.
    """
    pairs, remarks = [], []
    for name, grown in measures_of.items():
        grown_from = grown.cortex.info.get("grown_from")
        if not grown_from:
            continue
        digest = grown_from["sha256"].get("surface")
        people = [
            person
            for person, measures in measures_of.items()
            if digest in [row["sha256"] for row in measures.cortex.inputs if row["path"] in measures.cortex.files[:1]]
            and measures.cortex.hemi == grown.cortex.hemi
        ]
        if people:
            pairs.append((people[0], name, float(grown_from["unfold"])))
            continue
        remarks.append(
            f"{name} grew from {grown.cortex.hemi} of {grown_from['subject']}, but no compared analysis is of the "
            f"surface that it grew from (SHA-256 {str(digest)[:12]}). Analyze that subject and add it, to see its own "
            "folds beside the grown ones."
        )
    return pairs, remarks


def compare_with_person(
    person: Measures,
    grown: Measures,
    level: float,
    *,
    names: tuple[str, str] = ("person", "grown"),
    spins: int = SPINS,
    seed: int = 0,
) -> PersonComparison:
    """Compare a grown cortex with the person it grew from.

    Parameters
    ----------
    person, grown : Measures
        Of cortices with a sphere, on which both have points.
    level : float
        At which the person was unfolded.
    names : (str, str)
    spins : int
        Number of rotations of the person's sphere.
    seed : int

    Raises
    ------
    ValueError
        If one was measured in part (``only``), and as :func:`morphofold.comparison.person.common_sphere.bodies_of`.

    Notes
    -----
    Agreements are taken at the vertices of the grown cortex, weighted by the area of the smooth body, without the
    medial walls of both. The control of an agreement is the map of the smooth body that agrees best. A second control
    is the smooth body with its dents deepened: on fsaverage5 at level 0.03 its curvature agrees with the person's depth
    on 0.84 of the area, that of the smooth body itself on 0.76, so what beats only the latter is no more than what
    unfolding left.
    """
    for name, m in zip(names, (person, grown)):
        if "only" in m.parameters:
            raise MissingPart(f"{name}: was measured in part, only {listed(m.parameters['only'])}. Measure it whole.")
    bodies = bodies_of(person, grown, level)
    axes, regions = axes_of_bodies(bodies), numbers_of_regions(bodies)
    heights = heights_of_bodies(bodies)
    statistics = _statistics(bodies, axes, heights)
    what = list(CONTROLS)[: len(statistics)]
    if regions is not None:
        statistics.append(regions.correlations)
    values = [statistic(bodies.to_grown.nearest, np.eye(3)) for statistic in statistics]
    null = null_values(statistics, bodies.grown.points, bodies.person.points, spins, seed)
    body_of = {"person": bodies.person, "smooth": bodies.grown, "grown": bodies.grown}
    given_maps = grown.cortex.info.get("grown_from", {}).get("maps", [])
    return PersonComparison(
        *names,
        person.cortex.hemi,
        level,
        bodies.grown.scale,
        spins,
        tuple(agreement_with_controls(key, own, spun, CONTROLS[key]) for key, own, spun in zip(what, values, null)),
        bands_of(bodies, heights),
        {name: forwardness(*axes[name], bodies.smooth, body.points, body.weights) for name, body in body_of.items()},
        regions.agreements(values[-1], null[-1], given_maps) if regions else (),
        regions.table(person.cortex.hemi) if regions else (),
        bodies,
        same_side(bodies, heights),
    )


def _statistics(bodies: Bodies, axes: Mapping[str, Axes], heights: Mapping[str, Expansion]) -> list[Statistic]:
    """Agreements in the order of ``CONTROLS``; the last is left out where one has no gyral net.

    Each is a number of the grown body, then of the maps of the smooth body, then of those of the deepened one.
    """
    weights, person, grown_maps = bodies.grown.weights, bodies.person, bodies.grown.measures.maps
    control_maps = [control.maps[name] for control in bodies.controls.values() for name in CONTROLS["depth"]]
    class_agreements = [
        agreement_of_classes(
            [classes(values, weights) for values in (grown_maps[name], *control_maps)],
            classes(person.measures.maps[name], person.areas),
            weights,
        )
        for name in (RELIEF, "H")
    ]
    compared_axes = [axes[name] for name in ("grown", "smooth", "deepened")]
    return [
        agreement_of_heights(bodies, heights, *FOLD_DEGREES),
        agreement_of_valleys(bodies, heights),
        *class_agreements,
        agreement_of_axes(compared_axes, axes["person"], weights, bodies.grown.points),
        *filter(None, [agreement_of_crests(bodies)]),
    ]


def write_people(people: Sequence[PersonComparison], folder: Path) -> None:
    """Write ``person.tsv``, ``person_regions.tsv`` and ``carried/``; nothing if there is no comparison.

    ``carried/K/to_grown/?h.NAME.shape.gii`` has maps of the person at the vertices of the grown cortex of comparison K,
    counted from 1, and ``carried/K/to_person`` those of the grown cortex at the person's vertices.
    """
    if not people:
        return
    region_rows = [{"person": pair.person, "grown": pair.grown, **row} for pair in people for row in pair.regions]
    write_table(folder / "person.tsv", (), [row for pair in people for row in pair.rows()])
    write_table(folder / "person_regions.tsv", ("person", "grown", "hemi", "region"), region_rows)
    for pair_number, pair in enumerate(people, start=1):
        for (direction, name), values in pair.carried().items():
            map_file = folder / "carried" / str(pair_number) / direction / f"{pair.hemi}.{name}.shape.gii"
            map_file.parent.mkdir(parents=True, exist_ok=True)
            write_gifti_map(map_file, values, nan=np.nan, hemi=pair.hemi)
