"""Where the hinges and crests of a study's subjects are, and how many they have in common, against chance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from morphofold.analysis.mesh_quality.checks import is_no_cortex
from morphofold.analysis.smoothing import smooth
from morphofold.arrays import Array, Ints
from morphofold.errors import DoesNotApply, OutOfRange
from morphofold.geometry import vertex_areas
from morphofold.inference.rotated import Landmarks, common, common_by_chance
from morphofold.inference.spaces import HEMIS, Space, areas_of
from morphofold.progress import Progress, part_of, silent
from morphofold.unfolding.unfold import points_on_sphere

KINDS = {"hinges": ("hinges", "hinge_distance"), "crests": ("crest_length", "crest_distance")}  # amount, distance
WHOLE = "hemisphere"
DENSITY_FWHM_MM = 10.0
MM2_PER_CM2 = 100.0
MOST_COLUMNS = 200  # maps that are smoothed at once
ROUND_OFF = 1e-9
COLUMNS = (
    "hemi",
    "kind",
    "region",
    "subjects",
    "amount",
    "density",
    "share",
    "chance",
    "chance_low",
    "chance_high",
    "p",
    "p_corrected",
)


@dataclass(frozen=True, eq=False)
class Overlap:
    """Hinges or crests of a study's subjects on its template.

    Attributes
    ----------
    kind : {"hinges", "crests"}
    radius : float
        Within which a subject has one [mm].
    rows : list of dict
        With ``COLUMNS``: a row for each region, and one for each hemisphere. ``amount`` is the mean of the subjects,
        ``density`` that for each cm^2.
    density, chance, p : mapping of hemisphere to (N,) float
        Hinges [1/cm^2] or length of crests [mm/cm^2] of a subject, smoothed, NaN outside the cortex; the mean of that
        under rotations; and the share of rotations with a density that is anywhere as far from its mean, in either
        direction.
    """

    kind: str
    radius: float
    rows: list[dict[str, Any]]
    density: Mapping[str, Array]
    chance: Mapping[str, Array]
    p: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class _Side:
    """One hemisphere: what is common (1 + T, K, 2, N), as it is and then rotated; areas (N,) and regions (N,)."""

    subjects: int
    found: Array
    areas: Array
    labels: Ints
    names: tuple[str, ...]

    def by_region(self, values: Array) -> Array:
        """Sums of values (..., N) over each region, and over all vertices: (..., R + 1)."""
        inside = np.equal.outer(self.labels, np.arange(len(self.names))).astype(np.float64)
        return values @ np.column_stack([inside, np.ones(len(inside))])


def overlap(
    space: Space,
    *,
    radius: float | None = None,
    fwhm: float = DENSITY_FWHM_MM,
    hemis: Sequence[str] = HEMIS,
    spins: int = 1000,
    seed: int = 0,
    progress: Progress = silent,
) -> list[Overlap]:
    """The density of hinges and crests over a template, and the share of a subject's that another subject has, too.

    Parameters
    ----------
    space : Space
        With the maps ``hinges``, ``hinge_distance``, ``crest_length``, ``crest_distance`` that ``cohort --space``
        writes.
    radius : float, optional
        A subject has a hinge at a place if one is within this distance along its own white surface [mm]. None: half of
        the median gyral width of the study.
    fwhm : float
        Smoothing of the density [mm].
    hemis : sequence of {"lh", "rh"}
    spins, seed : int
        Random rotations, of each subject by its own.
    progress : callable

    Returns
    -------
    list of Overlap
        Of hinges, then of crests. ``share`` is the share of the hinges in a region, or of the length of crests, over
        all ordered pairs of subjects; ``chance``, ``chance_low`` and ``chance_high`` are its mean and the middle 95 %
        under rotations, ``p`` the share of rotations with at least that share. ``p_corrected`` holds for all rows of a
        kind: by the largest distance from chance, in standard deviations of that row.

    Raises
    ------
    ValueError
        If the study has no such maps, fewer than two subjects or no gyral width, or a number is not positive.
    """
    radius = _radius(space, radius)
    if not (fwhm > 0 and spins >= 1):
        raise OutOfRange(f"fwhm and the number of rotations must be positive, got {fwhm!r} and {spins!r}.")
    sides, smoothed = {}, {}
    for k, hemi in enumerate(hemis):
        show = part_of(progress, k / len(hemis), 1 / len(hemis), f"{hemi}: ")
        sides[hemi] = _side(space, hemi, radius, spins, seed + k, part_of(show, 0.0, 0.7, ""))
        smoothed[hemi] = _densities(space, hemi, sides[hemi], fwhm, part_of(show, 0.7, 0.3, ""))
    p = _density_p(smoothed)
    return [
        Overlap(
            kind,
            radius,
            _rows(kind, k, sides),
            {hemi: densities[0, k] for hemi, densities in smoothed.items()},
            {hemi: densities[1:, k].mean(axis=0) for hemi, densities in smoothed.items()},
            {hemi: of_kinds[k] for hemi, of_kinds in p.items()},
        )
        for k, kind in enumerate(KINDS)
    ]


def _radius(space: Space, radius: float | None) -> float:
    if radius is None:
        if space.about.graph_width_mm is None:
            raise DoesNotApply(f"{space.folder}: no gyral width is known. Pass a radius in mm.")
        radius = 0.5 * space.about.graph_width_mm
    if not (np.isfinite(radius) and radius > 0):
        raise OutOfRange(f"the radius must be a positive length in mm, got {radius!r}.")
    return radius


def _side(space: Space, hemi: str, radius: float, spins: int, seed: int, progress: Progress) -> _Side:
    rows = np.flatnonzero(space.hemis[hemi])
    if len(rows) < 2:
        raise DoesNotApply(f"{space.folder}: {len(rows)} subjects have maps of {hemi}; two are needed to compare them.")
    amounts, far = (
        np.stack([np.asarray(space.map(hemi, names[k]), dtype=np.float64)[rows] for names in KINDS.values()])
        for k in (0, 1)
    )
    sphere, cortex = space.sphere(hemi), space.cortex(hemi)
    points = points_on_sphere(sphere, sphere)
    marks = Landmarks(
        np.where(cortex, np.nan_to_num(amounts), 0.0),
        far <= radius,
        points,
        vertex_areas(points, sphere.faces),
        np.where(cortex, areas_of(space, hemi, rows), 0.0),
    )
    found = np.concatenate([common(marks)[None], common_by_chance(marks, spins, seed, progress)])
    return _Side(len(rows), found, marks.areas, *_labels(space, hemi))


def _labels(space: Space, hemi: str) -> tuple[Ints, tuple[str, ...]]:
    """Number of the region (N,) at each vertex, -1: none; and the names of the regions."""
    regions, cortex = space.regions(hemi), space.cortex(hemi)
    labels, names = np.full(len(cortex), -1), list[str]()
    for k, name in enumerate(() if regions is None else regions.names):
        if regions is not None and not is_no_cortex(name):
            labels[cortex & (regions.labels == k)] = len(names)
            names.append(name)
    return labels, tuple(names)


def _densities(space: Space, hemi: str, side: _Side, fwhm: float, progress: Progress) -> Array:
    """Smoothed densities (1 + T, K, N) of a subject, for each cm^2; NaN outside the cortex."""
    white, cortex = space.surface(hemi), space.cortex(hemi)
    around = vertex_areas(white.verts, white.faces)[:, None]
    area = smooth(white.verts, white.faces, side.areas[:, None] / around, fwhm, cortex, fill=0.0)
    columns = side.found[:, :, 0].reshape(-1, len(cortex))
    smoothed: Array = np.empty(columns.shape, dtype=np.float32)
    for start in range(0, len(columns), MOST_COLUMNS):
        part = slice(start, start + MOST_COLUMNS)
        spread = smooth(white.verts, white.faces, columns[part].T / around, fwhm, cortex, fill=0.0)
        smoothed[part] = (MM2_PER_CM2 / side.subjects * spread / area).T
        progress(min(1.0, part.stop / len(columns)), "smoothing")
    return smoothed.reshape(len(side.found), len(KINDS), -1)


def _density_p(smoothed: Mapping[str, Array]) -> dict[str, Array]:
    """Corrected p (K, N) by hemisphere, over all of them, of densities (1 + T, K, N), the study's and rotated ones."""
    away = {}
    for hemi, maps in smoothed.items():
        spread = maps[1:].std(axis=0)
        away[hemi] = np.divide(np.abs(maps - maps[1:].mean(axis=0)), spread, out=np.zeros_like(maps), where=spread > 0)
    largest = np.max([one[1:].max(axis=2) for one in away.values()], axis=0)  # (T, K)
    return {
        hemi: np.stack(
            [
                np.where(np.isfinite(smoothed[hemi][0, k]), _above(one[0, k], largest[:, k]), np.nan)
                for k in range(len(KINDS))
            ]
        )
        for hemi, one in away.items()
    }


