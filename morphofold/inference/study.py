"""The maps of a study on a template, tested by a model: read, tested over both hemispheres together, and written."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from morphofold import __version__
from morphofold.arrays import Array, Ints
from morphofold.errors import MissingPart, UnknownName
from morphofold.geometry import vertex_areas
from morphofold.inference.clusters import Mesh
from morphofold.inference.design import Design, design, read_participants
from morphofold.inference.permutations import Inference, infer
from morphofold.io import atomic_folder, read_annotation, read_label, read_surface, write_gifti_map, write_morph
from morphofold.progress import Progress, silent
from morphofold.provenance import input_records, strict_json
from morphofold.surface import Surface
from morphofold.tables import read_table, write_table

HEMIS = ("lh", "rh")
#: draws the page of a result with its summary into a folder
DrawStats = Callable[["Result", Mapping[str, Any], Path], object]
CLUSTER_COLUMNS = ("hemi", "cluster", "peak", "x", "y", "z", "region", "area_mm2", "effect", "t", "p")
MAPS = ("effect", "t", "p", "p_height", "p_tfce", "cluster", "subjects")


@dataclass(frozen=True, eq=False)
class Space:
    """Maps of a study on a template.

    Attributes
    ----------
    folder : Path
        That ``cohort --space`` wrote: ``spaces/TEMPLATE/group``.
    subjects : tuple of str
        In the order of the rows.
    hemis : mapping of hemisphere to (S,) bool
        Which subjects have maps of it.
    """

    folder: Path
    subjects: tuple[str, ...]
    hemis: Mapping[str, Any]

    def __repr__(self) -> str:
        return f"Space({str(self.folder)!r}, {len(self.subjects)} subjects, {' and '.join(self.hemis)})"

    def surface(self, hemi: str, kind: str = "white") -> Surface:
        """A surface of the template."""
        return read_surface(self.folder / "surf" / f"{hemi}.{kind}")

    def map(self, hemi: str, name: str) -> Array:
        """A map (S, N) of all subjects; raises if there is none."""
        file = self.folder / f"{hemi}.{name}.npy"
        if not file.is_file():
            there = sorted({path.name.split(".")[1] for path in self.folder.glob("?h.*.npy")})
            raise UnknownName(f"{name!r}: no such map in {self.folder}; they are {', '.join(there)}.")
        return np.load(file, mmap_mode="r")


def find_space(study: str | Path, name: str | None = None) -> Space:
    """The space of a study: the one of that name, or the only one.

    Raises
    ------
    FileNotFoundError
        If there is none.
    ValueError
        If there are several and none is named, or it is damaged.
    """
    spaces = Path(study) / "spaces"
    there = sorted(path.parent.parent.name for path in spaces.glob("*/group/space.json"))
    if not there or (name is not None and name not in there):
        what = "no maps on a template" if name is None else f"no maps on {name}; there are {', '.join(there) or 'none'}"
        raise FileNotFoundError(
            f"{study}: has {what}. Run: morphofold cohort SUBJECTS_DIR -o {study} --space fsaverage5"
        )
    if name is None and len(there) > 1:
        raise UnknownName(f"{study}: has maps in several spaces: {', '.join(there)}. Name one with --space.")
    folder = spaces / (name or there[0]) / "group"
    rows = read_table(folder / "participants.tsv", words=("participant_id",), numbers=HEMIS)
    hemis = {hemi: np.array([row[hemi] == 1 for row in rows]) for hemi in HEMIS}
    return Space(folder, tuple(row["participant_id"] for row in rows), hemis)


@dataclass(frozen=True, eq=False)
class Result:
    """A model tested on a map.

    Attributes
    ----------
    space : Space
    map : str
    formula, contrast : str
    hemis : tuple of str
    design : Design
    inference : Inference
        Over the vertices of all hemispheres, one after the other.
    mesh : Mesh
    counts : (N,) int64
        Subjects with a value at each vertex.
    without_maps : tuple of str
        Subjects left out because a hemisphere has no maps.
    seed, permutations : int
    """

    space: Space
    map: str
    formula: str
    contrast: str
    hemis: tuple[str, ...]
    design: Design
    inference: Inference
    mesh: Mesh
    counts: Ints
    without_maps: tuple[str, ...]
    seed: int
    permutations: int

    def __repr__(self) -> str:
        subjects = len(self.design.subjects)
        return f"Result of {self.map} ~ {self.formula}, {self.contrast}: {subjects} subjects, {self.inference!r}"


def fit_study(
    space: Space,
    participants: str | Path,
    model: str,
    contrast: str,
    *,
    blocks: str | None = None,
    hemis: Sequence[str] = HEMIS,
    permutations: int = 1000,
    seed: int = 0,
    progress: Progress = silent,
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
        As for :func:`morphofold.inference.design.design`.
    blocks : str, optional
        Column of the participants within whose values subjects are exchanged.
    hemis : sequence of {"lh", "rh"}
    permutations, seed : int
    progress : callable

    Raises
    ------
    ValueError, OSError
        If the model has no left side, a map or column does not exist, or the design can't be tested.
    """
    name, tilde, formula = (part.strip() for part in model.partition("~"))
    if not (tilde and name and formula):
        raise UnknownName(f"{model!r}: name a map and regressors, such as 'gyral_thickness ~ age + sex'.")
    maps = {hemi: space.map(hemi, name) for hemi in hemis}
    has_all = np.all([space.hemis[hemi] for hemi in hemis], axis=0)
    present = [subject for subject, there in zip(space.subjects, has_all) if there]
    if not present:
        raise MissingPart(f"{space.folder}: no subject has maps of {' and '.join(hemis)}.")
    chosen = design(present, read_participants(participants), formula, contrast, blocks)
    row = {subject: k for k, subject in enumerate(space.subjects)}
    rows = np.array([row[subject] for subject in chosen.subjects])
    values = np.concatenate([np.asarray(maps[hemi])[rows] for hemi in hemis], axis=1)
    mesh = _mesh(space, hemis, rows)
    cortex = np.concatenate([_cortex(space, hemi) for hemi in hemis])
    values = np.where(cortex, values, np.nan)
    found = infer(
        values,
        chosen.matrix,
        chosen.contrast,
        mesh,
        permutations=permutations,
        seed=seed,
        flip=chosen.flip,
        blocks=chosen.blocks,
        progress=progress,
    )
    left = tuple(subject for subject, there in zip(space.subjects, has_all) if not there)
    counts = np.isfinite(values).sum(axis=0)
    return Result(space, name, formula, contrast, tuple(hemis), chosen, found, mesh, counts, left, seed, permutations)


