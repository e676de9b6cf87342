"""The maps of a study on a template, tested by a model: read, tested over both hemispheres together, and written."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from morphofold import __version__
from morphofold.digests_and_json import Row, input_records
from morphofold.errors import DoesNotApply, MissingPart, UnknownName
from morphofold.frozen_arrays import Array, Ints
from morphofold.group.clusters import Mesh
from morphofold.group.design import Design, design, read_participants
from morphofold.group.permuted_model import Inference, infer
from morphofold.group.spaces import HEMIS, Space, write_results
from morphofold.io.files import StrPath
from morphofold.progress_callbacks import Progress, logged

CLUSTER_COLUMNS = ("hemi", "cluster", "peak", "x", "y", "z", "region", "area_mm2", "effect", "t", "r", "p")
FEWEST_EXCHANGES, LEAST_P_REMARKED = 1000, 0.01
FEWEST_OF_VARIANCE_GROUP = 5
#: p and ratio of residual variances from which a remark says that they depend on what is tested
VARIANCE_P, VARIANCE_RATIO = 0.01, 1.5
INFERENCE_MAPS = ("effect", "t", "r", "p", "p_height", "p_tfce")  # and cluster, subjects


@dataclass(frozen=True, eq=False)
class Result:
    """A model tested on a map.

    Attributes
    ----------
    space : Space
    map_name : str
    formula, contrast : str
    hemis : tuple of str
    design : Design
    inference : Inference
        Over the vertices of all hemispheres, one after the other.
    mesh : Mesh
    n_values : (N,) int64
        Subjects with a value at each vertex.
    without_maps : tuple of str
        Subjects left out because a hemisphere has no maps.
    seed, permutations : int
    asymmetry : str or None
        ``"difference"`` or ``"index"`` if the map is that of left and right.
    """

    space: Space
    map_name: str
    formula: str
    contrast: str
    hemis: tuple[str, ...]
    design: Design
    inference: Inference
    mesh: Mesh
    n_values: Ints
    without_maps: tuple[str, ...]
    seed: int
    permutations: int
    asymmetry: str | None = None

    @property
    def shown(self) -> str:
        """What was tested, in words."""
        return {"difference": "left − right of ", "index": "asymmetry of ", None: ""}[self.asymmetry] + self.map_name

    @property
    def remarks(self) -> list[str]:
        """Sentences about what may make the p values wrong."""
        inference, remarks = self.inference, list(self.design.remarks)
        n_unchanged = round(inference.least_p * (1 + self.permutations)) - 1
        has_few = inference.n_possible < max(self.permutations, FEWEST_EXCHANGES)
        if has_few or (n_unchanged > 2 and inference.least_p > LEAST_P_REMARKED):
            unchanged_text = f"{n_unchanged / self.permutations:.1%} of the exchanges leave what is tested as it is"
            reason = f"only {inference.n_possible} exchanges exist" if has_few else unchanged_text
            remarks.append(f"{reason}: no corrected p can be below {inference.least_p:.2g}.")
        if not inference.by_signs and inference.variance_p < VARIANCE_P and inference.variance_ratio > VARIANCE_RATIO:
            remarks.append(
                f"the residual variance depends on {self.contrast} (up to {inference.variance_ratio:.2g} times as "
                f"large, p {inference.variance_p:.1g}), so corrected p may be far too small or too large. Name a "
                "column of groups with like variance: --variance-groups COLUMN."
            )
        if (variance_groups := self.design.variance_groups) is not None:
            exchange_units = np.arange(len(variance_groups)) if self.design.blocks is None else self.design.blocks
            fewest_units = min(len(np.unique(exchange_units[variance_groups == g])) for g in np.unique(variance_groups))
            if fewest_units < FEWEST_OF_VARIANCE_GROUP:
                remarks.append(
                    f"a variance group has only {fewest_units} subjects or blocks, so corrected p may be far too "
                    f"small. Merge it with another group to have {FEWEST_OF_VARIANCE_GROUP} or more."
                )
        return remarks

    def __repr__(self) -> str:
        subjects = len(self.design.subjects)
        return f"Result of {self.shown} ~ {self.formula}, {self.contrast}: {subjects} subjects, {self.inference!r}"


def fit_study(
    space: Space,
    participants: StrPath,
    model: str,
    contrast: str,
    *,
    blocks: str | None = None,
    whole: bool = False,
    variance_groups: str | None = None,
    hemis: Sequence[str] = HEMIS,
    asymmetry: str | None = None,
    permutations: int = 1000,
    seed: int = 0,
    progress: Progress = logged,
) -> Result:
    """Test ``MAP ~ REGRESSORS`` at every vertex; p values hold for all hemispheres together.

    Parameters
    ----------
    space : Space
    participants : str or path
        ``participants.tsv``.
    model : str
        Such as ``"gyral_thickness ~ age + sex"``.
    contrast : str
        As for :func:`morphofold.group.design.design`.
    blocks : str, optional
        Column of the participants within whose values subjects are exchanged.
    whole : bool
        Exchange blocks as wholes instead, each with one of its size: for regressors that are the same within a block.
        Without ``blocks``, sessions of a person are a block, as a whole if what is tested is the same within persons.
    variance_groups : str, optional
        Column of the participants whose values mark groups that differ in residual variance.
    hemis : sequence of {"lh", "rh"}
    asymmetry : {"difference", "index"}, optional
        Test left - right, or 2 (left - right) / (left + right), instead of ``hemis``; on a symmetric template.
    permutations, seed : int
    progress : callable

    Raises
    ------
    ValueError, OSError
        If the model has no left side, a map or column does not exist, or the design can't be tested.
    """
    name, _, formula = (part.strip() for part in model.partition("~"))
    if not (name and formula):
        raise UnknownName(f"{model!r}: name a map and regressors, such as 'gyral_thickness ~ age + sex'.")
    if asymmetry not in (None, "difference", "index"):
        raise UnknownName(f"asymmetry must be 'difference' or 'index', got {asymmetry!r}.")
    if asymmetry and not space.record.symmetric:
        raise DoesNotApply(
            f"{space.folder}: left and right vertices of its template do not belong together. Bring maps over to "
            "a template whose two spheres are mirrored."
        )
    needed_hemis, sides = (HEMIS, ("lh",)) if asymmetry else (tuple(hemis), tuple(hemis))
    maps = {hemi: space.map(hemi, name) for hemi in needed_hemis}
    has_maps = np.all([space.has_maps[hemi] for hemi in needed_hemis], axis=0)
    mapped, unmapped = (tuple(np.array(space.subjects)[is_wanted].tolist()) for is_wanted in (has_maps, ~has_maps))
    if not mapped:
        raise MissingPart(
            f"{space.folder}: of {len(space.subjects)} subjects in participants.tsv none has maps of "
            f"{' and '.join(needed_hemis)}."
        )
    chosen = design(mapped, read_participants(participants), formula, contrast, blocks, variance_groups)
    subject_rows = np.array([space.subjects.index(subject) for subject in chosen.subjects])
    side_maps = [np.where(space.cortex(hemi), maps[hemi][subject_rows], np.nan) for hemi in needed_hemis]
    areas = [space.areas(hemi, subject_rows) for hemi in needed_hemis]
    if asymmetry:  # areas of both sides count alike
        side_maps, areas = [_asymmetry(asymmetry, *side_maps)], [np.mean(areas, axis=0)]
    vertex_values = np.concatenate(side_maps, axis=1)
    faces = [space.surface(hemi).faces + offset for hemi, offset in zip(sides, np.cumsum([0, *map(len, areas)]))]
    mesh, chosen = Mesh(np.concatenate(faces), np.concatenate(areas)), replace(chosen, whole=whole or chosen.whole)
    inference = infer(
        vertex_values,
        chosen.matrix,
        chosen.contrast,
        mesh,
        permutations=permutations,
        seed=seed,
        blocks=chosen.blocks,
        whole=chosen.whole,
        groups=chosen.variance_groups,
        progress=progress,
    )
    counts = np.isfinite(vertex_values).sum(axis=0)
    return Result(
        space, name, formula, contrast, sides, chosen, inference, mesh, counts, unmapped, seed, permutations, asymmetry
    )


def _asymmetry(kind: str, left: Array, right: Array) -> Array:
    """left - right (S, N), or that over their mean; NaN where their mean is not positive."""
    if kind == "difference":
        return left - right
    mean_of_sides = 0.5 * (left.astype(np.float64) + right)
    return np.divide(left - right, mean_of_sides, out=np.full(mean_of_sides.shape, np.nan), where=mean_of_sides > 0)


def split(result: Result, values: Array) -> dict[str, Array]:
    """Values (N,) by hemisphere."""
    vertex_counts = [len(result.space.surface(hemi).verts) for hemi in result.hemis]
    return dict(zip(result.hemis, np.split(values, np.cumsum(vertex_counts)[:-1])))


def cluster_rows(result: Result) -> list[Row]:
    """A row for each cluster, the largest first: its peak [mm, on the template's white surface] and region there."""
    rows, inference = [], result.inference
    for hemi, hemi_vertices in split(result, np.arange(len(inference.t), dtype=float)).items():
        white, regions = result.space.surface(hemi), result.space.regions(hemi)
        for number, cluster in enumerate(inference.clusters):
            vertex = cluster["peak"] - int(hemi_vertices[0])
            if not 0 <= vertex < len(hemi_vertices):
                continue
            x, y, z = white.verts[vertex].tolist()
            region_label = -1 if regions is None else int(regions.labels[vertex])
            region_name = None if regions is None or region_label < 0 else regions.names[region_label]
            peak_row = {"peak": vertex, "x": x, "y": y, "z": z, "region": region_name}
            rows.append({"hemi": hemi, "cluster": number + 1, **cluster, "r": inference.r[cluster["peak"]], **peak_row})
    return sorted(rows, key=lambda row: row["cluster"])


def write_result(
    result: Result, out: StrPath, inputs: Sequence[str | Path] = (), report: Callable[..., object] | None = None
) -> Path:
    """Write maps, the table of clusters, summary.json and a page, completely or not at all.

    ``maps/?h.NAME.shape.gii`` and the same in FreeSurfer's format: ``effect``, ``t``, ``r``, ``p`` (of the vertex
    alone), ``p_height`` and ``p_tfce`` (corrected), ``cluster`` (number, 0: none), ``subjects`` (with a value). The
    page is drawn by ``report``, of the result, its summary and the folder:
    :func:`morphofold.group_pages.stats_pages.stats_report`.
    """
    inference, summary_row = result.inference, summary(result, inputs)
    maps = {map_name: getattr(inference, map_name) for map_name in INFERENCE_MAPS}
    maps |= {"cluster": (inference.cluster_of + 1).astype(np.float64), "subjects": result.n_values.astype(np.float64)}
    maps_by_side = {map_name: split(result, values) for map_name, values in maps.items()}
    table = ("clusters.tsv", CLUSTER_COLUMNS, cluster_rows(result))
    return write_results(
        out, result.space, maps_by_side, table, summary_row, report and partial(report, result, summary_row)
    )


def summary(result: Result, inputs: Sequence[str | Path] = ()) -> Row:
    """What was tested and found, as JSON."""
    inference, chosen = result.inference, result.design
    is_tested = np.isfinite(inference.t)
    n_blocks, n_groups = (None if of is None else int(of.max()) + 1 for of in (chosen.blocks, chosen.variance_groups))
    return {
        "morphofold": __version__,
        "inputs": input_records(inputs),
        "space": result.space.folder.parent.name,
        "map": result.map_name,
        "asymmetry": result.asymmetry,
        "model": result.formula,
        "contrast": result.contrast,
        "columns": list(chosen.columns),
        "weights": chosen.contrast.tolist(),
        "subjects": list(chosen.subjects),
        "left_out": {"value missing": list(chosen.left_out), "no maps": list(result.without_maps)},
        "hemispheres": list(result.hemis),
        "df": inference.df,
        "permutations": result.permutations,
        "seed": result.seed,
        "exchanged": "signs" if inference.by_signs else "blocks" if chosen.whole else "subjects",
        "blocks": n_blocks,
        "variance_groups": n_groups,
        "remarks": result.remarks,
        "cluster_forming_t": inference.threshold,
        "vertices": {"all": len(is_tested), "tested": int(is_tested.sum())},
        "smallest_p": {name: np.nanmin(getattr(inference, name)) for name in ("p", "p_height", "p_tfce")},
        "significant_area_mm2": {
            name: result.mesh.areas[getattr(inference, name) <= 0.05].sum() for name in ("p_height", "p_tfce")
        },
        "clusters": len(inference.clusters),
    }
