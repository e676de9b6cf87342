"""Tetrahedra from a file, checked to be one body: neighbours, symmetry planes, outer and inner surfaces.

Maps and labels of the file say which nodes are held, how thick the cortex is, and which regions it has.
"""

from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

from morphofold.errors import BadMesh, DoesNotApply, ImpossibleBody, MissingPart, NoCortex, OutOfRange, TooLarge
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.geometry import connected, face_areas
from morphofold.sim.mesh.brick_mesh import Plane, mirror
from morphofold.sim.mesh.tet_files import TetFile, counted, read_tet_file
from morphofold.sim.scene import MeshFile
from morphofold.surface import Regions
from morphofold.validators import finite, one_of

TET_FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))  # opposite to each corner; seen from outside
FLAT_VOLUME_RATIO = 1e-10  # a volume below this share of the cube of the longest edge counts as zero
#: distance from a symmetry plane, over the size of the body, within which a point lies on it: round-off of 32 bits
PLANE_TOLERANCE = 1e-6
SMALLER_CUT = 0.5  # a flat end with less than this share of the other's area is no second cut
MOST_REGIONS = 1000  # more are no parcellation
LARGEST_LABEL = 2**24 - 1  # each label has its own colour of 24 bits
COLOUR_STEP = 0x9E3779  # odd, so that all multiples below 2^24 differ

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
    def on_plane(self) -> Bools:
        """Whether a point lies on the symmetry plane of each axis (N, 3)."""
        on_plane = np.zeros(self.points.shape, dtype=bool)
        for axis, plane_position, _ in self.planes:
            on_plane[:, axis] = self.points[:, axis] == plane_position
        return on_plane

    def in_plane(self, faces: Ints) -> Bools:
        """Which faces (F, 3) lie in a symmetry plane (F,)."""
        return np.any(np.all(self.on_plane[faces], axis=1), axis=1)

    def nodes(self, points: Ints) -> Ints:
        """Numbers of the file's points in this mesh, of any shape; -1 where no tetrahedron uses the point."""
        node_numbers = np.minimum(np.searchsorted(self.used, points), len(self.used) - 1)
        return np.where(self.used[node_numbers] == points, node_numbers, -1)


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
    file, name = read_tet_file(geometry), geometry.file
    is_cortex = None if geometry.label is None else _has_cortex_label(geometry, file)
    used_points, tets = np.unique(file.tets, return_inverse=True)
    points = np.ascontiguousarray(file.points[used_points])
    tets = _right_handed_tets(name, points, tets.reshape(-1, 4))
    neighbours = _tets_across_faces(name, tets)
    boundary = tets[:, TET_FACES][neighbours < 0]
    planes = _symmetry_planes(geometry, points, boundary)
    for axis, plane_position, _ in planes:
        points[_near(points, axis, plane_position), axis] = plane_position
    face_kinds = np.full(tets.shape, INSIDE, dtype=np.int8)
    body = TetMesh(points, tets, neighbours, face_kinds, planes, is_cortex, file, used_points)
    in_plane = body.in_plane(boundary)
    sheet_faces = boundary[~in_plane]
    mirrored = mirror(sheet_faces, body.on_plane, planes)
    body_name = f"{name} (mirrored)" if planes else name
    is_outer, sheet_volume = _outer_sheet(body_name, mirrored.positions(points), mirrored.faces)
    tet_volume = 2 ** len(planes) * float(np.abs(_six_volumes(points, tets)).sum()) / 6
    if abs(tet_volume - sheet_volume) > 1e-6 * tet_volume:  # two neighbours are on the same side of their face
        raise BadMesh(
            f"{name}: tetrahedra overlap: the sum of their volumes is {tet_volume:.6g} mm3, but their surface encloses "
            f"{sheet_volume:.6g}. Repair the mesh."
        )
    sheet_kinds = np.where(is_outer[: len(sheet_faces)], PIAL, INNER)
    if geometry.cut_facets:
        sheet_kinds[_labelled_faces(geometry, body, sheet_faces, sheet_kinds)] = CUT
    boundary_kinds = np.full(len(boundary), IN_PLANE)
    boundary_kinds[~in_plane] = sheet_kinds
    face_kinds[neighbours < 0] = boundary_kinds
    return body