def _mesh(space: Space, hemis: Sequence[str], rows: Ints) -> Mesh:
    """The hemispheres as one mesh, with the mean area that subjects have at each vertex; else the template's."""
    faces, areas, n = [], [], 0
    for hemi in hemis:
        white = space.surface(hemi)
        try:
            area = np.nanmean(np.asarray(space.map(hemi, "area"))[rows], axis=0)
        except UnknownName:
            area = vertex_areas(white.verts, white.faces)
        faces.append(white.faces + n)
        areas.append(np.nan_to_num(area))
        n += len(white.verts)
    return Mesh(np.concatenate(faces), np.concatenate(areas))


def _cortex(space: Space, hemi: str) -> Any:
    """The template's cortex (N,) bool; everywhere if it has no label."""
    n, file = len(space.surface(hemi).verts), space.folder / "label" / f"{hemi}.cortex.label"
    return read_label(file, n) if file.is_file() else np.ones(n, dtype=bool)


def split(result: Result, values: Array) -> dict[str, Array]:
    """Values (N,) by hemisphere."""
    sizes = [len(result.space.surface(hemi).verts) for hemi in result.hemis]
    return dict(zip(result.hemis, np.split(values, np.cumsum(sizes)[:-1])))


def cluster_rows(result: Result) -> list[dict[str, Any]]:
    """A row for each cluster, the largest first: its peak [mm, on the template's white surface] and region there."""
    rows, first = [], 0
    for hemi in result.hemis:
        white = result.space.surface(hemi)
        file = result.space.folder / "label" / f"{hemi}.aparc.annot"
        regions = read_annotation(file) if file.is_file() else None
        for k, one in enumerate(result.inference.clusters):
            vertex = one["peak"] - first
            if not 0 <= vertex < len(white.verts):
                continue
            x, y, z = white.verts[vertex].tolist()
            label = -1 if regions is None else int(regions.labels[vertex])
            region = None if regions is None or label < 0 else regions.names[label]
            rows.append(
                {"hemi": hemi, "cluster": k + 1, **one, "peak": vertex, "x": x, "y": y, "z": z, "region": region}
            )
        first += len(white.verts)
    return sorted(rows, key=lambda row: row["cluster"])


