"""Where the hinges and crests of a study's subjects are, and how many they have in common, against chance."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from morphofold.analysis.smoothing import smooth
from morphofold.arrays import Array
from morphofold.errors import DoesNotApply, OutOfRange
from morphofold.geometry import vertex_areas
from morphofold.group.permutations import share_above
from morphofold.group.rotated import Landmarks, common, common_by_chance
from morphofold.group.spaces import HEMIS, Space, areas_of
from morphofold.mesh_quality.checks import is_no_cortex
from morphofold.progress import Progress, part_of, silent
from morphofold.threads import one_blas_thread
from morphofold.unfolding.unfold import points_on_sphere

KINDS = {"hinges": ("hinges", "hinge_distance"), "crests": ("crest_length", "crest_distance")}  # amount, distance
WHOLE = "hemisphere"
DENSITY_FWHM_MM = 10.0
MM2_PER_CM2 = 100.0
MOST_COLUMNS = 200  # maps that are smoothed at once
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
    """One hemisphere: what is common by region (1 + T, K, 3, R + 1), as it is and then rotated, and its densities.

    The last region is the whole. ``density`` and ``chance`` (K, N) are smoothed; ``away`` (K, N), and the largest of
    each rotation, ``largest`` (T, K), are distances from the mean of all [standard deviations].
    """

    subjects: int
    names: tuple[str, ...]
    by_region: Array
    areas: Array
    density: Array
    chance: Array
    away: Array
    largest: Array


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
        the median crown width of the study.
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
        kind: by how far shares are above the mean, in standard deviations of that row.

    Raises
    ------
    ValueError
        If the study has no such maps, fewer than two subjects or no crown width, or a number is not positive.
    """
    radius = _radius(space, radius)
    if not (np.isfinite(fwhm) and fwhm > 0 and spins >= 1 and seed >= 0):
        raise OutOfRange(
            f"the smoothing and the number of rotations must be positive and the seed not negative, got {fwhm!r}, "
            f"{spins!r} and {seed!r}."
        )
    marks = {hemi: _landmarks(space, hemi, radius) for hemi in hemis}  # refuses before the rotations
    sides = {}
    for k, hemi in enumerate(hemis):
        show = part_of(progress, k / len(hemis), 1 / len(hemis), f"{hemi}: ")
        sides[hemi] = _side(space, hemi, marks.pop(hemi), fwhm, spins, seed + k, show)
    largest = np.max([side.largest for side in sides.values()], axis=0)
    return [
        Overlap(
            kind,
            radius,
            _rows(kind, k, sides),
            {hemi: side.density[k] for hemi, side in sides.items()},
            {hemi: side.chance[k] for hemi, side in sides.items()},
            {hemi: share_above(side.away[k], largest[:, k]) for hemi, side in sides.items()},
        )
        for k, kind in enumerate(KINDS)
    ]


def _radius(space: Space, radius: float | None) -> float:
    if radius is None:
        if space.about.graph_width_mm is None:
            raise DoesNotApply(f"{space.folder}: no crown width is known. Pass a radius in mm.")
        radius = 0.5 * space.about.graph_width_mm
    if not (np.isfinite(radius) and radius > 0):
        raise OutOfRange(f"the radius must be a positive length in mm, got {radius!r}.")
    return radius


def _landmarks(space: Space, hemi: str, radius: float) -> Landmarks:
    there = np.flatnonzero(space.hemis[hemi])
    _refuse_few(space, hemi, len(there))
    amounts, far = (
        np.stack([np.asarray(space.map(hemi, names[k]), dtype=np.float64)[there] for names in KINDS.values()])
        for k in (0, 1)
    )
    known = np.isfinite(amounts).any(axis=2).all(axis=0)  # a subject measured without its gyral graph has none
    _refuse_few(space, hemi, int(known.sum()))
    sphere, cortex = space.sphere(hemi), space.cortex(hemi)
    points = points_on_sphere(sphere, sphere)
    return Landmarks(
        np.where(cortex, np.nan_to_num(amounts[:, known]), 0.0),
        far[:, known] <= radius,
        points,
        vertex_areas(points, sphere.faces),
        np.where(cortex, areas_of(space, hemi, there[known]), 0.0),
    )


