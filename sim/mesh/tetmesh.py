"""Tetrahedra from a file, checked to be one body: neighbours, symmetry planes, outer and inner surfaces."""

import warnings
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from morphofold.arrays import Array, Bools, Ints
from morphofold.errors import BadMesh, DoesNotApply, ImpossibleBody, NoCortex
from morphofold.sim.mesh.brick_mesh import Plane
from morphofold.sim.mesh.mirroring import mirror
from morphofold.sim.mesh.tet_files import TetFile, counted, read_tet_file
from morphofold.sim.scene import MeshFile

TET_FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))  # opposite to each corner; seen from outside
FLAT_VOLUME_RATIO = 1e-10  # a volume below this share of the cube of the longest edge counts as zero
#: distance from a symmetry plane, over the size of the body, within which a point lies on it: round-off of 32 bits
PLANE_TOLERANCE = 1e-6
SMALLER_CUT = 0.5  # a flat end with less than this share of the other's area is no second cut

#: what a face of a tetrahedron is: between two of them; of the outer surface; of a part of it that is no cortex; of an
#: inner surface; in a symmetry plane
INSIDE, PIAL, CUT, INNER, IN_PLANE = range(5)


class TetMesh(NamedTuple):
    """One body of tetrahedra.

    Attributes
    ----------
    points : (N, 3) float64
        Points [mm], all in use; exactly on the symmetry planes if near.
    tets : (E, 4) int
        Corners in right-handed order.
    across : (E, 4) int
        The tetrahedron beyond the face opposite to each corner, -1 at the boundary.
    kind : (E, 4) int8
        What this face is: ``INSIDE``, ``PIAL``, ``CUT``, ``INNER`` or ``IN_PLANE``.
    planes : tuple of Plane
        Symmetry planes, at most one per axis.
    cortex : (E,) bool, optional
        Which tetrahedra have the label of the cortex.
    file : TetFile
        Content of the file; its tetrahedra have the same order.
    used : (N,) int
        The points of the file.
    """

    points: Array
    tets: Ints
    across: Ints
    kind: NDArray[np.int8]
    planes: tuple[Plane, ...]
    cortex: Bools | None
    file: TetFile
    used: Ints

    def faces(self, *kinds: int) -> Ints:
        """Faces (F, 3) of some kinds, counter-clockwise seen from outside of the material."""
        return self.tets[:, TET_FACES][np.isin(self.kind, kinds)]

    @property
    def pial(self) -> Ints:
        """Faces (F, 3) of the outer surface that are cortex."""
        return self.faces(PIAL)

    @property
    def inner(self) -> Ints:
        """Faces (F, 3) of all inner surfaces."""
        return self.faces(INNER)

    @property
    def on_plane(self) -> Bools:
        """Whether a point lies on the symmetry plane of each axis (N, 3)."""
        found = np.zeros(self.points.shape, dtype=bool)
        for axis, at, _ in self.planes:
            found[:, axis] = self.points[:, axis] == at
        return found

    def in_plane(self, faces: Ints) -> Bools:
        """Which faces (F, 3) lie in a symmetry plane (F,)."""
        return np.any(np.all(self.on_plane[faces], axis=1), axis=1)

    def nodes(self, points: Ints) -> Ints:
        """Numbers of the file's points in this mesh, of any shape; -1 where no tetrahedron uses the point."""
        at = np.minimum(np.searchsorted(self.used, points), len(self.used) - 1)
        return np.where(self.used[at] == points, at, -1)