def write_result(
    result: Result, out: str | Path, inputs: Sequence[str | Path] = (), report: DrawStats | None = None
) -> Path:
    """Write maps, the table of clusters, summary.json and a page, completely or not at all.

    ``maps/?h.NAME.shape.gii`` and the same in FreeSurfer's format: ``effect``, ``t``, ``p`` (of the vertex alone),
    ``p_height`` and ``p_tfce`` (corrected), ``cluster`` (number, 0: none), ``subjects`` (with a value). The page is
    drawn by ``report``: :func:`morphofold.report.pages.stats_page.stats_report`.
    """
    found = result.inference
    maps = {name: getattr(found, name) for name in MAPS[:5]}
    maps |= {"cluster": (found.cluster + 1).astype(np.float64), "subjects": result.counts.astype(np.float64)}
    with atomic_folder(out) as folder:
        (folder / "maps").mkdir()
        for name, values in maps.items():
            for hemi, part in split(result, values).items():
                write_gifti_map(folder / "maps" / f"{hemi}.{name}.shape.gii", part, nan=np.nan, hemi=hemi)
                write_morph(folder / "maps" / f"{hemi}.{name}", part, nan=1.0 if name.startswith("p") else 0.0)
        write_table(folder / "clusters.tsv", CLUSTER_COLUMNS, cluster_rows(result))
        said = summary(result, inputs)
        (folder / "summary.json").write_text(strict_json(said), encoding="utf-8")
        if report is not None:
            report(result, said, folder)
    return Path(out)


def summary(result: Result, inputs: Sequence[str | Path] = ()) -> dict[str, Any]:
    """What was tested and found, as JSON."""
    found, chosen = result.inference, result.design
    tested = np.isfinite(found.t)
    return {
        "morphofold": __version__,
        "inputs": input_records(inputs),
        "space": result.space.folder.parent.name,
        "map": result.map,
        "model": result.formula,
        "contrast": result.contrast,
        "columns": list(chosen.columns),
        "weights": chosen.contrast.tolist(),
        "subjects": list(chosen.subjects),
        "left_out": {"value missing": list(chosen.left_out), "no maps": list(result.without_maps)},
        "hemispheres": list(result.hemis),
        "df": found.df,
        "permutations": result.permutations,
        "seed": result.seed,
        "exchanged": "signs" if chosen.flip else "subjects",
        "blocks": None if chosen.blocks is None else int(chosen.blocks.max()) + 1,
        "cluster_forming_t": found.threshold,
        "vertices": {"all": len(tested), "tested": int(tested.sum())},
        "smallest_p": {name: float(np.nanmin(getattr(found, name))) for name in ("p", "p_height", "p_tfce")},
        "significant_area_mm2": {
            name: float(result.mesh.areas[getattr(found, name) <= 0.05].sum()) for name in ("p_height", "p_tfce")
        },
        "clusters": len(found.clusters),
    }
