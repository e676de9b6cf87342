"""A plane cut through the folds of a cortex, with the mid-height contour and the chords of gyral thickness."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from morphofold.analysis import GyralThickness
from morphofold.errors import NoSolution
from morphofold.report.plots.figure_style import BLACK, line_style, new_figure
from morphofold.surface import Cortex, Surface

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NEAR_MM = 0.75  # mm on both sides of the plane; chords and samples within it are drawn
WINDOW_MM = (48.0, 30.0)  # mm, size of the drawn part of the cut
MIN_COS = 0.85  # least cosine between the contour and the normal of the plane
CHORD_GAP_MM = 3.0  # mm, least distance between the middles of drawn chords
RULER_MM = 10.0  # mm


def section_figure(cortex: Cortex, gyri: GyralThickness) -> Figure:
    """The part of a coronal cut with the most chords in its plane, of gyri that run across the plane.

    Raises
    ------
    NoSolution
        If no chord lies in a coronal plane.
    """
    plane_y, chord_index, window_middle = _plane(cortex.pial, gyri)
    lower_corner, upper_corner = window_middle - np.array(WINDOW_MM) / 2, window_middle + np.array(WINDOW_MM) / 2

    with new_figure(9.3, 6.0, 1, 1) as (figure, ((ax,),)):
        for surface, surface_name, line_format in (
            (cortex.pial, "pial surface", {"color": BLACK, "linewidth": 1.4}),
            (cortex.white, "white surface", {"color": "#999999", "linewidth": 1.0}),
        ):
            cut_ends = _cut(surface, plane_y)
            cut_lines = np.concatenate([cut_ends, np.full_like(cut_ends[:, :1], np.nan)], axis=1).reshape(-1, 2)
            ax.plot(*cut_lines.T, label=surface_name, **line_format)
        contour_points = gyri.points[np.abs(gyri.points[:, 1] - plane_y) < NEAR_MM][:, [0, 2]]
        ax.plot(*contour_points.T, ".", color=line_style(0)["color"], markersize=5, label="contour at mid-height")
        chord_label: str | None = "chord from wall to wall, gyral thickness [mm]"
        for k in chord_index:
            chord_ends = np.array([gyri.points[k], gyri.partner[k]])[:, [0, 2]]
            ax.plot(*chord_ends.T, color=line_style(1)["color"], linewidth=2, label=chord_label)
            ax.annotate(
                f"{gyri.width[k]:.1f}",
                chord_ends.mean(axis=0),
                fontsize=9,
                ha="center",
                va="center",
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.85},
            )
            chord_label = None
        ruler_start = lower_corner + 0.03 * np.array(WINDOW_MM)
        ax.plot([ruler_start[0], ruler_start[0] + RULER_MM], [ruler_start[1]] * 2, color=BLACK, linewidth=3)
        ax.annotate(f"{RULER_MM:g} mm", ruler_start + [RULER_MM / 2, 0.8], ha="center", va="bottom")
        ax.set(xlim=(lower_corner[0], upper_corner[0]), ylim=(lower_corner[1], upper_corner[1]), aspect="equal")
        ax.axis("off")
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def _plane(pial: Surface, gyri: GyralThickness) -> tuple[float, list[int], NDArray[np.float64]]:
    """y of the plane, the drawn chords, and the middle (x, z) of the window around them."""
    ends = np.stack([gyri.points, gyri.partner])
    chords = np.flatnonzero((np.ptp(ends[:, :, 1], axis=0) < NEAR_MM) & (np.abs(_course(pial, gyri)[:, 1]) > MIN_COS))
    if not len(chords):
        raise NoSolution(
            "no gyrus that runs across a coronal plane has a chord in this plane; there is nothing to draw."
        )
    best_plane: tuple[float, list[int], NDArray[np.float64]] = (0.0, [], np.zeros(2))
    for y in np.arange(ends[0, chords, 1].min(), ends[0, chords, 1].max() + 1):
        near_chords = chords[(np.abs(ends[:, chords, 1] - y) < NEAR_MM).all(axis=0)]
        ends_xz = ends[:, near_chords][:, :, [0, 2]]
        for window_middle in ends_xz.mean(axis=0):
            window_chords = near_chords[(np.abs(ends_xz - window_middle) < 0.46 * np.array(WINDOW_MM)).all(axis=(0, 2))]
            drawn_chords = _apart(ends.mean(axis=0), window_chords)
            best_plane = max(best_plane, (float(y), drawn_chords, window_middle), key=lambda plane: len(plane[1]))
    return best_plane


def _course(pial: Surface, gyri: GyralThickness) -> NDArray[np.float64]:
    """Direction (S, 3) of the mid-height contour at each sample."""
    corners, corner_phases = pial.verts[pial.faces[gyri.triangle]], gyri.relief.phase[pial.faces[gyri.triangle]]
    directions = sum(corner_phases[:, k, None] * (corners[:, (k + 2) % 3] - corners[:, (k + 1) % 3]) for k in range(3))
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))


def _cut(surface: Surface, plane_y: float) -> NDArray[np.float64]:
    """Where a coronal plane cuts a surface: line segments, (L, 2 ends, x and z)."""
    from trimesh import Trimesh
    from trimesh.intersections import mesh_plane

    mesh = Trimesh(surface.verts, surface.faces, process=False)
    return np.asarray(mesh_plane(mesh, [0, 1, 0], [0, plane_y, 0]))[:, :, [0, 2]]


def _apart(middles: NDArray[np.float64], chord_index: NDArray[np.int64]) -> list[int]:
    """The chords to draw: of chords near each other, only the first."""
    chosen: list[int] = []
    for k in chord_index:
        if all(np.linalg.norm(middles[k] - middles[drawn_chord]) > CHORD_GAP_MM for drawn_chord in chosen):
            chosen.append(int(k))
    return chosen
