"""The two classes that all packages share: a triangle surface, and a cortex made of two surfaces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold import validators
from morphofold.errors import MissingPart, UnlikeSurfaces, WrongShape
from morphofold.frozen_arrays import Array, Bools, Ints, cannot_change, read_only
from morphofold.lazy import draw
from morphofold.optional_packages import import_optional

if TYPE_CHECKING:
    import pyvista
    import trimesh
    from nilearn.surface import SurfaceImage

Verts = Array  # (N, 3), mm
Faces = Ints  # (M, 3), 0-based, counter-clockwise seen from outside
PerVertex = Array  # (N,)
SURFACES = ("white", "pial", "inflated", "sphere")  # of a Cortex
ONE_SURFACE = "one surface"  # the origin of a Cortex whose white is its pial


def _without_unknown(verts: Verts, faces: Faces) -> tuple[Verts, Faces, int]:
    """Vertices that are NaN put into the middle, the triangles without these, and how many they are.

    All stay as they are if these triangles are too many, or the surface is closed: then a hole would open.
    """
    is_unknown = np.any(np.isnan(verts), axis=1)
    is_complete = ~np.any(is_unknown[faces], axis=1)
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    is_closed = (np.unique(edges, axis=0, return_counts=True)[1] > 1).all()
    if (is_closed and not is_complete.all()) or is_complete.mean() < 1 - validators.LARGEST_UNKNOWN_SHARE:
        return verts, faces, 0
    return np.where(is_unknown[:, None], np.nanmean(verts, axis=0), verts), faces[is_complete], int(is_unknown.sum())


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle surface, checked on construction and read-only.

    Checked as in ``check_mesh``, but faces may contain a vertex twice: files have such faces, and ``measure`` leaves
    them out.

    Parameters
    ----------
    verts : (N, 3) array
        Vertex positions [mm], stored as float64.
    faces : (M, 3) integer array
        Triangles, 0-based, counter-clockwise seen from outside; stored as int64.
    name : str
        Name in errors and tables, e.g. ``"lh.pial"``.
    geometry : mapping, optional
        FreeSurfer's volume-geometry footer as nibabel reads it (with ``cras``), kept for writing.
    unknown : int
        Number of vertices that were NaN. At most 1 % of the triangles of a surface with a border are left out for
        these; the vertices lie in the middle then, and no triangle uses them.

    Raises
    ------
    ValueError, TypeError
        If the arrays do not describe a triangle mesh; the message names the first wrong entry.

    Notes
    -----
    ``verts`` and ``faces`` are read-only. A few functions of other packages refuse read-only arrays (such as SciPy's
    ``Rotation.apply``); ``coordinates`` is a writable copy. With it and ``faces`` nilearn accepts a Surface as a mesh.
    """

    verts: Verts
    faces: Faces
    name: str = "surface"
    geometry: Mapping[str, Any] | None = None
    unknown: int = 0

    def __post_init__(self) -> None:
        verts, faces, unknown = _as_array(self.verts), _as_array(self.faces), self.unknown
        validators.check_indexed(verts, faces, self.name)
        if np.isnan(verts).any():
            verts, faces, unknown = _without_unknown(verts, faces)
        validators.check_positions(verts, self.name)
        verts, faces = _read_only(verts, np.float64), _read_only(faces, np.int64)
        vars(self).update(verts=verts, faces=faces, unknown=unknown)

    @property
    def coordinates(self) -> Verts:
        """A writable copy of the vertex positions (N, 3) [mm]."""
        return self.verts.copy()

    def to_trimesh(self, maps: Mapping[str, np.ndarray] | None = None) -> trimesh.Trimesh:
        """A copy as ``trimesh.Trimesh``: the same vertices and faces in the same order.

        ``maps``, by name, become its ``vertex_attributes`` (N, ...).
        """
        import trimesh

        attributes: Any = self._copies(maps)
        return trimesh.Trimesh(self.coordinates, self.faces.copy(), process=False, vertex_attributes=attributes)

    def to_pyvista(self, maps: Mapping[str, np.ndarray] | None = None) -> pyvista.PolyData:
        """A copy as ``pyvista.PolyData``: the same vertices and faces in the same order.

        ``maps``, by name, become its ``point_data`` (N, ...), as in ``surface.to_pyvista(measures.maps)``.
        """
        import pyvista

        mesh = pyvista.PolyData.from_regular_faces(self.coordinates, self.faces.astype(int))
        mesh.point_data.update(self._copies(maps))
        return mesh

    def _copies(self, maps: Mapping[str, np.ndarray] | None) -> dict[str, np.ndarray]:
        map_copies = {name: np.array(values) for name, values in (maps or {}).items()}
        for name, values in map_copies.items():
            if values.shape[:1] != (len(self.verts),):
                raise WrongShape(
                    f"{self.name}: map {name} has shape {values.shape}, the surface has {len(self.verts)} vertices."
                )
        return map_copies

    def __repr__(self) -> str:
        return f"Surface({self.name!r}, {len(self.verts):,} vertices, {len(self.faces):,} faces)"