def read_tets(geometry: MeshFile) -> TetMesh:
    """Read the body from the file of a geometry.

    Raises
    ------
    FileNotFoundError
        If there is neither a file nor a sample of that name.
    ValueError
        For a file that is damaged, too large, or has other cells; for a body of several parts, with flat tetrahedra, or
        whose surface touches itself; for a label that does not exist, or that all tetrahedra have; for an axis along
        which the body is not cut flat.
    """
    file = read_tet_file(geometry)
    name = file.name
    cortex = None if geometry.label is None else _has_cortex_label(geometry, file)
    used, tets = np.unique(file.tets, return_inverse=True)
    points, tets = _right_handed_tets(name, np.ascontiguousarray(file.points[used]), tets.reshape(-1, 4))
    across = _tets_across_faces(name, tets)
    boundary = tets[:, TET_FACES][across < 0]
    planes = _symmetry_planes(geometry, points, boundary)
    for axis, at, _ in planes:
        points[_near(points, axis, at), axis] = at
    kind = np.full(tets.shape, INSIDE, dtype=np.int8)
    body = TetMesh(points, tets, across, kind, planes, cortex, file, used)
    in_plane = body.in_plane(boundary)
    rest = boundary[~in_plane]
    whole = mirror(rest, body.on_plane, planes)
    called = f"{name} (mirrored)" if planes else name
    outer, enclosed = _outer_sheet(called, whole.positions(points), whole.faces)
    filled = 2 ** len(planes) * float(np.abs(_six_volumes(points, tets)).sum()) / 6
    if abs(filled - enclosed) > 1e-6 * filled:  # two neighbours are on the same side of their face
        raise BadMesh(
            f"{name}: tetrahedra overlap: the sum of their volumes is {filled:.6g} mm3, but their surface encloses "
            f"{enclosed:.6g}. Repair the mesh."
        )
    sheet = np.where(outer[: len(rest)], PIAL, INNER)
    if geometry.cut_facets:
        sheet[_labelled_faces(geometry, body, rest, sheet)] = CUT
    of_boundary = np.full(len(boundary), IN_PLANE)
    of_boundary[~in_plane] = sheet
    kind[across < 0] = of_boundary
    return body


def _labelled_faces(geometry: MeshFile, body: TetMesh, faces: Ints, sheet: Ints) -> Bools:
    """Which faces (F, 3) of the boundary have a label of ``cut_facets``; those in symmetry planes may have it, too."""
    name, key = geometry.file, "cut_facets"
    found = body.nodes(body.file.labelled_triangles(str(geometry.facets), geometry.cut_facets, key))
    rows = np.unique(np.sort(found[~(body.in_plane(found) & (found >= 0).all(axis=1))], axis=1), axis=0)
    joined = np.concatenate([rows, np.sort(faces, axis=1)])
    number = np.unique(joined, axis=0, return_inverse=True)[1].ravel()
    cut = np.isin(number[len(rows) :], number[: len(rows)])
    inside = len(rows) - int((cut & (sheet == PIAL)).sum())
    if inside:
        raise DoesNotApply(
            f"{name}: {inside:,} of {len(rows):,} triangles of geometry.{key} are not faces of the outer surface; give "
            "labels of the outer surface only."
        )
    if not (~cut & (sheet == PIAL)).any():
        raise NoCortex(
            f"{name}: all {cut.sum():,} faces of the outer surface are cut (geometry.{key}), so there is no cortex; "
            "give fewer labels."
        )
    return cut


def _near(points: Array, axis: int, at: float) -> Bools:
    """Points (N,) that lie within round-off of a plane."""
    return np.abs(points[:, axis] - at) <= PLANE_TOLERANCE * float(np.ptp(points, axis=0).max())


def _symmetry_planes(geometry: MeshFile, points: Array, faces: Ints) -> tuple[Plane, ...]:
    """The planes in which the body is cut flat, from its boundary (F, 3): one end along each axis of ``symmetry``."""
    planes = []
    normal = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    for letter in geometry.symmetry:
        axis = "xyz".index(letter)
        x = points[:, axis]
        ends = [Plane(axis, float(x.min()), 1), Plane(axis, float(x.max()), -1)]
        low, high = (float(area[_near(points, axis, end.at)[faces].all(axis=1)].sum()) for end in ends)
        where = f"{letter} = {ends[0].at:.6g} and {ends[1].at:.6g} mm"
        if not max(low, high) > 0:
            raise ImpossibleBody(
                f"{geometry.file}: is not cut flat along {letter} (geometry.symmetry): no face of its boundary lies at "
                f"{where}. Leave {letter} out, or cut the body there."
            )
        if min(low, high) >= SMALLER_CUT * max(low, high):
            raise ImpossibleBody(
                f"{geometry.file}: is flat at both ends along {letter} (geometry.symmetry): {low:.4g} and {high:.4g} "
                f"mm2 at {where}. Only one end can be a symmetry plane; leave {letter} out, or cut the body at one end."
            )
        end = ends[0] if low > high else ends[1]
        at = float(np.median(x[_near(points, axis, end.at)]))
        planes.append(end._replace(at=at))
    return tuple(planes)


def _has_cortex_label(geometry: MeshFile, file: TetFile) -> Bools:
    """Which tetrahedra have the label of the cortex."""
    name, label = geometry.file, str(geometry.label)
    values = file.cell_values(label, "label")
    cortex = np.asarray(values == geometry.cortex_label)
    if cortex.all() or not cortex.any():
        raise NoCortex(
            f"{name}: needs tetrahedra with {label} = {geometry.cortex_label} (geometry.cortex_label) and others for "
            f"the core; it has {counted(values)}."
        )
    return cortex