def _refuse_few(space: Space, hemi: str, count: int) -> None:
    if count < 2:
        other = "rh" if hemi == "lh" else "lh"
        advice = f" Pass --hemi {other}." if space.hemis[other].sum() > 1 else ""
        raise DoesNotApply(
            f"{space.folder}: {count} subjects have hinges and crests of {hemi}; two are needed.{advice}"
        )


@one_blas_thread()
def _side(space: Space, hemi: str, marks: Landmarks, fwhm: float, spins: int, seed: int, progress: Progress) -> _Side:
    inside, names = _regions(space, hemi)
    K, subjects, N = marks.amounts.shape
    sums = []
    counts: Array = np.empty((1 + spins, K, N), dtype=np.float32)
    turned = common_by_chance(marks, spins, seed, part_of(progress, 0.0, 0.7, ""))
    start = 0
    for found in chain([common(marks)[None]], turned):
        sums.append(found @ inside)
        counts[start : start + len(found)] = found[:, :, 0]
        start += len(found)
    densities = _densities(space, hemi, counts, marks.areas * subjects, fwhm, part_of(progress, 0.7, 0.3, ""))
    spread = densities.std(axis=0)
    away = np.abs(densities - densities.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    largest = np.nanmax(away[1:], axis=2)
    chance = densities[1:].mean(axis=0)
    areas = marks.areas @ inside
    return _Side(subjects, names, np.concatenate(sums), areas, densities[0], chance, away[0], largest)


def _regions(space: Space, hemi: str) -> tuple[Array, tuple[str, ...]]:
    """Which vertices are in each region, and in the last column all (N, R + 1); the names of the regions."""
    regions, cortex = space.regions(hemi), space.cortex(hemi)
    columns, names = [], []
    for k, name in enumerate(() if regions is None else regions.names):
        if regions is not None and not is_no_cortex(name):
            columns.append(cortex & (regions.labels == k))
            names.append(name)
    return np.column_stack([*columns, np.ones(len(cortex))]).astype(np.float64), tuple(names)


def _densities(space: Space, hemi: str, counts: Array, areas: Array, fwhm: float, progress: Progress) -> Array:
    """Smoothed counts over smoothed areas (1 + T, K, N), for each cm^2; NaN outside the cortex."""
    white, cortex = space.surface(hemi), space.cortex(hemi)
    around = vertex_areas(white.verts, white.faces)[:, None]
    area = smooth(white.verts, white.faces, areas[:, None] / around, fwhm, cortex, fill=0.0)
    columns = counts.reshape(-1, len(cortex))
    for start in range(0, len(columns), MOST_COLUMNS):
        part = slice(start, start + MOST_COLUMNS)
        spread = smooth(white.verts, white.faces, columns[part].T / around, fwhm, cortex, fill=0.0)
        columns[part] = (MM2_PER_CM2 * spread / area).T
        progress(min(1.0, part.stop / len(columns)), "smoothing")
    return columns.reshape(counts.shape)


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
            row["p_corrected"] = float(share_above(score[:1], largest)[0])
    return rows


def _rows_of_side(kind: str, k: int, hemi: str, side: _Side) -> Iterator[tuple[dict[str, Any], Array | None]]:
    """Each row with how far its share, and each rotated one (1 + T,), are above the mean [standard deviations]."""
    amounts, shared, compared = np.moveaxis(side.by_region[:, k], 1, 0)  # (1 + T, R + 1)
    shares = np.divide(shared, compared, out=np.full(shared.shape, np.nan), where=compared > 0)
    for r, (region, area) in enumerate(zip((*side.names, WHOLE), side.areas)):
        amount, share = float(amounts[0, r]) / side.subjects, shares[:, r]
        row: dict[str, Any] = {"hemi": hemi, "kind": kind, "region": region, "subjects": side.subjects}
        row |= {"amount": amount, "density": MM2_PER_CM2 * amount / area if area > 0 else None}
        chance = share[1:][np.isfinite(share[1:])]
        if not (np.isfinite(share[0]) and len(chance)):
            yield row, None
            continue
        low, high = np.percentile(chance, (2.5, 97.5))
        row |= {"share": float(share[0]), "chance": float(chance.mean()), "chance_low": low, "chance_high": high}
        row["p"] = float(share_above(share[:1], chance)[0])
        mean, spread = float(np.nanmean(share)), float(np.nanstd(share))
        yield row, (np.nan_to_num(share, nan=mean) - mean) / spread if spread > 0 else None
