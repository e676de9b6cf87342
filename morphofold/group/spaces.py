"""Maps of a study on a template, as ``cohort --space`` wrote them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

from morphofold.arrays import Array, Ints
from morphofold.errors import DamagedFile, MissingPart, UnknownName
from morphofold.geometry import vertex_areas
from morphofold.group.clusters import Mesh
from morphofold.io import read_annotation, read_label, read_surface
from morphofold.io.json_files import Amount, Record, read_json
from morphofold.spheres.templates import template_sphere, template_surface
from morphofold.surface import Regions, Surface
from morphofold.tables import read_table

HEMIS = ("lh", "rh")
PARTICIPANTS = "participants.tsv"
AGAIN = "Run cohort --space again."


class SpaceRecord(Record):
    """``space.json``: whether both hemispheres are on the template's left one, whether vertex i of one belongs to
    vertex i of the other, and the median crown width of the subjects [mm]."""

    model_config = ConfigDict(frozen=True)

    one_side: bool = False
    symmetric: bool = False
    graph_width_mm: Amount | None = None
    smoothing_fwhm_mm: Amount | None = None


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
    about : SpaceRecord
    covariates : tuple of str
        Columns of the participants that ``cohort`` knew, such as age.
    """

    folder: Path
    subjects: tuple[str, ...]
    hemis: Mapping[str, NDArray[np.bool_]]
    about: SpaceRecord
    covariates: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Space({str(self.folder)!r}, {len(self.subjects)} subjects, {' and '.join(self.hemis)})"

    def side(self, hemi: str) -> str:
        """The template's hemisphere that the maps of one are on."""
        return "lh" if self.about.one_side else hemi

    def surface(self, hemi: str, kind: str = "white") -> Surface:
        """A surface of the template."""
        return read_surface(template_surface(self.folder, self.side(hemi), kind))

    def sphere(self, hemi: str) -> Surface:
        """The template's registered sphere."""
        return read_surface(template_sphere(self.folder, self.side(hemi)))

    def cortex(self, hemi: str) -> NDArray[np.bool_]:
        """The template's cortex (N,); everywhere if it has no label."""
        n, file = len(self.surface(hemi).verts), self.folder / "label" / f"{self.side(hemi)}.cortex.label"
        return read_label(file, n) if file.is_file() else np.ones(n, dtype=bool)

    def regions(self, hemi: str) -> Regions | None:
        """The template's parcellation, if it has one."""
        file = self.folder / "label" / f"{self.side(hemi)}.aparc.annot"
        return read_annotation(file) if file.is_file() else None

    def map(self, hemi: str, name: str) -> Array:
        """A map (S, N) of all subjects; raises if there is none."""
        file = self.folder / f"{hemi}.{name}.npy"
        there = {path.name.partition(".")[2].removesuffix(".npy") for path in self.folder.glob("?h.*.npy")}
        if name not in there:
            raise UnknownName(f"{name!r}: no such map in {self.folder}; they are {', '.join(sorted(there))}.")
        if not file.is_file():
            raise MissingPart(f"{file}: is missing, though the other side has this map. {AGAIN}")
        shape = len(self.subjects), len(self.surface(hemi).verts)
        try:
            values = np.load(file, mmap_mode="r")
        except (ValueError, EOFError):  # numpy advises to allow pickles
            values = None
        if getattr(values, "shape", None) != shape or values.dtype.kind not in "fiu":
            raise DamagedFile(
                f"{file}: is no array of numbers of shape {shape}, the rows of {self.folder / PARTICIPANTS} and the "
                f"vertices of the template. {AGAIN}"
            )
        return values


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
    rows = read_table(folder / PARTICIPANTS, words=("participant_id",), numbers=HEMIS)
    names = tuple(row.get("participant_id", "") for row in rows)
    if not rows or len({*names}) < len(rows) or not rows[0].keys() >= {*HEMIS}:
        raise DamagedFile(f"{folder / PARTICIPANTS}: lacks rows, a column or names, or has a name twice. {AGAIN}")
    hemis = {hemi: np.array([row[hemi] == 1 for row in rows]) for hemi in HEMIS}
    about = SpaceRecord(**read_json(folder / "space.json", SpaceRecord, AGAIN))
    covariates = tuple(name for name in rows[0] if name not in ("participant_id", *HEMIS))
    return Space(folder, names, hemis, about, covariates)


def mesh_of(space: Space, hemis: Sequence[str], rows: Ints) -> Mesh:
    """The hemispheres as one mesh, with the mean area that subjects have at each vertex; else the template's."""
    faces, areas, n = [], [], 0
    for hemi in hemis:
        white = space.surface(hemi)
        area = areas_of(space, hemi, rows)
        faces.append(white.faces + n)
        areas.append(area)
        n += len(white.verts)
    return Mesh(np.concatenate(faces), np.concatenate(areas))


def areas_of(space: Space, hemi: str, rows: Ints) -> Array:
    """Mean white area of some subjects at each vertex (N,) [mm^2]; the template's if the study has no map of it."""
    white = space.surface(hemi)
    try:
        found: Array = np.nan_to_num(np.nanmean(np.asarray(space.map(hemi, "area"), dtype=np.float64)[rows], axis=0))
    except UnknownName:
        return vertex_areas(white.verts, white.faces)
    return found
