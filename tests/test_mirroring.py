"""Bodies from files that are cut flat: symmetry planes, and the whole that their mirror images make."""

from dataclasses import replace

import numpy as np
import pytest
from made_octants import HOLE, R, T, bilayer, boundary, geometry, mirrored, octant, written
from scipy.spatial import cKDTree

from morphofold import simulate
from morphofold.errors import BadMesh, ImpossibleBody, NamedTwice, UnknownName
from morphofold.sim.body import Body
from morphofold.sim.elements import tets as tet_elements
from morphofold.sim.mesh.checked_tets import INNER, PIAL, read_tets
from morphofold.sim.mesh.from_file import within_planes
from morphofold.sim.output.stage_surfaces import whole_surfaces
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.stage_checks import enclosed_volume

AXES = {"x": 0, "y": 1, "z": 2}


def body_of(one, law="isotropic"):
    return Body(one, mu_cortex=2.0, mu_core=1.0, kappa_ratio=50.0, law=law)


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """Bilayers of the whole, its half, quarter and octant, of one mesh."""
    folder, (points, tets) = tmp_path_factory.mktemp("parts"), octant()
    made = {}
    for letters in ("", "z", "yz", "xyz"):
        whole_along = [axis for letter, axis in AXES.items() if letter not in letters]
        path = written(folder / f"cut-{letters}.vtu", *mirrored(points, tets, whole_along))
        made[letters] = bilayer(path, symmetry=tuple(letters), held="inner")
    return made


@pytest.mark.parametrize("letters", ["z", "yz", "xyz"])
def test_a_part_mirrored_is_the_whole(parts, letters):
    part, whole = body_of(parts[letters]), body_of(parts[""])
    surfaces, whole_ones = (whole_surfaces(body, body.X)[:2] for body in (part, whole))
    for mirrored_surface, surface, most in zip(
        surfaces, whole_ones, (0.02 * T, 1e-9)
    ):  # white: below an edge two faces are nearest
        faces = mirrored_surface.faces
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()  # closed, every seam welded
        assert (len(mirrored_surface.verts), len(faces)) == (len(surface.verts), len(surface.faces))
        distance, _ = cKDTree(surface.verts).query(mirrored_surface.verts)
        assert distance.max() < most
        assert enclosed_volume(mirrored_surface) == pytest.approx(enclosed_volume(surface), rel=most / 100)
    assert part.bilayer.portion == 0.5 ** len(letters)
    assert part.bilayer.closed
    assert part.elements.volume.sum() / part.bilayer.portion == pytest.approx(whole.elements.volume.sum(), rel=1e-12)
    assert part.thickness == pytest.approx(whole.thickness, rel=1e-12)


@pytest.mark.parametrize("letters", ["z", "yz", "xyz"])
def test_cut_faces_are_no_cortex_and_their_nodes_slide(parts, letters):
    b = parts[letters]
    X, body = b.mesh.p.T, body_of(b)
    np.testing.assert_allclose(np.linalg.norm(X[: b.n_surface], axis=1), R)
    np.testing.assert_allclose(np.linalg.norm(X[b.held], axis=1), HOLE)
    assert len(b.held) == b.n_surface
    assert {(plane.axis, plane.at, plane.side) for plane in b.planes} == {(AXES[letter], 0.0, 1) for letter in letters}
    for letter in letters:
        axis = AXES[letter]
        at = X[:, axis] == 0
        assert not body.free[at, axis].any()
        assert not b.radial[at, axis].any()
        assert not (b.white @ X)[at[: b.n_surface], axis].any()
    assert (body.free.sum(axis=1) == 3 - sum(X[:, AXES[letter]] == 0 for letter in letters))[
        np.setdiff1d(np.arange(len(X)), b.held)
    ].all()


def alone(mesh, X, alike):
    """Patches of single tetrahedra: those of several do not end at symmetry planes in a whole body."""
    return np.column_stack([np.arange(mesh.nelements), *np.full((5, mesh.nelements), -1)])