def _read_only(values: np.ndarray, dtype: type) -> np.ndarray:
    """A read-only copy in C order; the array itself if it can not change, so that surfaces share their triangles."""
    if values.dtype == dtype and values.flags.c_contiguous and cannot_change(values):
        return values
    return np.asarray(read_only(np.array(values, dtype=dtype, order="C")))


def _as_array(values: Any) -> Any:
    """A list or tuple of numbers as an array; anything else as it is, for ``check_arrays`` to refuse."""
    if not isinstance(values, list | tuple):
        return values
    try:
        return np.asarray(values)
    except ValueError:  # rows of different lengths
        return values


@dataclass(frozen=True, eq=False)
class Regions:
    """Region labels of a cortex, as in a FreeSurfer annotation.

    ``labels`` is (N,) int64: an index into ``names`` and ``colours``, or -1 where a vertex has no region.
    ``colours`` is (R, 3) uint8.
    """

    labels: Ints
    names: tuple[str, ...]
    colours: np.ndarray
    name: str = "aparc"

    def __repr__(self) -> str:
        return f"Regions({self.name!r}, {len(self.names)} regions, {len(self.labels):,} vertices)"


@dataclass(frozen=True, eq=False)
class Cortex:
    """Two surfaces with the same faces, vertex i of one belonging to vertex i of the other.

    A FreeSurfer hemisphere and a simulated brain at one growth stage are both a ``Cortex``.

    Parameters
    ----------
    white, pial : Surface
        Inner and outer cortical surface [mm]; equal faces. Faces of pial may begin at another corner; they are then
        written as white's. They may also have the reverse order, which ``measure`` repairs or refuses.
    hemi : {"lh", "rh"}
        FreeSurfer spelling.
    name : str
        Subject or scene, as tables and reports show it.
    maps : mapping of str to (N,) float64
        Per-vertex maps that came with the surfaces, *in FreeSurfer's file convention*: ``thickness`` [mm],
        ``curv`` [1/mm, positive in sulci], ``sulc`` (positive in sulci), ``area`` [mm^2, white].
    cortex : (N,) bool, optional
        True where the vertex is cortex (FreeSurfer's ``?h.cortex.label``); None: everywhere.
    regions : Regions, optional
    inflated : Surface, optional
        For display only.
    sphere : Surface, optional
        FreeSurfer's ``?h.sphere``: by it a grown cortex is compared with the person's own.
    registered : Surface, optional
        FreeSurfer's ``?h.sphere.reg``: without a cortex label, that of fsaverage5 comes over by it.
    origin : str
        ``"FreeSurfer"``, ``"simulation"``, ``"files"`` or ``"arrays"``; ``"one surface"`` if white and pial are the
        same one, as :meth:`of_surface` makes it.
    units : str
        Unit of length; ``"mm"``.
    transform : (4, 4) float64, optional
        From these coordinates to the scanner's, if the file gives it.
    portion : float
        Share of the closed surface that was simulated (1/8 for an octant mirrored to a sphere); 1 for measured
        brains. Counts per simulated area divide by it.
    images : (N,) int64, optional
        Of a mirrored part, whose vertices come first: the vertex of the part of which each one is the image.
    info : mapping
        Facts for tables: growth ``g``, reference thickness, ``mu_ratio``, ...
    files : tuple of str
        The files this was read from.
    inputs : tuple of mapping
        ``{"path", "sha256", "bytes"}`` of these files, of the bytes that were read.

    Raises
    ------
    ValueError
        If white and pial do not correspond, or a map has another length or infinite values; the message gives the
        counts.
    """

    white: Surface
    pial: Surface
    hemi: str = "lh"
    name: str = "cortex"
    maps: Mapping[str, PerVertex] = field(default_factory=dict)
    cortex: Bools | None = None
    regions: Regions | None = None
    inflated: Surface | None = None
    sphere: Surface | None = None
    registered: Surface | None = None
    origin: str = "files"
    units: str = "mm"
    transform: Array | None = None
    portion: float = 1.0
    images: Ints | None = None
    info: Mapping[str, Any] = field(default_factory=dict)
    files: tuple[str, ...] = ()
    inputs: tuple[Mapping[str, Any], ...] = ()

    def __post_init__(self) -> None:
        for name in ("white", "pial"):
            validators.check_kind(getattr(self, name), Surface, f"{self.name}: {name}")
        validators.one_of(self.hemi, ("lh", "rh"), f"{self.name}: hemi")
        n_white, n_pial = len(self.white.verts), len(self.pial.verts)
        if n_white != n_pial:
            raise UnlikeSurfaces(
                f"{self.name}: white ({self.white.name}) has {n_white} vertices and pial ({self.pial.name}) has "
                f"{n_pial}; vertex i of one must belong to vertex i of the other. Were they taken from two subjects?"
            )
        if self.white.unknown or self.pial.unknown:
            self._leave_out_unknown()
        faces, pial_faces = self.white.faces, self.pial.faces
        if faces is not pial_faces:
            if not np.array_equal(np.sort(faces), np.sort(pial_faces)):  # triangle i has the same corners in both
                raise UnlikeSurfaces(
                    f"{self.name}: white ({self.white.name}) and pial ({self.pial.name}) have {n_white} vertices each "
                    "but different faces, so vertices cannot be matched. Take both from one reconstruction."
                )
            has_same_order = np.any([np.all(np.roll(pial_faces, k, axis=1) == faces, axis=1) for k in range(3)], axis=0)
            shared_faces = faces if has_same_order.all() else np.where(has_same_order[:, None], faces, faces[:, ::-1])
            object.__setattr__(self, "pial", replace(self.pial, faces=shared_faces))
        vertex_values: dict[str, Any] = {**self.maps, "cortex label": self.cortex}
        vertex_values["regions"] = self.regions and self.regions.labels
        for name in ("inflated", "sphere", "registered"):
            surface = getattr(self, name)
            vertex_values[name] = surface and surface.verts[:, 0]
        for name, values in vertex_values.items():
            if values is None:
                continue
            validators.same_length(values, n_white, f"{self.name}: {name}")
            validators.finite(values, f"{self.name}: {name}", "Put NaN where a value is unknown.", nan=True)

    def _leave_out_unknown(self) -> None:
        """Leave out the triangles of one surface at vertices that no triangle of the other uses."""
        is_used = np.zeros((2, len(self.white.verts)), bool)
        is_used[0, self.white.faces] = is_used[1, self.pial.faces] = True
        for name in ("white", "pial"):
            surface = getattr(self, name)
            is_used_face = np.all(np.all(is_used, axis=0)[surface.faces], axis=1)
            object.__setattr__(self, name, replace(surface, faces=surface.faces[is_used_face]))

    @classmethod
    def from_arrays(cls, white: Verts, pial: Verts, faces: Faces, *, hemi: str = "lh", **fields: Any) -> Cortex:
        """A cortex from the vertices of both surfaces, (N, 3) [mm], and their common faces, (M, 3).

        ``fields`` are other parameters of the class: ``name``, ``maps``, ``cortex``, ``regions``, ...

        Examples
        --------
        >>> from morphofold.shapes import icosphere
        >>> verts, faces = icosphere(4)
        >>> Cortex.from_arrays(47 * verts, 50 * verts, faces, name="shell")
        Cortex('shell', lh, 2,562 vertices, from arrays)
        """
        white_surface = Surface(white, faces, f"{hemi}.white")
        pial_surface = Surface(pial, white_surface.faces, f"{hemi}.pial")
        return cls(white_surface, pial_surface, hemi, **{"origin": "arrays", **fields})

    @classmethod
    def of_surface(cls, surface: Surface, hemi: str = "", **fields: Any) -> Cortex:
        """One surface that stands for white and pial; what needs both of them is not measured.

        By default it is right if its name begins with ``rh.``, else left. ``fields`` are other parameters of the class:
        ``name``, ``maps``, ``cortex``, ``regions``, ...
        """
        fields = {"name": surface.name, **fields, "origin": ONE_SURFACE}
        return cls(surface, surface, hemi or {"rh.": "rh"}.get(surface.name[:3], "lh"), **fields)

    @property
    def is_one_surface(self) -> bool:
        """Whether white and pial are the same surface, because only one was given."""
        return self.origin == ONE_SURFACE

    def surface(self, name: str = "pial") -> Surface:
        """The surface of that name: ``"white"``, ``"pial"``, ``"inflated"`` or ``"sphere"``.

        Raises
        ------
        ValueError
            If there is no surface of that name, or this cortex has none.
        """
        validators.one_of(name, SURFACES, f"{self.called}: surface")
        surface: Surface | None = getattr(self, name)
        if surface is None:
            present_surfaces = [other for other in SURFACES if getattr(self, other) is not None]
            raise MissingPart(f"{self.called}: has no surface {name}, only {', '.join(present_surfaces)}.")
        return surface

    def to_trimesh(self, surface: str = "pial") -> trimesh.Trimesh:
        """A surface as ``trimesh.Trimesh``, with the maps that came with the cortex as ``vertex_attributes``."""
        return self.surface(surface).to_trimesh(self.maps)

    def to_pyvista(self, surface: str = "pial") -> pyvista.PolyData:
        """A surface as ``pyvista.PolyData``, with the maps that came with the cortex as ``point_data``.

        For what was measured, ``cortex.pial.to_pyvista(measures.maps)``.
        """
        return self.surface(surface).to_pyvista(self.maps)

    def to_nilearn(self, values: PerVertex, surface: str = "pial") -> SurfaceImage:
        """A map on a surface as nilearn's ``SurfaceImage``, which its plots and maskers take.

        Parameters
        ----------
        values : (N,) array
            Of the vertices, such as ``measures.maps["H"]``.
            NaN where there is none.
        surface : {"pial", "white", "inflated", "sphere"}

        Returns
        -------
        nilearn.surface.SurfaceImage
            Its mesh and data have one part, ``left`` or ``right``; copies, with positions in mm.

        Raises
        ------
        UnknownName, MissingPart
            If there is no such surface, or this cortex has none.
        WrongShape
            If there is not one value per vertex.
        ModuleNotFoundError
            If nilearn is not installed.
        """
        nilearn, part = import_optional("nilearn.surface"), "right" if self.hemi == "rh" else "left"
        shape = self.surface(surface)
        (copied,) = shape._copies({"values": values}).values()
        mesh = nilearn.PolyMesh(**{part: nilearn.InMemoryMesh(shape.coordinates, shape.faces.copy())})
        return nilearn.SurfaceImage(mesh, {part: copied})

    def _repr_html_(self) -> str:
        return str(draw("html", self))

    def __repr__(self) -> str:
        return f"Cortex({self.name!r}, {self.hemi}, {self.n_vertices:,} vertices, from {self.origin})"

    @property
    def n_vertices(self) -> int:
        return len(self.white.verts)

    @property
    def called(self) -> str:
        """Name and hemisphere, for messages."""
        return f"{self.name} {self.hemi}"

    @property
    def faces(self) -> Faces:
        return self.white.faces