def _above(values: Array, null: Array) -> Array:
    """Share of the null (T,) that is at least as large as each value, the value itself among them."""
    above = len(null) - np.searchsorted(np.sort(null), values - ROUND_OFF * np.abs(values), side="left")
    return (1 + above) / (1 + len(null))


def _rows(kind: str, k: int, sides: Mapping[str, _Side]) -> list[dict[str, Any]]:
    rows, scores = [], []
    for hemi, side in sides.items():
        for row, score in _rows_of_side(kind, k, hemi, side):
            rows.append(row)
            if score is not None:
                scores.append((row, score))
    if scores:
        largest = np.max([score[1:] for _, score in scores], axis=0)
        for row, score in scores:
            row["p_corrected"] = float(_above(score[:1], largest)[0])
    return rows


def _rows_of_side(kind: str, k: int, hemi: str, side: _Side) -> Iterator[tuple[dict[str, Any], Array | None]]:
    """Each row with how far its share, and each rotated one (1 + T,), are from chance [standard deviations]."""
    amounts, shared = (side.by_region(side.found[:, k, i]) for i in (0, 1))  # (1 + T, R + 1)
    shares = np.divide(shared, amounts, out=np.full(shared.shape, np.nan), where=amounts > 0)
    for r, (region, area) in enumerate(zip((*side.names, WHOLE), side.by_region(side.areas))):
        amount, share, chance = float(amounts[0, r]) / side.subjects, shares[0, r], shares[1:, r]
        row: dict[str, Any] = {"hemi": hemi, "kind": kind, "region": region, "subjects": side.subjects}
        row |= {"amount": amount, "density": MM2_PER_CM2 * amount / area if area > 0 else None}
        known = chance[np.isfinite(chance)]
        if not (np.isfinite(share) and len(known)):
            yield row, None
            continue
        low, high = np.percentile(known, (2.5, 97.5))
        row |= {"share": float(share), "chance": float(known.mean()), "chance_low": low, "chance_high": high}
        row["p"] = float(_above(np.array([share]), known)[0])
        all_of = np.nan_to_num(np.append(share, chance), nan=float(known.mean()))
        yield row, (all_of - known.mean()) / known.std() if known.std() > 0 else None