def _labelled_faces(geometry: MeshFile, body: TetMesh, faces: Ints, sheet_kinds: Ints) -> Bools:
    """Which faces (F, 3) of the boundary have a label of ``cut_facets``; those in symmetry planes may have it, too."""
    name, key = geometry.file, "cut_facets"
    nodes = body.nodes(body.file.labelled_triangles(str(geometry.facets), geometry.cut_facets, key))
    cut_faces = np.unique(np.sort(nodes[~(body.in_plane(nodes) & (nodes >= 0).all(axis=1))], axis=1), axis=0)
    all_faces = np.concatenate([cut_faces, np.sort(faces, axis=1)])
    face_numbers = np.unique(all_faces, axis=0, return_inverse=True)[1].ravel()
    is_cut = np.isin(face_numbers[len(cut_faces) :], face_numbers[: len(cut_faces)])
    n_bad = len(cut_faces) - int((is_cut & (sheet_kinds == PIAL)).sum())
    if n_bad:
        raise DoesNotApply(
            f"{name}: {n_bad:,} of {len(cut_faces):,} triangles of geometry.{key} are not faces of the outer surface; "
            "give labels of the outer surface only."
        )
    if not (~is_cut & (sheet_kinds == PIAL)).any():
        raise NoCortex(
            f"{name}: all {is_cut.sum():,} faces of the outer surface are cut (geometry.{key}), so there is no cortex; "
            "give fewer labels."
        )
    return is_cut


def _near(points: Array, axis: int, position: float) -> Bools:
    """Points (N,) that lie within round-off of a plane."""
    return np.abs(points[:, axis] - position) <= PLANE_TOLERANCE * float(np.ptp(points, axis=0).max())


def _symmetry_planes(geometry: MeshFile, points: Array, faces: Ints) -> tuple[Plane, ...]:
    """The planes in which the body is cut flat, from its boundary (F, 3): one end along each axis of ``symmetry``."""
    planes = []
    area = face_areas(points, faces)
    for letter in geometry.symmetry:
        axis = "xyz".index(letter)
        positions = points[:, axis]
        end_planes = [Plane(axis, float(positions.min()), 1), Plane(axis, float(positions.max()), -1)]
        low, high = (float(area[_near(points, axis, plane.at)[faces].all(axis=1)].sum()) for plane in end_planes)
        where = f"{letter} = {end_planes[0].at:.6g} and {end_planes[1].at:.6g} mm"
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
        plane = end_planes[0] if low > high else end_planes[1]
        plane_position = float(np.median(positions[_near(points, axis, plane.at)]))
        planes.append(plane._replace(at=plane_position))
    return tuple(planes)


def _has_cortex_label(geometry: MeshFile, file: TetFile) -> Bools:
    """Which tetrahedra have the label of the cortex."""
    name, data_name = geometry.file, str(geometry.label)
    label_values = file.cell_values(data_name, "label")
    is_cortex = np.asarray(label_values == geometry.cortex_label)
    if is_cortex.all() or not is_cortex.any():
        raise NoCortex(
            f"{name}: needs tetrahedra with {data_name} = {geometry.cortex_label} (geometry.cortex_label) and others "
            f"for the core; it has {counted(label_values)}."
        )
    return is_cortex


def _six_volumes(points: Array, tets: Ints) -> Array:
    """Six times the signed volume of each tetrahedron (E,) [mm^3]."""
    return np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]])


def _right_handed_tets(name: str, points: Array, tets: Ints) -> Ints:
    """Tetrahedra with corners in right-handed order."""
    volume = _six_volumes(points, tets) / 6
    corners = points[tets]
    longest_edge = np.linalg.norm(corners[:, [0, 0, 0, 1, 1, 2]] - corners[:, [1, 2, 3, 2, 3, 3]], axis=2).max(axis=1)
    flat_tets = np.flatnonzero(~(np.abs(volume) > FLAT_VOLUME_RATIO * longest_edge**3))
    if flat_tets.size:
        raise BadMesh(
            f"{name}: {len(flat_tets):,} of {len(tets):,} tetrahedra are flat; the first is {flat_tets[0]} with volume "
            f"{volume[flat_tets[0]]:.2g} mm3 and longest edge {longest_edge[flat_tets[0]]:.3g} mm. Repair the mesh."
        )
    return np.where(volume[:, None] < 0, tets[:, [1, 0, 2, 3]], tets)