def _six_volumes(points: Array, tets: Ints) -> Array:
    """Six times the signed volume of each tetrahedron (E,) [mm^3]."""
    a, b, c, d = (points[tets[:, k]] for k in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)


def _right_handed_tets(name: str, points: Array, tets: Ints) -> tuple[Array, Ints]:
    """Points, and tetrahedra with corners in right-handed order."""
    volume = _six_volumes(points, tets) / 6
    a, b, c, d = (points[tets[:, k]] for k in range(4))
    edges = (a - b, a - c, a - d, b - c, b - d, c - d)
    longest = np.sqrt(np.max([np.einsum("ij,ij->i", edge, edge) for edge in edges], axis=0))
    flat = np.flatnonzero(~(np.abs(volume) > FLAT_VOLUME_RATIO * longest**3))
    if flat.size:
        raise BadMesh(
            f"{name}: {len(flat):,} of {len(tets):,} tetrahedra are flat; the first is {flat[0]} with volume "
            f"{volume[flat[0]]:.2g} mm3 and longest edge {longest[flat[0]]:.3g} mm. Repair the mesh."
        )
    if (volume < 0).all():  # mixed orders are usual
        warnings.warn(
            f"{name}: all {len(tets):,} tetrahedra were turned inwards; their corners were reordered.", stacklevel=2
        )
    return points, np.where(volume[:, None] < 0, tets[:, [1, 0, 2, 3]], tets)


def _tets_across_faces(name: str, tets: Ints) -> Ints:
    """The tetrahedron beyond each face (E, 4), as in ``TetMesh``; raises if the mesh has several parts."""
    faces = np.sort(tets[:, TET_FACES].reshape(-1, 3), axis=1)
    order = np.lexsort(faces.T)
    same = (faces[order[1:]] == faces[order[:-1]]).all(axis=1)
    if (same[1:] & same[:-1]).any():
        at = faces[order[1:][np.flatnonzero(same[1:] & same[:-1])[0]]]
        raise BadMesh(f"{name}: more than two tetrahedra share the face with corners {at.tolist()}. Repair the mesh.")
    left, right = order[:-1][same], order[1:][same]
    across = np.full(tets.size, -1)
    across[left], across[right] = right // 4, left // 4
    parts, part = _connected_parts(left // 4, right // 4, len(tets))
    if parts > 1:
        size = np.sort(np.bincount(part))[::-1]
        raise BadMesh(
            f"{name}: has {parts:,} parts that share no face, of {size[0]:,}, {size[1]:,} ... tetrahedra. Keep one "
            "part; if points are duplicated, merge them."
        )
    return across.reshape(-1, 4)


def _outer_sheet(name: str, points: Array, faces: Ints) -> tuple[Bools, float]:
    """Which boundary faces (F, 3) are of the sheet that encloses most (F,); volume enclosed by all sheets [mm^3]."""
    half = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)  # half-edge 3 f + k, from corner k
    low, high = half.min(axis=1), half.max(axis=1)
    order = np.lexsort((high, low))  # each edge has an even number of half-edges
    one, two = order[0::2], order[1::2]
    cure = "Separate these parts, or join them by a face."
    again = (low[one[1:]] == low[one[:-1]]) & (high[one[1:]] == high[one[:-1]])
    if again.any() or (half[one] != half[two][:, ::-1]).any():
        raise BadMesh(f"{name}: parts of its surface touch along {max(again.sum(), 1):,} edges. {cure}")
    following = one // 3 * 3 + (one + 1) % 3, two // 3 * 3 + (two + 1) % 3
    fans, _ = _connected_parts(np.concatenate([one, two]), np.concatenate([following[1], following[0]]), faces.size)
    pinched = fans - len(np.unique(faces))
    if pinched:
        raise BadMesh(f"{name}: parts of its surface touch at {pinched:,} points. {cure}")
    count, sheet = _connected_parts(one // 3, two // 3, len(faces))
    a, b, c = (points[faces[:, k]] for k in range(3))
    enclosed = np.bincount(sheet, np.einsum("ij,ij->i", a, np.cross(b, c)), count)
    return sheet == enclosed.argmax(), float(enclosed.sum()) / 6


def _connected_parts(one: Ints, two: Ints, size: int) -> tuple[int, Ints]:
    """Number of connected parts of ``size`` items, where ``one`` and ``two`` are joined, and the part of each item."""
    return connected_components(sparse.csr_matrix((np.ones(len(one)), (one, two)), (size, size)))
