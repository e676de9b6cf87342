"""A sphere for a closed surface that has none: conformal flow to a sphere, then areas evened out.

The flow is that of Kazhdan, Solomon and Ben-Chen (2012), (M_t + dt L_0) x_(t+1) = M_t x_t, with the cotangent stiffness
L_0 of the first surface and the lumped mass M_t of the present one. It ends at a conformal map, in which what sticks
out is tiny. So points are then moved along the gradient of a potential until each part of the sphere has its share of
the area.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import cg

from morphofold.errors import BadMesh, NoSolution
from morphofold.frozen_arrays import Array
from morphofold.geometry import cotangent_laplacian, face_areas, face_vectors, inner, unit, vertex_areas
from morphofold.progress_callbacks import Progress, logged
from morphofold.surface import Faces, Surface
from morphofold.threads import one_blas_thread
from morphofold.unfolding.harmonics import Expansion, degrees, fit
from morphofold.unfolding.unfold import check_closed

FLOW_STEP = 0.2  # dt, for a surface with the area of the unit sphere
MOST_FLOW_STEPS = 60
ROUND_SPREAD = 0.01  # standard deviation of radii over their mean at which the flow ends,
ROUND_ENOUGH, STANDSTILL = 0.1, 0.98  # or below which it ends once a step makes it no smaller than this factor
COTANGENT_LIMITS = (0.02, 20.0)  # smallest and largest: slivers would turn over
RESIDUAL = 1e-6  # relative residual of a step
EVEN_DEGREE, EVEN_STEP, LARGEST_MOVE, MOST_EVEN_STEPS = 16, 0.2, 0.05, 100
EVEN_RMS = 0.05  # rms of the smooth part of the logarithm of area ratios at which evening ends
MOST_TURNED_SHARE = 1e-3  # of the area of the sphere in faces that are turned over


@one_blas_thread()
def sphere_of(surface: Surface, progress: Progress = logged) -> Surface:
    """The unit sphere of a closed surface, with the same vertices and faces.

    Parameters
    ----------
    surface : Surface
    progress : callable
        Called with the share done (0 to 1) and a line of text. A hemisphere of 150,000 vertices takes two minutes.

    Raises
    ------
    SeveralPieces, OpenSurface, Handles, BadMesh
        If the surface is not closed and of one piece without handles, or flat.
    NoSolution
        If the flow does not become round.
    BadMesh
        If faces turn over on the way.
    """
    check_closed(surface)
    points = _even(surface, _round(surface, progress), progress)
    is_flipped = inner(face_vectors(points, surface.faces), points[surface.faces[:, 0]]) <= 0
    flipped_share = float(face_areas(points, surface.faces)[is_flipped].sum() / (4 * np.pi))
    if flipped_share > MOST_TURNED_SHARE:
        raise BadMesh(
            f"{surface.name}: {int(is_flipped.sum()):,} faces ({100 * flipped_share:.2g} % of the sphere) turn over "
            "on the way to a sphere. Make its triangles more even, or give a sphere."
        )
    return Surface(points, surface.faces, name=f"sphere of {surface.name}")


def _round(surface: Surface, progress: Progress) -> Array:
    """Points (N, 3) of the unit sphere by conformal flow."""
    faces = surface.faces
    verts = _of_unit_sphere_area(surface.coordinates, faces)
    stiffness = cotangent_laplacian(verts, faces, clip=COTANGENT_LIMITS)
    first_spread = spread = _spread(verts)
    for _ in range(MOST_FLOW_STEPS):
        mass = np.maximum(vertex_areas(verts, faces), 1e-12)
        matrix = sparse.csr_matrix(sparse.diags(mass) + FLOW_STEP * stiffness)
        preconditioner = sparse.diags(1 / matrix.diagonal())
        coordinates = [cg(matrix, mass * column, x0=column, rtol=RESIDUAL, M=preconditioner)[0] for column in verts.T]
        verts = _of_unit_sphere_area(np.column_stack(coordinates), faces)
        spread_before, spread = spread, _spread(verts)
        if spread < ROUND_SPREAD or STANDSTILL * spread_before < spread < ROUND_ENOUGH:
            return unit(verts)
        done_share = np.log(first_spread / spread) / np.log(first_spread / ROUND_SPREAD)
        progress(float(np.clip(0.8 * done_share, 0.0, 0.8)), f"conformal flow, radii within {100 * spread:.2g} %")
    raise NoSolution(
        f"{surface.name}: its radii still differ by {100 * spread:.2g} % after {MOST_FLOW_STEPS} steps of conformal "
        "flow. Give a sphere."
    )


def _of_unit_sphere_area(verts: Array, faces: Faces) -> Array:
    """The surface about the centre of its area, scaled to the area of the unit sphere."""
    centred_verts = verts - np.average(verts, axis=0, weights=vertex_areas(verts, faces))
    return np.asarray(centred_verts / np.sqrt(face_areas(centred_verts, faces).sum() / (4 * np.pi)))


def _spread(verts: Array) -> float:
    radii = np.linalg.norm(verts, axis=1)
    return float(radii.std() / radii.mean())


def _even(surface: Surface, points: Array, progress: Progress) -> Array:
    """Move points along the gradient of the potential whose Laplacian is the smooth part of the log of area ratios."""
    faces, l = surface.faces, degrees(EVEN_DEGREE)[1:, None]
    target_area = vertex_areas(surface.verts, faces)
    for step in range(MOST_EVEN_STEPS):
        area = vertex_areas(points, faces)
        log_ratio = np.log(np.maximum(target_area / target_area.sum(), 1e-12) / np.maximum(area / area.sum(), 1e-12))
        excess_coefficients = fit(points, log_ratio[:, None], area, EVEN_DEGREE, 1e-4).coefficients[1:]
        unevenness = float(np.sqrt(np.sum(excess_coefficients**2) / (4 * np.pi)))
        progress(0.8 + 0.2 * step / MOST_EVEN_STEPS, f"evening areas, off by {100 * unevenness:.2g} %")
        if unevenness < EVEN_RMS:
            break
        potential = Expansion(np.vstack([[0.0], -excess_coefficients / (l * (l + 1))]))
        move = EVEN_STEP * potential.gradient()(points)
        move -= inner(move, points)[:, None] * points
        points = unit(points + move * min(1.0, LARGEST_MOVE / float(np.linalg.norm(move, axis=1).max())))
    return points