def _tets_across_faces(name: str, tets: Ints) -> Ints:
    """The tetrahedron beyond each face (E, 4), as in ``TetMesh``; raises if the mesh has several parts."""
    faces = np.sort(tets[:, TET_FACES].reshape(-1, 3), axis=1)
    face_order = np.lexsort(faces.T)
    is_shared = (faces[face_order[1:]] == faces[face_order[:-1]]).all(axis=1)
    if (is_shared[1:] & is_shared[:-1]).any():
        face = faces[face_order[1:][np.flatnonzero(is_shared[1:] & is_shared[:-1])[0]]]
        raise BadMesh(f"{name}: more than two tetrahedra share the face with corners {face.tolist()}. Repair the mesh.")
    first_face, second_face = face_order[:-1][is_shared], face_order[1:][is_shared]
    neighbours = np.full(tets.size, -1)
    neighbours[first_face], neighbours[second_face] = second_face // 4, first_face // 4
    part_sizes = np.sort(np.bincount(connected(len(tets), np.column_stack([first_face // 4, second_face // 4]))))[::-1]
    if len(part_sizes) > 1:
        raise BadMesh(
            f"{name}: has {len(part_sizes):,} parts that share no face, of {part_sizes[0]:,}, {part_sizes[1]:,} ... "
            "tetrahedra. Keep one part; if points are duplicated, merge them."
        )
    return neighbours.reshape(-1, 4)


def _outer_sheet(name: str, points: Array, faces: Ints) -> tuple[Bools, float]:
    """Which boundary faces (F, 3) are of the sheet that encloses most (F,); volume enclosed by all sheets [mm^3]."""
    surface = trimesh.Trimesh(points, faces, process=False)
    face_pairs, shared_edges = surface.face_adjacency, surface.face_adjacency_edges  # of faces that alone share an edge
    advice = "Separate these parts, or join them by a face."
    if n_touching := (faces.size - face_pairs.size) // 4:
        raise BadMesh(f"{name}: parts of its surface touch along {n_touching:,} edges. {advice}")
    corners = [3 * face_pairs + (faces[face_pairs] == shared_edges[:, k, None, None]).argmax(axis=2) for k in (0, 1)]
    fan_numbers = connected(faces.size, np.concatenate(corners))
    n_pinched = fan_numbers.max() + 1 - len(np.unique(faces))
    if n_pinched:
        raise BadMesh(f"{name}: parts of its surface touch at {n_pinched:,} points. {advice}")
    sheet_numbers = connected(len(faces), face_pairs)
    six_volumes = np.bincount(sheet_numbers, np.linalg.det(points[faces]))
    return sheet_numbers == six_volumes.argmax(), float(six_volumes.sum()) / 6


def held_nodes(geometry: MeshFile, body: TetMesh) -> Ints:
    """Nodes (H,) that never move: of inner surfaces, of labelled facets, and where a map is not zero.

    Raises
    ------
    DoesNotApply, MissingPart, UnknownName, NotFinite
        If there is no such part or map, or it holds no node.
    """
    name, is_held = geometry.file, np.zeros(len(body.points), dtype=bool)
    if geometry.held == "inner":
        inner_faces = body.faces(INNER)
        if not len(inner_faces):
            raise DoesNotApply(
                f"{name}: has no inner surface to hold (geometry.held = 'inner'); set held to 'nothing'."
            )
        is_held[inner_faces] = True
    if geometry.held_facets:
        nodes = body.nodes(body.file.labelled_triangles(str(geometry.facets), geometry.held_facets, "held_facets"))
        is_outside = (nodes < 0).any(axis=1)
        if is_outside.any():
            raise DoesNotApply(
                f"{name}: {is_outside.sum():,} of {len(nodes):,} triangles of geometry.held_facets have corners in no "
                "tetrahedron; give labels of the body only."
            )
        is_held[nodes] = True
    if geometry.held_map is not None:
        map_values = _finite(geometry, body, geometry.held_map, "held_map", body.used)
        if not map_values.any():
            raise DoesNotApply(
                f"{name}: point data {geometry.held_map!r} are 0 at all {len(map_values):,} nodes, so they hold "
                "nothing (geometry.held_map); leave it out."
            )
        is_held |= map_values != 0
    return np.flatnonzero(is_held)


def thickness_excess(geometry: MeshFile, body: TetMesh) -> Array | None:
    """Factor on the thickness of the cortex minus 1 (N,), of the pial nodes only; None without ``thickness_map``.

    Raises
    ------
    UnknownName, NotFinite, OutOfRange
        If there is no such map, or a factor is not positive.
    """
    if geometry.thickness_map is None:
        return None
    pial_nodes = np.unique(body.faces(PIAL))
    factors = _finite(geometry, body, geometry.thickness_map, "thickness_map", body.used[pial_nodes])
    if factors.min() <= 0:
        raise OutOfRange(
            f"{geometry.file}: point data {geometry.thickness_map!r} are {factors.min():g} to {factors.max():g} on the "
            f"pial surface, {(factors <= 0).sum():,} of {len(pial_nodes):,} not positive (geometry.thickness_map); "
            "they multiply the thickness of the cortex."
        )
    excess = np.zeros(len(body.points))
    excess[pial_nodes] = factors - 1
    return excess


def regions_of(geometry: MeshFile, body: TetMesh, nodes: Ints) -> Regions | None:
    """Regions of pial ``nodes`` (S,) by the data that ``regions`` names; None without it.

    Point data are the labels themselves; cell data give a node the label of most tetrahedra around it, the smallest of
    equally many. Labels of 0 and below are no region.

    Raises
    ------
    UnknownName, NotFinite, OutOfRange, TooLarge, MissingPart
        If there are no such data, or they are no labels.
    """
    map_name, file = geometry.regions, body.file
    if map_name is None:
        return None
    maps = file.point_maps()
    one_of(map_name, [*maps, *file.mesh.cell_data], f"{file.name}: geometry.regions, point or cell data,")
    if map_name in maps:
        labels = _labels(geometry, maps[map_name][body.used[nodes]])
    else:
        labels = _most_common_labels(body.tets, _labels(geometry, file.cell_values(map_name, "regions")), nodes)
    region_labels = np.unique(labels[labels > 0])
    if not len(region_labels):
        raise MissingPart(
            f"{file.name}: no pial vertex has a label above 0 by {map_name!r} (geometry.regions); leave it out."
        )
    if len(region_labels) > MOST_REGIONS:
        raise TooLarge(
            f"{file.name}: {map_name!r} has {len(region_labels):,} labels on the pial surface, more than "
            f"{MOST_REGIONS:,} (geometry.regions); name data of regions."
        )
    colour_codes = region_labels * COLOUR_STEP % 2**24
    return Regions(
        np.where(labels > 0, np.searchsorted(region_labels, labels), -1),
        tuple(f"region {label}" for label in region_labels),
        np.stack([colour_codes >> 16, colour_codes >> 8 & 255, colour_codes & 255], axis=1).astype(np.uint8),
    )


def _finite(geometry: MeshFile, body: TetMesh, name: str, key: str, point_ids: Ints) -> Array:
    """Values of a map at points of the file, which must be finite."""
    values = body.file.point_map(name, key)[point_ids]
    finite(values, f"{geometry.file}: point data {name!r} (geometry.{key})", "Give every node a number.")
    return values


def _labels(geometry: MeshFile, values: NDArray[np.generic]) -> Ints:
    """Values as labels; they must be whole numbers."""
    numbers = np.asarray(values, dtype=np.float64)
    bad_rows = np.flatnonzero(~((numbers == np.rint(numbers)) & (np.abs(numbers) <= LARGEST_LABEL)))
    if bad_rows.size:
        raise OutOfRange(
            f"{geometry.file}: {bad_rows.size:,} of {len(numbers):,} values of {geometry.regions!r} are no labels, the "
            f"first is {numbers[bad_rows[0]]:g} (geometry.regions); give whole numbers of at most {LARGEST_LABEL}."
        )
    return numbers.astype(np.int64)


def _most_common_labels(tets: Ints, labels: Ints, surface_nodes: Ints) -> Ints:
    """The label (S,) of most tetrahedra around each of ``surface_nodes``, the smallest of equally many."""
    surface_number = np.full(int(tets.max()) + 1, -1)
    surface_number[surface_nodes] = np.arange(len(surface_nodes))
    corner = surface_number[tets]
    all_labels, label = np.unique(labels, return_inverse=True)
    pair_keys, count = np.unique((corner * len(all_labels) + label[:, None])[corner >= 0], return_counts=True)
    node, label = np.divmod(pair_keys, len(all_labels))
    pair_order = np.lexsort((-label, count, node))  # the last of each node is its most common one
    most_common = pair_order[np.append(node[pair_order][1:] != node[pair_order][:-1], True)]
    return all_labels[label[most_common]]
