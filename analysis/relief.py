"""Relief of a folded surface: height of each vertex above the smoothed surface, and its position within the fold."""

from dataclasses import dataclass, field

import numpy as np

from morphofold import geometry
from morphofold.analysis.diffusion import diffusion
from morphofold.arrays import Array
from morphofold.errors import OutOfRange
from morphofold.kernels import kernel, reading
from morphofold.surface import Faces, PerVertex, Verts
from morphofold.threads import run_parallel

# length of edge paths over straight distance, mean over directions in a triangle grid
EDGE_PATH_DETOUR = 2 * 3**0.5 / np.pi
# of the radius of a window, and its accuracy on meshes with shorter edges than this; others are exact
WINDOW_TOLERANCE = 0.03
# on the pial surface of a person one cotangent in eight is negative and the largest is 1200
COTANGENT_BOUNDS = (0.0, 3.0)


@dataclass(frozen=True, eq=False)
class Relief:
    """Folds of a surface relative to the smoothed surface.

    ``height`` (N,) [mm], positive outward (FreeSurfer's ``sulc`` is about its negative); ``vertical`` (N, 3), the unit
    outward direction of the smoothed surface; ``amplitude`` (N,) [mm], the largest minus the smallest height within
    ``window``; ``phase`` (N,), 0 on the crown and 1 at the fundus, NaN where the amplitude is 0; ``scale`` and
    ``window`` [mm].
    """

    height: PerVertex = field(repr=False)
    vertical: Array = field(repr=False)
    amplitude: PerVertex = field(repr=False)
    phase: PerVertex = field(repr=False)
    scale: float
    window: float


def relief(verts: Verts, faces: Faces, scale: float, window: float | None = None) -> Relief:
    """Height above the surface smoothed over ``scale``, normalised within ``window`` along the surface.

    Parameters
    ----------
    verts, faces : (N, 3) float64, (M, 3) int64
        Closed surface, or one with a natural border [mm].
    scale : float
        Smoothing length [mm]; 10 for an adult human brain.
    window : float, optional
        Radius along the surface within which crown and fundus are found [mm]; None: 1.5 scale.

    Notes
    -----
    With x' the result of two rounds of :func:`implicit_smoothing`, and u its vertex normals,
    ``height = (x - x') . u`` and ``phase = (highest - height) / (highest - lowest)``.
    """
    window = 1.5 * scale if window is None else window
    height, vertical = height_and_vertical(verts, faces, scale)
    lowest, highest = windowed_range(verts, faces, height, window)
    amplitude = highest - lowest
    phase = np.divide(highest - height, amplitude, out=np.full(len(verts), np.nan), where=amplitude > 0)
    return Relief(height, vertical, amplitude, phase, float(scale), float(window))


def height_and_vertical(verts: Verts, faces: Faces, scale: float) -> tuple[PerVertex, Array]:
    """``height`` (N,) [mm] and ``vertical`` (N, 3) of :func:`relief` alone, which need no window."""
    smooth = implicit_smoothing(verts, faces, scale, rounds=2)
    vertical = geometry.vertex_normals(smooth, faces)
    return np.sum((verts - smooth) * vertical, axis=1), vertical


def implicit_smoothing(verts: Verts, faces: Faces, scale: float, *, rounds: int = 2, rtol: float = 1e-6) -> Verts:
    """Solve ``(M + scale^2 L) x' = M x`` ``rounds`` times: features much shorter than ``scale`` [mm] vanish.

    M are the vertex areas and L the cotangent Laplacian with cotangents clipped to [0, 3], both of the *given* surface.
    A sphere of radius r shrinks by ``1 / (1 + 2 (scale / r)^2)`` in each round. The solver starts from x, and ``rtol``
    is relative to the first residual, so the position and size of the surface do not matter. Returns (N, 3).

    Raises
    ------
    OutOfRange
        If scale is not a positive length.
    RuntimeError
        If the iteration does not converge. The mesh is then too irregular.
    """
    if not (scale > 0 and np.isfinite(scale)):
        raise OutOfRange(f"scale must be a positive length, got {scale!r}.")
    return _diffuse_implicitly(verts, faces, verts, scale, rounds, rtol)


def diffused(verts: Verts, faces: Faces, values: Array, scale: float) -> Array:
    """Three fields (N, 3) on the surface, smoothed once over ``scale`` [mm] as in :func:`implicit_smoothing`."""
    return _diffuse_implicitly(verts, faces, values, scale, 1, 1e-4)


def _diffuse_implicitly(verts: Verts, faces: Faces, values: Array, scale: float, rounds: int, rtol: float) -> Array:
    solver, x = diffusion(verts, faces, COTANGENT_BOUNDS), np.array(values)
    for _ in range(rounds):
        x += solver.solve(scale**2, -(scale**2) * (solver.stiffness @ x), np.zeros_like(x), rtol)
    return x


def windowed_range(verts: Verts, faces: Faces, values: PerVertex, radius: float) -> tuple[PerVertex, PerVertex]:
    """The least and the largest value within ``radius`` [mm] along the surface, (N,) each: grey erosion and dilation.

    The distance is the shortest path along edges divided by 1.10, the mean detour of such paths on equilateral
    triangles. Where edges are shorter than 3 % of the radius, the radius holds to 3 % at 98 % of the vertices. There,
    each source that reaches a vertex after another is nearer by 3 %, so the time grows as the number of vertices.
    """
    graph, reach = geometry.edge_graph(verts, faces), EDGE_PATH_DETOUR * radius
    gain = WINDOW_TOLERANCE * reach
    if gain < geometry.mean_edge_length(verts, faces):
        gain = 0.0

    def highest(values: PerVertex) -> PerVertex:
        order = np.argsort(-values, kind="stable")
        found: PerVertex = _windowed_maximum(*reading(graph, values, order), reach + gain / 2, gain)
        return found

    low, high = run_parallel(lambda: highest(-values), lambda: highest(values))
    return -low, high


@kernel
def _windowed_maximum(indptr, indices, lengths, values, order, radius, gain):
    # Highest source first: the first source to reach a vertex gives its maximum. A later source does not go beyond a
    # vertex that it does not reach by a path shorter than an earlier one's, by ``gain``. It ends when all vertices are
    # reached.
    # Paths are shortened until none can be (a queue, not a heap: it saves a third of the total time).
    n = len(values)
    result, near, source = np.empty(n), np.full(n, np.inf), np.full(n, -1, np.int32)
    queue, queued = np.empty(n, np.int32), np.zeros(n, np.bool_)
    missing = n
    for s in order:
        if near[s] == np.inf:
            result[s] = values[s]
            missing -= 1
        near[s], source[s] = 0.0, s
        queue[0] = s
        at, waiting = 0, 1
        while waiting > 0:
            v = queue[at]
            at = at + 1 if at + 1 < n else 0
            waiting -= 1
            queued[v], here = False, near[v]
            for e in range(indptr[v], indptr[v + 1]):
                w, way = indices[e], here + lengths[e]
                if way <= radius and way < near[w] and (way < near[w] - gain or source[w] == s):
                    if near[w] == np.inf:
                        result[w] = values[s]
                        missing -= 1
                    near[w], source[w] = way, s
                    if not queued[w]:
                        queued[w] = True
                        queue[at + waiting if at + waiting < n else at + waiting - n] = w
                        waiting += 1
        if missing == 0:
            break
    return result