@pytest.mark.parametrize("law", ["isotropic", "tangential"])
@pytest.mark.parametrize("letters", ["z", "xyz"])
def test_forces_in_a_part_are_those_in_the_whole(parts, letters, law, rng, monkeypatch):
    monkeypatch.setattr(tet_elements, "cluster", alone)
    part, whole = body_of(parts[letters], law), body_of(parts[""], law)
    axes = [AXES[letter] for letter in letters]
    folded = whole.X.copy()
    folded[:, axes] = np.abs(folded[:, axes])
    distance, origin = cKDTree(part.X).query(folded)
    assert distance.max() < 1e-12
    sign = np.where((whole.X < 0) & np.isin(np.arange(3), axes), -1.0, 1.0)
    np.testing.assert_allclose(whole.bilayer.share, part.bilayer.share[origin], atol=1e-12)
    one_sided = np.abs(whole.bilayer.radial - sign * part.bilayer.radial[origin]).max(axis=1)
    assert np.median(one_sided[whole.bilayer.share > 0]) < 1e-12
    # at a plane the nearest faces of both sides are equally near, and the whole body takes one of them
    whole = body_of(replace(whole.bilayer, radial=sign * part.bilayer.radial[origin]), law)

    u = 0.2 * rng.standard_normal(part.X.shape) * ~part.on_plane
    for body in (part, whole):
        body.grow(1.2)
    at_part = part.all_forces(part.X + u)
    times = 2.0 ** part.on_plane.sum(axis=1, keepdims=True)  # a node on a plane belongs to both halves
    want = sign * (times * at_part * ~part.on_plane)[origin]
    forces = whole.all_forces(whole.X + sign * u[origin])
    np.testing.assert_allclose(forces, want, atol=1e-11 * np.abs(want).max())


def test_planes_are_where_the_body_ends_and_may_be_rounded(tmp_path):
    points, tets = octant()
    shift = np.array([7.0, -3.0, 0.1])
    moved = (points * [-1, 1, 1] + shift).astype(np.float32)
    part = bilayer(written(tmp_path / "a.vtu", moved, tets), symmetry=("x", "y", "z"))
    assert [plane.side for plane in part.planes] == [-1, 1, 1]
    np.testing.assert_allclose([plane.at for plane in part.planes], shift, rtol=1e-6)
    whole = bilayer(written(tmp_path / "b.vtu", *mirrored(points, tets)))
    pial, want = (whole_surfaces(body_of(part_of), part_of.mesh.p.T)[1] for part_of in (part, whole))
    distance, _ = cKDTree(want.verts + shift).query(pial.verts)
    assert distance.max() < 1e-5
    np.testing.assert_allclose(np.linalg.norm(pial.verts - shift, axis=1), R, rtol=1e-6)


