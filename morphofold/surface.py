"""The two nouns that every room shares: a triangle surface, and a cortex made of two of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Verts = NDArray[np.float64]     # (N, 3), mm
Faces = NDArray[np.int64]       # (M, 3), 0-based, counter-clockwise seen from outside
PerVertex = NDArray[np.float64]  # (N,)


def check_mesh(verts: np.ndarray, faces: np.ndarray, name: str = "surface") -> None:
    """Raise ``ValueError`` unless (verts, faces) is a usable triangle mesh.

    Usable: shapes (N, 3) and (M, 3) with N, M > 0, integer faces inside 0..N-1, finite coordinates, no
    face that names a vertex twice. Holes, several components and unused vertices are allowed here;
    measures that cannot bear them say so themselves.
    """
    if verts.ndim != 2 or verts.shape[1] != 3 or len(verts) == 0:
        raise ValueError(
            f"{name}: verts must have shape (N, 3) with N > 0, got {verts.shape}. "
            "If the array holds one vertex per column, pass verts.T."
        )
    if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
        raise ValueError(f"{name}: faces must have shape (M, 3) with M > 0, got {faces.shape}.")
    if not np.issubdtype(faces.dtype, np.integer):
        raise TypeError(f"{name}: faces must be integers, got dtype {faces.dtype}.")
    wild = np.flatnonzero(~np.isfinite(verts).all(axis=1))
    if wild.size:
        raise ValueError(
            f"{name}: {wild.size} of {len(verts)} vertices are not finite; the first is vertex {wild[0]} = "
            f"{verts[wild[0]].tolist()}. The file is damaged, or the step that wrote it failed."
        )
    bad = np.flatnonzero(((faces < 0) | (faces >= len(verts))).any(axis=1))
    if bad.size:
        raise ValueError(
            f"{name}: {bad.size} of {len(faces)} faces name a vertex outside 0..{len(verts) - 1}; "
            f"the first is face {bad[0]} = {faces[bad[0]].tolist()}. "
            "Were the indices 1-based? Then pass faces - 1."
        )
    flat = np.flatnonzero(
        (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
    )
    if flat.size:
        raise ValueError(
            f"{name}: {flat.size} of {len(faces)} faces name a vertex twice; the first is face {flat[0]} = "
            f"{faces[flat[0]].tolist()}. Remove them."
        )


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle surface, checked on construction and read-only.

    Parameters
    ----------
    verts : (N, 3) array
        Vertex positions [mm], stored as float64.
    faces : (M, 3) integer array
        Triangles, 0-based, counter-clockwise seen from outside; stored as int64.
    name : str
        What errors and tables call it, e.g. ``"lh.pial"``.
    geometry : mapping, optional
        FreeSurfer's volume-geometry footer as nibabel reads it (``cras`` among it), kept for writing.

    Raises
    ------
    ValueError, TypeError
        If the arrays do not describe a triangle mesh; the message names the first offender.
    """

    verts: Verts
    faces: Faces
    name: str = "surface"
    geometry: Mapping[str, Any] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        verts, faces = np.asarray(self.verts), np.asarray(self.faces)
        check_mesh(verts, faces, self.name)
        verts = np.array(verts, dtype=np.float64, order="C")
        faces = np.array(faces, dtype=np.int64, order="C")
        verts.flags.writeable = faces.flags.writeable = False
        object.__setattr__(self, "verts", verts)
        object.__setattr__(self, "faces", faces)


@dataclass(frozen=True, eq=False)
class Regions:
    """Region labels of a cortex, as in a FreeSurfer annotation.

    ``labels`` is (N,) int64: an index into ``names`` and ``colours``, or -1 where a vertex has no region.
    ``colours`` is (R, 3) uint8.
    """

    labels: NDArray[np.int64]
    names: tuple[str, ...]
    colours: NDArray[np.uint8]
    name: str = "aparc"


@dataclass(frozen=True, eq=False)
class Cortex:
    """Two surfaces with the same faces, vertex i of one belonging to vertex i of the other.

    A FreeSurfer hemisphere and a simulated brain at one growth stage are both a ``Cortex``.

    Parameters
    ----------
    white, pial : Surface
        Inner and outer cortical surface [mm]; equal faces.
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
    origin : str
        ``"FreeSurfer"``, ``"simulation"`` or ``"files"``.
    units : str
        Unit of length; ``"mm"``.
    transform : (4, 4) float64, optional
        From these coordinates to the scanner's, if the file says so.
    portion : float
        Share of the closed surface that was really simulated (1/8 for an octant mirrored to a sphere); 1
        for measured brains. Counts per simulated area divide by it.
    info : mapping
        Plain facts to carry into tables: growth ``g``, reference thickness, ``mu_ratio``, ...
    files : tuple of str
        The files this was read from.

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
    maps: Mapping[str, PerVertex] = field(default_factory=dict, repr=False)
    cortex: NDArray[np.bool_] | None = field(default=None, repr=False)
    regions: Regions | None = field(default=None, repr=False)
    inflated: Surface | None = field(default=None, repr=False)
    origin: str = "files"
    units: str = "mm"
    transform: NDArray[np.float64] | None = field(default=None, repr=False)
    portion: float = 1.0
    info: Mapping[str, Any] = field(default_factory=dict)
    files: tuple[str, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        if self.hemi not in ("lh", "rh"):
            raise ValueError(f"{self.name}: hemi must be 'lh' or 'rh', got {self.hemi!r}.")
        n_white, n_pial = len(self.white.verts), len(self.pial.verts)
        if n_white != n_pial:
            raise ValueError(
                f"{self.name}: white ({self.white.name}) has {n_white} vertices and pial ({self.pial.name}) has "
                f"{n_pial}; vertex i of one must belong to vertex i of the other. Were they taken from two subjects?"
            )
        if not np.array_equal(self.white.faces, self.pial.faces):
            raise ValueError(
                f"{self.name}: white ({self.white.name}) and pial ({self.pial.name}) have {n_white} vertices each "
                "but different faces, so vertices cannot be matched. Take both from one reconstruction."
            )
        per_vertex = {**self.maps, **({} if self.cortex is None else {"cortex label": self.cortex})}
        if self.regions is not None:
            per_vertex["regions"] = self.regions.labels
        if self.inflated is not None:
            per_vertex["inflated"] = self.inflated.verts[:, 0]
        for name, values in per_vertex.items():
            if np.shape(values) != (n_white,):
                raise ValueError(
                    f"{self.name}: {name} has shape {np.shape(values)}, the surfaces have {n_white} vertices. "
                    "It belongs to another surface."
                )
            if len(infinite := np.flatnonzero(np.isinf(values))):
                raise ValueError(
                    f"{self.name}: {name} has {len(infinite)} infinite values, the first at vertex {infinite[0]}. Put "
                    "NaN where a value is unknown."
                )

    @property
    def n_vertices(self) -> int:
        return len(self.white.verts)

    @property
    def faces(self) -> Faces:
        return self.white.faces
