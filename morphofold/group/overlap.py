"""Where the hinges and crests of a study's subjects are, and how many they have in common, against chance: that of
subjects whose hinges and crests are turned at random on the template's sphere."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from morphofold import __version__
from morphofold.analysis.smoothing import smooth
from morphofold.digests_and_json import Row
from morphofold.errors import DoesNotApply
from morphofold.frozen_arrays import Array, Bools
from morphofold.geometry import position, vertex_areas
from morphofold.group.permuted_model import share_above
from morphofold.group.spaces import HEMIS, MM2_PER_CM2, Space, write_results
from morphofold.io.files import StrPath
from morphofold.kernels import kernel, reading
from morphofold.mesh_quality.cortex_checks import is_no_cortex
from morphofold.progress_callbacks import Progress, logged, part_of
from morphofold.spheres.spins import NearestTable, cell_of, rotations, turned
from morphofold.threads import in_blocks, one_blas_thread
from morphofold.unfolding.unfold import points_on_sphere
from morphofold.validators import positive

KIND_MAPS = {"hinges": ("hinges", "hinge_distance"), "crests": ("crest_length", "crest_distance")}  # amount, distance
WHOLE = "hemisphere"
DENSITY_MAPS = {"hinges": "hinge_density", "crests": "crest_density"}
DENSITY_FWHM_MM = 10.0
ROTATIONS_AT_ONCE = 20
COLUMNS = (
    *("hemi", "kind", "region", "subjects", "amount", "density"),
    *("share", "chance", "chance_low", "chance_high", "p", "p_corrected"),
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
    density, chance_density : mapping of hemisphere to (N,) float
        Hinges [1/cm^2] or length of crests [mm/cm^2] of a subject, smoothed, NaN outside the cortex; and the mean of
        that under rotations.
    """

    kind: str
    radius: float
    rows: list[Row]
    density: Mapping[str, Array]
    chance_density: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Landmarks:
    """K kinds of landmarks, such as hinges and crests, of S subjects at the N vertices of a hemisphere of a template.

    Attributes
    ----------
    amounts : (K, S, N) float64
        Number of hinges, or length of crests [mm]; 0 outside the cortex.
    is_near : (K, S, N) bool
        Where a subject has one within the radius.
    points : (N, 3) float64
        The template's vertices on the unit sphere.
    on_sphere, areas : (N,) float64
        Area around each vertex on the unit sphere, and on the cortex [mm^2]; the second is 0 outside the cortex.
    """

    amounts: Array
    is_near: Bools
    points: Array
    on_sphere: Array
    areas: Array


@dataclass(frozen=True, eq=False)
class _Side:
    """One hemisphere: what is common by region (1 + T, K, 3, R), as it is and then rotated, areas of regions [mm^2],
    and smoothed densities (2, K, N), as they are and the mean under rotations. The last region is the whole."""

    subjects: int
    regions: tuple[str, ...]
    region_sums: Array
    areas: Array
    densities: Array


