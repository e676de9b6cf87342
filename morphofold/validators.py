"""Checks of arguments: one for each kind of mistake, with one form of message."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.errors import BadMesh, NotFinite, OutOfRange, Refusal, UnknownName, WrongShape

LARGEST_UNKNOWN_SHARE = 0.01  # of the triangles, at vertices that are NaN: more are no mistake at a border
#: how to get an object that a function needs
_HOW_TO_GET = {
    "Surface": "Read one with morphofold.read_surface(path), or make one with Surface(verts, faces).",
    "Cortex": "Read one with morphofold.read_cortex(path), or make one with Cortex(white, pial) or "
    "Cortex.from_arrays(white, pial, faces).",
    "Measures": "Make them with morphofold.measure(cortex).",
    "Mapping": 'Name each: {"model": measures, "MRI": others}.',
    "MultiGraph": "Make one with morphofold.analysis.gyral_graph(cortex).",
    "Simulation": "Make one with morphofold.simulate(scene, out=folder).",
}


def check_kind(value: Any, classes: type | tuple[type, ...], label: str) -> None:
    """Raise ``TypeError``, which explains how to make one, unless ``value`` is of one of the kinds."""
    if isinstance(value, classes):
        return
    class_names = [cls.__name__ for cls in (classes if isinstance(classes, tuple) else (classes,))]
    raise TypeError(
        f"{label} must be of class {' or '.join(class_names)}, not {type(value).__name__}{_value_excerpt(value)}. "
        f"{_HOW_TO_GET.get(class_names[0], '')}"
    )


def check_arrays(verts: Any, faces: Any, name: str = "surface") -> None:
    """Raise ``TypeError`` unless vertices and triangles are arrays of numbers."""
    for label, values in (("verts", verts), ("faces", faces)):
        if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
            detail = f" of {values.dtype}" if isinstance(values, np.ndarray) else _value_excerpt(values)
            raise TypeError(
                f"{name}: {label} must be an array of numbers, not {type(values).__name__}{detail}. For a Surface pass "
                "surface.verts and surface.faces; read_surface(path) makes one from a file."
            )


def _value_excerpt(value: Any) -> str:
    return f" {str(value)[:60]!r}" if isinstance(value, str | Path) else ""


def one_of(value: Any, names: Collection[str], label: str) -> None:
    """Raise ``UnknownName`` unless a value is one of the names."""
    if value not in names:
        raise UnknownName(f"{label} must be one of {', '.join(names)}; got {value!r}.")


def positive(value: float, label: str, noun: str = "length in mm") -> None:
    """Raise ``OutOfRange`` unless a number is positive and finite."""
    if not 0 < value < np.inf:
        raise OutOfRange(f"{label} must be a positive {noun}, got {value!r}.")


def finite(values: np.ndarray, label: str, advice: str, *, nan: bool = False) -> None:
    """Raise ``NotFinite``, with the first vertex, unless all values (N, ...) are finite, or NaN if ``nan``."""
    is_wrong = np.isinf(values) if nan else ~np.isfinite(values)
    rows = np.flatnonzero(is_wrong.reshape(len(is_wrong), -1).any(axis=1))
    if rows.size:
        fault, first = "infinite" if nan else "not finite", np.asarray(values)[rows[0]].tolist()
        raise NotFinite(
            f"{label}: {rows.size} of {len(is_wrong)} are {fault}; the first is of vertex {rows[0]}: {first}. {advice}"
        )


def same_length(
    values: Any, n: int, label: str, advice: str = "It belongs to another surface.", error: type[Refusal] = WrongShape
) -> None:
    """Raise an error unless there is one value for each of ``n`` vertices."""
    if np.shape(values) != (n,):
        raise error(f"{label} has shape {np.shape(values)}, but there are {n} vertices. {advice}")


def check_mesh(verts: np.ndarray, faces: np.ndarray, name: str = "surface") -> None:
    """Raise ``ValueError`` unless (verts, faces) is a usable triangle mesh.

    Usable: shapes (N, 3) and (M, 3) with N, M > 0, integer faces inside 0..N-1, finite coordinates, no
    face that contains a vertex twice. Holes, several components and unused vertices are allowed here;
    measures that cannot handle them raise their own errors.
    """
    check_indexed(verts, faces, name)
    check_positions(verts, name)
    bad_faces = np.flatnonzero((np.diff(np.sort(faces)) == 0).any(axis=1))
    if bad_faces.size:
        raise BadMesh(
            f"{name}: {bad_faces.size} of {len(faces)} faces contain a vertex twice; the first is face {bad_faces[0]} "
            f"= {faces[bad_faces[0]].tolist()}. Remove them."
        )


def check_indexed(verts: np.ndarray, faces: np.ndarray, name: str) -> None:
    """As ``check_mesh``, but faces may contain a vertex twice."""
    check_arrays(verts, faces, name)
    for array_name, values, size_letter in (("verts", verts, "N"), ("faces", faces, "M")):
        if values.ndim != 2 or values.shape[1] != 3 or len(values) == 0:
            raise WrongShape(
                f"{name}: {array_name} must have shape ({size_letter}, 3) with {size_letter} > 0, got {values.shape}. "
                f"If the array holds one of them per column, pass {array_name}.T."
            )
    if not np.issubdtype(faces.dtype, np.integer):
        raise TypeError(f"{name}: faces must be integers, got dtype {faces.dtype}.")
    bad_faces = np.flatnonzero(((faces < 0) | (faces >= len(verts))).any(axis=1))
    if bad_faces.size:
        raise OutOfRange(
            f"{name}: {bad_faces.size} of {len(faces)} faces contain a vertex outside 0..{len(verts) - 1}; "
            f"the first is face {bad_faces[0]} = {faces[bad_faces[0]].tolist()}. "
            "Were the indices 1-based? Then pass faces - 1."
        )


def check_positions(verts: np.ndarray, name: str) -> None:
    """Raise ``NotFinite`` unless all vertex positions are finite."""
    advice = "The file is damaged, or the step that wrote it failed. (NaN is allowed at a border, in at most "
    finite(verts, f"{name}: vertices", f"{advice}{LARGEST_UNKNOWN_SHARE:.0%} of the triangles.)")
