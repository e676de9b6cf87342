"""Maps that came with a cortex in FreeSurfer's signs, whatever the signs of their files (HCP reverses them)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy import sparse

from morphofold.geometry import adjacency, vertex_normals
from morphofold.io.freesurfer import flip_curvature_sign
from morphofold.surface import PerVertex, Surface

OPPOSITE = -0.3  # correlation with the depth below; with FreeSurfer's sign it was 0.66 to 0.90 on people and averages
_AVERAGES = 20


def in_freesurfer_signs(
    maps: Mapping[str, PerVertex], white: Surface, files: Mapping[str, Path]
) -> dict[str, PerVertex]:
    """Maps (N,) by name, reversed with a warning where their sign is opposite to FreeSurfer's.

    ``sulc`` and ``curv``, positive in sulci, are opposite if their correlation with the depth of vertices below the
    smoothed white surface is less than ``OPPOSITE``; ``thickness``, if more values are negative than positive.
    """
    found = dict(maps)
    for name, values in maps.items():
        if name == "area":
            continue
        if name == "thickness":
            opposite, why = (values < 0).sum() > (values > 0).sum(), "is negative, as in HCP's convention"
        else:
            depth = _depth(white)
            known = np.isfinite(values) & np.isfinite(depth)
            with np.errstate(invalid="ignore", divide="ignore"):  # a constant map has no correlation
                r = np.corrcoef(values[known], depth[known])[0, 1] if known.any() else np.nan
            opposite, why = r < OPPOSITE, f"is positive on gyri, not in sulci (correlation with depth {r:.2f})"
        if opposite:
            warnings.warn(f"{files[name]}: {why}; its sign was reversed.", stacklevel=2)
            found[name] = flip_curvature_sign(values)
    return found


def _depth(white: Surface) -> PerVertex:
    """Distance (N,) [mm] of each vertex below the surface after averages over neighbours, positive in sulci."""
    near = adjacency(len(white.verts), white.faces).astype(np.float64)
    mean = sparse.diags_array(1 / np.maximum(near.sum(axis=1), 1)) @ near
    smooth = white.verts
    for _ in range(_AVERAGES):
        smooth = mean @ smooth
    normals = vertex_normals(white.verts, white.faces)
    outward = np.sign(np.nansum((white.verts - np.nanmean(white.verts, axis=0)) * normals))  # faces may be reversed
    return outward * ((smooth - white.verts) * normals).sum(axis=1)