def overlap(
    space: Space,
    *,
    radius: float | None = None,
    fwhm: float = DENSITY_FWHM_MM,
    hemis: Sequence[str] = HEMIS,
    spins: int = 1000,
    seed: int = 0,
    progress: Progress = logged,
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
    if radius is None:
        if space.record.graph_width_mm is None:
            raise DoesNotApply(f"{space.folder}: no crown width is known. Pass a radius in mm.")
        radius = 0.5 * space.record.graph_width_mm
    positive(radius, "the radius")
    positive(fwhm, "the smoothing")
    positive(spins, "the number of rotations", "number")
    landmarks = {hemi: _landmarks(space, hemi, radius) for hemi in hemis}  # refuses before the rotations
    sides = {}
    for number, hemi in enumerate(hemis):
        side_progress = part_of(progress, number / len(hemis), 1 / len(hemis), f"{hemi}: ")
        sides[hemi] = _side(space, hemi, landmarks.pop(hemi), fwhm, spins, seed + number, side_progress)
    overlaps = []
    for number, kind in enumerate(KIND_MAPS):
        density, chance = ({hemi: side.densities[layer, number] for hemi, side in sides.items()} for layer in (0, 1))
        overlaps.append(Overlap(kind, radius, _rows(kind, number, sides), density, chance))
    return overlaps


def _landmarks(space: Space, hemi: str, radius: float) -> Landmarks:
    rows = np.flatnonzero(space.has_maps[hemi])
    if len(rows) > 1:
        amounts, distances = (
            np.stack([np.asarray(space.map(hemi, names[part]), dtype=np.float64)[rows] for names in KIND_MAPS.values()])
            for part in (0, 1)
        )
        has_graph = np.isfinite(amounts).any(axis=2).all(axis=0)  # a subject measured without its gyral graph has none
        rows, amounts, distances = rows[has_graph], amounts[:, has_graph], distances[:, has_graph]
    if len(rows) < 2:
        raise DoesNotApply(
            f"{space.folder}: {len(rows)} subjects have hinges and crests of {hemi}; two are needed. --hemi leaves it "
            "out."
        )
    sphere, is_cortex = space.sphere(hemi), space.cortex(hemi)
    sphere_points = points_on_sphere(sphere, sphere)
    return Landmarks(
        np.where(is_cortex, np.nan_to_num(amounts), 0.0),
        distances <= radius,
        sphere_points,
        vertex_areas(sphere_points, sphere.faces),
        np.where(is_cortex, space.areas(hemi, rows), 0.0),
    )


@one_blas_thread()
def _side(space: Space, hemi: str, marks: Landmarks, fwhm: float, n_spins: int, seed: int, progress: Progress) -> _Side:
    regions, is_cortex, white = space.regions(hemi), space.cortex(hemi), space.surface(hemi)
    region_of, names = (is_cortex, ()) if regions is None else (regions.labels, regions.names)
    labels = [label for label, name in enumerate(names) if not is_no_cortex(name)]
    inside = np.column_stack([*(is_cortex & (region_of == label) for label in labels), np.ones(len(is_cortex))])
    actual_sums, mean_amounts = common(marks), np.zeros(marks.amounts.shape[::2])
    sums = [actual_sums[None] @ inside]
    for chance_sums in common_by_chance(marks, n_spins, seed, progress):
        sums.append(chance_sums @ inside)
        mean_amounts += chance_sums[:, :, 0].sum(axis=0) / n_spins
    n_subjects = marks.amounts.shape[1]
    amounts = np.vstack([actual_sums[:, 0], mean_amounts, n_subjects * marks.areas])
    vertex_area = vertex_areas(white.verts, white.faces)[:, None]
    smoothed = smooth(white.verts, white.faces, amounts.T / vertex_area, fwhm, is_cortex, fill=0.0).T
    densities = (MM2_PER_CM2 * smoothed[:-1] / smoothed[-1]).reshape(2, len(KIND_MAPS), -1)
    return _Side(
        n_subjects, (*(names[label] for label in labels), WHOLE), np.concatenate(sums), marks.areas @ inside, densities
    )


def _rows(kind: str, kind_number: int, sides: Mapping[str, _Side]) -> list[Row]:
    rows, scored_rows = [], []  # how far shares, and rotated ones (1 + T,), are above their mean [standard deviations]
    for hemi, side in sides.items():
        amounts, shared_sums, compared_sums = np.moveaxis(side.region_sums[:, kind_number], 0, 2)  # (R, 1 + T)
        shares = np.divide(shared_sums, compared_sums, out=np.full(shared_sums.shape, np.nan), where=compared_sums > 0)
        for region, area, (amount, *_), region_shares in zip(side.regions, side.areas, amounts / side.subjects, shares):
            row = {"hemi": hemi, "kind": kind, "region": region, "subjects": side.subjects, "amount": amount}
            row["density"] = MM2_PER_CM2 * amount / area if area > 0 else None
            rows.append(row)
            chance_shares = region_shares[1:][np.isfinite(region_shares[1:])]
            if not (np.isfinite(region_shares[0]) and len(chance_shares)):
                continue
            lower_share, upper_share = np.percentile(chance_shares, (2.5, 97.5))
            row |= {
                "share": region_shares[0],
                "chance": chance_shares.mean(),
                "chance_low": lower_share,
                "chance_high": upper_share,
                "p": share_above(region_shares[:1], chance_shares)[0],
            }
            share_mean, share_sd = np.nanmean(region_shares), np.nanstd(region_shares)
            if share_sd > 0:
                scored_rows.append((row, (np.nan_to_num(region_shares, nan=share_mean) - share_mean) / share_sd))
    largest_scores = np.max([z_scores[1:] for _, z_scores in scored_rows], axis=0, initial=-np.inf)
    for row, z_scores in scored_rows:
        row["p_corrected"] = share_above(z_scores[:1], largest_scores)[0]
    return rows


def write_overlap(
    space: Space, overlaps: Sequence[Overlap], summary: Row, out: StrPath, report: Callable[..., object] | None = None
) -> Path:
    """Write what hinges and crests of a study have in common, completely or not at all.

    ``overlap.tsv`` has the rows of each :class:`Overlap`; ``maps/?h.hinge_density.shape.gii`` [1/cm^2] and
    ``?h.crest_density`` [mm/cm^2] the densities, and ``..._chance`` what is expected by chance; each also in
    FreeSurfer's format. ``report`` draws the page, of the space, what was found, its summary and the folder.
    """
    maps: dict[str, Mapping[str, Array]] = {}
    for kind_overlap in overlaps:
        map_name = DENSITY_MAPS[kind_overlap.kind]
        maps |= {map_name: kind_overlap.density, f"{map_name}_chance": kind_overlap.chance_density}
    table = ("overlap.tsv", COLUMNS, [row for kind_overlap in overlaps for row in kind_overlap.rows])
    return write_results(out, space, maps, table, summary, report and partial(report, space, overlaps, summary))


def overlap_summary(space: Space, overlaps: Sequence[Overlap], *, fwhm: float, spins: int, seed: int) -> Row:
    """What was compared and found, as JSON; numbers of whole hemispheres only."""
    return {
        "morphofold": __version__,
        "space": space.folder.parent.name,
        "radius_mm": overlaps[0].radius,
        "density_fwhm_mm": fwhm,
        "rotations": spins,
        "seed": seed,
        "hemispheres": [row for result in overlaps for row in result.rows if row["region"] == WHOLE],
    }


def common(marks: Landmarks) -> Array:
    """What the subjects have and share as they are: (K, 3, N).

    The first is the sum of all subjects' amounts at each vertex. The second is the part of it that another subject has
    within the radius, the mean over the other subjects. The third is the part of the first with which the second is
    compared: all of it, unless no other subject has cortex there.
    """
    n_subjects = marks.amounts.shape[1]
    n_others_near = marks.is_near.sum(axis=1, keepdims=True) - marks.is_near
    amount_sums, shared_sums = marks.amounts.sum(axis=1), (marks.amounts * n_others_near / (n_subjects - 1)).sum(axis=1)
    return np.stack([amount_sums, shared_sums, amount_sums], axis=1)


def common_by_chance(marks: Landmarks, n_spins: int, seed: int, progress: Progress = logged) -> Iterator[Array]:
    """The same under random rotations, a few at a time: (T, K, 3, N); each subject is turned by a rotation of its own.

    Notes
    -----
    A vertex gets what lies under it after the rotation, for each area of the sphere, times its area on the cortex; then
    a subject's amounts are divided by their sum and multiplied by what it has. So by chance amounts are spread over
    the cortex in proportion to its area. They are compared with the subjects whose cortex comes to lie there, not with
    those whose medial wall does. So neither the wall nor the distortion of the sphere changes the share.
    """
    nearest_table, (K, n_subjects, N) = NearestTable(marks.points), marks.amounts.shape
    density = np.divide(marks.amounts, marks.on_sphere, out=np.zeros((K, n_subjects, N)), where=marks.on_sphere > 0)
    totals = marks.amounts.sum(axis=2)
    all_rotations = rotations(n_spins * n_subjects, seed).reshape(n_spins, n_subjects, 3, 3)
    for first in range(0, n_spins, ROTATIONS_AT_ONCE):
        batch = all_rotations[first : first + ROTATIONS_AT_ONCE]
        common_sums = np.zeros((len(batch), K, 3, N))
        kernel_arrays = reading(marks.points, *nearest_table.arrays, density, marks.is_near, marks.areas, totals, batch)
        in_blocks(_common_after, len(batch), *kernel_arrays, common_sums)
        progress((first + len(batch)) / n_spins, f"{first + len(batch)} of {n_spins} rotations")
        yield common_sums


@kernel
def _common_after(start, stop, points, cell_vertex, n_cells, density, is_near, cortex_areas, totals, rotation_of, sums):
    """Write what is common (T, K, 3, N) after rotations (T, S, 3, 3)."""
    K, n_subjects, N = density.shape
    vertex_under = np.empty((n_subjects, N), np.int64)
    for spin in range(start, stop):
        n_compared, n_near = np.zeros(N), np.zeros((K, N))  # subjects with cortex there, and of these with one near
        for subject in range(n_subjects):
            for node in range(N):
                source = cell_vertex[cell_of(turned(rotation_of[spin, subject], position(points, node)), n_cells)]
                vertex_under[subject, node] = source
                if cortex_areas[source] > 0.0:
                    n_compared[node] += 1.0
                    for kind in range(K):
                        n_near[kind, node] += is_near[kind, subject, source]
        for kind in range(K):
            for subject in range(n_subjects):
                amounts = density[kind, subject][vertex_under[subject]] * cortex_areas
                scale = totals[kind, subject] / amounts.sum()
                for node in np.flatnonzero(amounts):
                    amount = amounts[node] * scale
                    sums[spin, kind, 0, node] += amount
                    if n_compared[node] > 1.0:
                        own_near = is_near[kind, subject, vertex_under[subject, node]]
                        sums[spin, kind, 1, node] += amount * (n_near[kind, node] - own_near) / (n_compared[node] - 1.0)
                        sums[spin, kind, 2, node] += amount