def test_a_node_at_a_plane_has_the_mean_direction_of_both_sides():
    n = np.array([[0.6, 0.8, 0.0], [0.6, 0.8, 0.0], [1.0, 0.0, 0.0]])
    on = np.array([[False, False, False], [True, False, False], [True, True, True]])
    np.testing.assert_array_equal(within_planes(n, on), [[0.6, 0.8, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])


def scene_of(folder, path, letters):
    held = f'cortex_thickness = {T}\nheld = "inner"\nsymmetry = {list(letters)}\n'
    text = f'name = "part"\n[geometry]\nshape = "mesh"\nfile = "{path}"\n{held}[effects.contact]\n'
    (folder / "part.toml").write_text(text)
    return load_scene(folder / "part.toml", ["growth.final=1.03", "output.volume=false", "growth.rate=4.0"])


def test_an_octant_grows_like_the_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(tet_elements, "cluster", alone)
    points, tets = octant(4)
    part = scene_of(tmp_path, written(tmp_path / "a.vtu", points, tets), "xyz")
    assert "symmetry" in part.called_effects
    whole = scene_of(tmp_path, written(tmp_path / "b.vtu", *mirrored(points, tets)), "")
    assert "symmetry" not in whole.called_effects
    runs = [simulate(scene, tmp_path / name) for name, scene in (("part", part), ("whole", whole))]
    pials = [run.cortex(1.03).pial for run in runs]
    assert len(pials[0].verts) == len(pials[1].verts)
    apart, _ = cKDTree(pials[1].verts).query(pials[0].verts)
    grown = np.linalg.norm(pials[1].verts, axis=1).mean() - R
    assert grown > 0.1
    assert apart.max() < 1e-4 * grown
    assert runs[0].cortex(1.03).portion == 1 / 8


def test_a_cut_through_the_hole_leaves_the_hole_an_inner_surface(tmp_path):
    points, tets = octant()
    body = read_tets(geometry(written(tmp_path / "a.vtu", points, tets), symmetry=("x", "y", "z")))
    pial, inner = body.faces(PIAL), body.faces(INNER)
    for faces, radius in ((pial, R), (inner, HOLE)):
        np.testing.assert_allclose(np.linalg.norm(body.points[faces], axis=2), radius)
    assert len(pial) + len(inner) + 3 * 6 * 2 * 7 == len(boundary(tets))  # 7 layers of 6 quads at each plane


def test_an_axis_without_a_cut_is_refused(tmp_path):
    with pytest.raises(ImpossibleBody, match=r"x = -50 and 50 mm"):
        bilayer(written(tmp_path / "a.vtu", *mirrored(*octant(), (0,))), symmetry=("x",))


def test_axes_are_x_y_and_z_each_once():
    for letters, kind in (('["q"]', UnknownName), ('["x", "x"]', NamedTwice)):
        with pytest.raises(kind, match="symmetry"):
            load_scene("mesh", [f"geometry.symmetry={letters}"])


def test_a_label_of_the_cortex_goes_with_planes(tmp_path):
    points, tets = octant()
    layer = (np.arange(len(tets)) < 3 * len(tets) / 7).astype(np.int64)  # three of seven layers
    path = written(tmp_path / "a.vtu", points, tets, cell_data={"layer": layer})
    cut = ("x", "y", "z")
    by_label, by_depth = bilayer(path, symmetry=cut, label="layer"), bilayer(path, symmetry=cut)
    assert np.array_equal(by_label.mesh.t, by_depth.mesh.t)
    np.testing.assert_allclose(by_label.share, by_depth.share, atol=0.05)
    whites = [b.white @ b.mesh.p.T for b in (by_label, by_depth)]
    assert np.linalg.norm(whites[0] - whites[1], axis=1).max() < 0.05 * T
    assert np.array_equal(whites[0] == 0, by_label.mesh.p.T[: by_label.n_surface] == 0)  # exactly in the planes


def box():
    """A box of 10 x 10 x 10 mm with a core, flat at all ends."""
    from skfem import MeshTet

    grid = np.linspace(0, 10, 6)
    mesh = MeshTet.init_tensor(grid, grid, grid)
    return mesh.p.T, mesh.t.T.astype(np.int64)


def test_a_body_flat_at_both_ends_is_refused(tmp_path):
    with pytest.raises(ImpossibleBody, match=r"100 and 100 mm2 at z = 0 and 10 mm"):
        bilayer(written(tmp_path / "a.vtu", *box()), symmetry=("z",), cortex_thickness=2.5)


def test_a_body_that_touches_its_image_beside_the_cut_is_refused(tmp_path):
    """A bridge with one foot on the plane z = 0, and a corner of one tetrahedron that reaches down to it."""
    points, tets = box()
    x, _, z = points[tets].mean(axis=1).T
    beyond = (x > 5) & (z < 2)
    tip = np.flatnonzero(beyond & ((points[tets][:, :, 2] == 0).sum(axis=1) == 1))[0]
    keep = ~beyond
    keep[tip] = True
    points[points[:, 2] == 10, 2] += 0.1 * points[points[:, 2] == 10, 0]  # the roof is not flat along z
    path = written(tmp_path / "a.vtu", points, tets[keep])
    assert read_tets(geometry(path)).planes == ()  # sound in itself
    with pytest.raises(BadMesh, match=r"touch at 1 points"):
        read_tets(geometry(path, symmetry=("z",)))


def test_a_plane_may_be_the_flat_face_of_a_label(tmp_path):
    """A label of the cut as well as its axis: the faces are cut anyway."""
    points, tets = octant()
    faces = boundary(tets)
    at_z = (points[faces][:, :, 2] == 0).all(axis=1)
    path = written(tmp_path / "a.vtu", points, tets, triangles=faces, labels=at_z.astype(np.int64))
    both = bilayer(path, symmetry=("x", "y", "z"), facets="facet", cut_facets=(1,))
    once = bilayer(path, symmetry=("x", "y", "z"))
    assert np.array_equal(both.faces, once.faces)
    assert both.cortex is not None
    assert both.cortex.all()
    assert once.cortex is None
    assert replace(once, cortex=both.cortex).edge == both.edge
