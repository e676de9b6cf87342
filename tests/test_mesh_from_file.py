import meshio
import numpy as np
import pytest
from made_octants import HOLE, R, T, tets_between
from skfem import MeshTet

from morphofold.errors import (
    BadMesh,
    DoesNotApply,
    ImpossibleBody,
    NoCortex,
    NotFinite,
    TooLarge,
    UnknownName,
    WrongFile,
    WrongShape,
)
from morphofold.io import write_surface
from morphofold.shapes import icosphere
from morphofold.sim.mesh import tet_files
from morphofold.sim.mesh.checked_tets import read_tets
from morphofold.sim.mesh.from_file import bilayer_from_file
from morphofold.sim.scene import MeshFile
from morphofold.surface import Surface


def shell(level=3, stretch=(1.0, 1.0, 1.0), thickness=T):
    """A hollow ball (or ellipsoid) in layers, three of them the cortex, with a label per tetrahedron."""
    verts, faces = icosphere(level)
    pial = R * verts
    white = pial * (1 - np.reshape(thickness, (-1, 1)) / R)
    levels = [pial + s * (white - pial) for s in (0, 1 / 3, 2 / 3, 1)]
    levels += [white + s * (HOLE * verts - white) for s in (0.2, 0.45, 0.7, 1.0)]
    points, tets = tets_between(np.array(levels) * stretch, faces)
    return points, tets, (np.arange(len(tets)) < 9 * len(faces)).astype(np.int64)


def ball(refinements):
    """A whole ball whose tetrahedra know nothing of layers."""
    mesh = MeshTet.init_ball(refinements)
    return R * mesh.p.T, mesh.t.T.astype(np.int64)


def write(path, points, tets, layer=None, others=()):
    data = {} if layer is None else {"layer": [layer]}
    meshio.Mesh(points, [("tetra", tets), *others], cell_data=data).write(path)
    return path


def bilayer(path, points=None, tets=None, layer=None, **options):
    if points is not None:
        write(path, points, tets, layer)
    named = {"label": "layer"} if layer is not None else {}
    return bilayer_from_file(MeshFile(shape="mesh", file=str(path), **{"cortex_thickness": T, **named, **options}))


def degrees(a, b):
    return np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", a, b), -1, 1)))


def outwards(x):
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def volumes(body):
    """Six times the volumes of the tetrahedra."""
    corners = body.mesh.p.T[body.mesh.t.T]
    return np.linalg.det(corners[:, 1:] - corners[:, :1])


@pytest.fixture(scope="module")
def balls(tmp_path_factory):
    """Balls of 4,096 and 32,768 tetrahedra, layered by depth."""
    folder = tmp_path_factory.mktemp("balls")
    return [bilayer(folder / f"{n}.vtu", *ball(n)) for n in (3, 4)]


def test_the_layers_of_a_ball_are_where_depth_says(balls):
    for b in balls:
        X, n = b.mesh.p.T, b.n_surface
        r = np.linalg.norm(X, axis=1)
        np.testing.assert_allclose(r[:n], R)  # pial nodes come first
        assert r[n:].max() < R - 1
        depth = R - np.linalg.norm(X[b.mesh.t.T].mean(axis=1), axis=1)
        n_cortex = len(b.mesh.subdomains["cortex"])
        assert np.array_equal(b.mesh.subdomains["cortex"], np.arange(n_cortex))
        sagitta = b.edge**2 / 6 / R  # flat faces lie below the sphere by less
        assert depth[:n_cortex].max() < T + sagitta
        assert depth[n_cortex:].min() > T - 1e-9
        assert (len(b.held), b.closed) == (0, True)
        a, c, d = (X[b.faces[:, k]] for k in range(3))
        filled = volumes(b)
        assert filled.min() > 0
        assert np.einsum("ij,ij->", a, np.cross(c, d)) == pytest.approx(filled.sum())  # faces look outwards
        assert len(b.faces) == 2 * n - 4  # Euler: closed, of one piece, no handle


def test_thickness_direction_white_surface_and_share_of_a_ball_converge(balls):
    angle, error = [], []
    for b in balls:
        r = np.linalg.norm(b.mesh.p.T, axis=1)
        out, within = outwards(np.where(r[:, None] > 0, b.mesh.p.T, 1.0)), r > R - T
        np.testing.assert_allclose(np.linalg.norm(b.radial, axis=1), 1)
        angle.append(degrees(b.radial, out)[within].max())
        assert np.abs(b.share - np.clip(1 - (R - r) / T, 0, 1)).max() < b.edge**2 / 6 / R / T  # second order
        assert np.linalg.norm(b.foot - R * out, axis=1)[within].max() < 0.05 * b.edge
        assert (b.share[: b.n_surface].min(), b.share.min()) == (1, 0)
        white = b.white @ b.mesh.p.T
        error.append(np.abs(np.linalg.norm(white, axis=1) - (R - T)).max())
        assert degrees(outwards(white), out[: b.n_surface]).max() < 1
        assert (abs(b.white.sum(axis=1) - 1).max() < 1e-12, b.white.min() >= 0) == (True, True)
    assert angle[1] < 0.8
    assert angle[1] < 0.7 * angle[0]  # first order in the edge
    assert error[1] < 0.1 * T
    assert error[1] < 0.5 * error[0]


def test_label_and_depth_agree_on_a_layered_shell(tmp_path):
    points, tets, label = shell()
    a, b = bilayer(tmp_path / "a.vtu", points, tets, label), bilayer(tmp_path / "b.vtu", points, tets)
    assert np.array_equal(a.mesh.t, b.mesh.t)
    assert np.array_equal(a.mesh.p, b.mesh.p)
    for name in ("radial", "foot"):
        np.testing.assert_allclose(getattr(a, name)[b.share > 0], getattr(b, name)[b.share > 0], atol=1e-12)
    np.testing.assert_allclose(a.share, b.share, atol=0.02)
    assert np.linalg.norm((a.white - b.white) @ a.mesh.p.T, axis=1).max() < 0.02 * T


def test_the_white_surface_of_a_label_is_its_boundary_wherever_that_lies(tmp_path):
    depth = lambda directions: T * (1 + 0.4 * directions[:, 0])
    points, tets, label = shell(4, thickness=depth(icosphere(4)[0]))
    b = bilayer(tmp_path / "a.vtu", points, tets, label)
    X, white = b.mesh.p.T, np.linalg.norm(b.white @ b.mesh.p.T, axis=1)
    np.testing.assert_allclose(white, R - depth(outwards(X[: b.n_surface])), atol=0.03 * T)
    assert len(b.mesh.subdomains["cortex"]) == label.sum()
    border = np.abs(np.linalg.norm(X, axis=1) - (R - depth(outwards(X)))) < 1e-6
    assert border.sum() == b.n_surface
    assert np.array_equal(b.share[border], np.zeros(border.sum()))
    inside = np.unique(b.mesh.t[:, : label.sum()])
    assert (b.share[np.setdiff1d(inside, np.flatnonzero(border))] > 0.2).all()


def test_where_a_label_puts_no_cortex_white_and_pial_are_one(tmp_path):
    points, tets, label = shell()
    b = bilayer(tmp_path / "a.vtu", points, tets, np.where(points[tets].mean(axis=1)[:, 2] < -20, 0, label))
    X = b.mesh.p.T[: b.n_surface]
    gap = np.linalg.norm(b.white @ b.mesh.p.T - X, axis=1)
    assert gap[X[:, 2] < -30].max() < 1e-9
    assert gap[X[:, 2] > 0].min() > 0.9 * T


def test_the_white_surface_of_an_ellipsoid_is_its_offset(tmp_path):
    stretch = np.array([1.3, 1.0, 0.8])
    points, tets, _ = shell(4, stretch)
    b = bilayer(tmp_path / "a.vtu", points, tets)
    X = b.mesh.p.T[: b.n_surface]
    normal = outwards(X / stretch**2)
    assert degrees(b.radial[: b.n_surface], normal).max() < 1
    white = b.white @ b.mesh.p.T
    assert np.linalg.norm(white - (X - T * normal), axis=1).max() < 0.05 * T


def test_a_hollow_can_be_held_and_corners_may_come_in_any_order(tmp_path):
    points, tets, _ = shell()
    mixed = tets.copy()
    mixed[::2] = mixed[::2, [1, 0, 2, 3]]
    free, held = bilayer(tmp_path / "a.vtu", points, mixed), bilayer(tmp_path / "b.vtu", points, tets, held="inner")
    assert not len(free.held)
    r = np.linalg.norm(held.mesh.p, axis=0)
    assert np.array_equal(np.flatnonzero(np.isclose(r, HOLE)), held.held)
    assert np.linalg.norm(free.mesh.p.T[free.faces], axis=-1).min() > R - 1e-6
    assert min(volumes(free).min(), volumes(held).min()) > 0


def test_units_are_scaled_to_mm_and_stray_points_left_out(tmp_path):
    points, tets, _ = shell()
    mm = bilayer(tmp_path / "a.vtu", points, tets)
    m = bilayer(tmp_path / "b.vtu", np.concatenate([[[9.0, 9.0, 9.0]], points / 1000]), tets + 1, scale=1000.0)
    np.testing.assert_allclose(m.mesh.p, mm.mesh.p, atol=1e-9)
    assert np.array_equal(m.mesh.t, mm.mesh.t)


@pytest.mark.parametrize("ending", ["vtk", "msh", "mesh"])
def test_formats_of_meshio_all_give_the_same_body_whose_neighbours_are_across_each_face(tmp_path, ending):
    plain = write(tmp_path / "a.vtu", *ball(1))
    path = write(tmp_path / f"a.{ending}", *ball(1), others=[("triangle", [[0, 1, 2]])])
    body, expected = (read_tets(MeshFile(shape="mesh", file=str(p))) for p in (path, plain))
    np.testing.assert_allclose(body.points, expected.points, atol=1e-12)
    for name in ("tets", "across", "kind"):
        assert np.array_equal(getattr(body, name), getattr(expected, name)), name
    for e, tet in enumerate(body.tets):
        for k in range(4):
            face = set(np.delete(tet, k))
            across = [other for other, corners in enumerate(body.tets) if other != e and face <= set(corners)]
            assert [body.across[e, k]] == (across or [-1])


def pyramid(*corners):
    """Tetrahedra of an octahedron around the origin (point 0), apart from the octants left out."""
    points = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)]) * R
    octants = {(s, t, u) for s in (1, 4) for t in (2, 5) for u in (3, 6)} - set(corners)
    return points, np.array([(0, *octant) for octant in sorted(octants)])


def broken(kind):
    points, tets, _ = shell(1)
    if kind == "two bodies":
        return np.concatenate([points, points + [200, 0, 0]]), np.concatenate([tets, tets + len(points)])
    if kind == "flat":
        points[tets[0, 3]] = points[tets[0, :3]].mean(axis=0)
    if kind == "not finite":
        points[7] = np.nan
    if kind == "pinched at an edge":  # opposite octants left out share an axis
        return pyramid((1, 2, 3), (4, 5, 3))
    if kind == "pinched at a point":
        return pyramid((1, 2, 3), (4, 5, 6))
    if kind == "three at a face":
        points = np.concatenate([points, [points[tets[0]].mean(axis=0) * 1.01]])
        tets = np.concatenate([tets, [[*tets[0, 1:], len(points) - 1]]])
    if kind == "tangled":
        points, tets = ball(2)
        points[np.linalg.norm(points, axis=1).argmin()] = [0.7 * R, 0, 0]
    return points, tets


@pytest.mark.parametrize(
    ("problem", "kind", "numbers"),
    [
        ("two bodies", BadMesh, r"\b2 .*\b1,680, 1,680\b"),
        ("flat", BadMesh, r"\b1 of 1,680\b.*\b0\b"),
        ("not finite", NotFinite, r"points: 1 of 336\b"),
        ("pinched at an edge", BadMesh, r"\b1 edges\b"),
        ("pinched at a point", BadMesh, r"\b1 points\b"),
        ("three at a face", BadMesh, r"\[\d+, \d+, \d+\]"),
        ("tangled", BadMesh, r"\b48\d{4} mm3\b.*\b47\d{4}\b"),
    ],
)
def test_a_body_that_is_none_is_refused_with_numbers(tmp_path, problem, kind, numbers):
    with pytest.raises(kind, match=rf"a\.vtu: .*{numbers}"):
        bilayer(tmp_path / "a.vtu", *broken(problem))


@pytest.mark.parametrize(
    ("name", "options", "kind", "message"),
    [
        ("a.vtu", {"cortex_thickness": 40.0}, ImpossibleBody, r"\b40 mm\b.*\b23\.6 mm\b.*\bcortex_thickness\b"),
        ("a.vtu", {"label": "tissue"}, UnknownName, r"geometry\.label\b.*\blayer\b.*'tissue'"),
        ("a.vtu", {"label": "layer", "cortex_label": 7}, NoCortex, r"\blayer = 7\b.*\b0 \(960\), 1 \(720\)"),
        ("solid.vtu", {"held": "inner"}, DoesNotApply, r"geometry\.held = 'inner'"),
        ("columns.vtu", {"label": "layer"}, WrongShape, r"'layer'.*\(1680, 3\)"),
        ("hex.vtu", {}, WrongFile, r"\b1 hexahedron\b"),
        ("tri.vtu", {}, WrongFile, r"\b1,680 triangles\b"),
        ("a.stuff", {}, WrongFile, r"'\.stuff'"),
        ("none.vtu", {}, FileNotFoundError, ""),
        ("large.vtu", {}, TooLarge, r"\b6,720\b.*\b2,000\b"),
    ],
)
def test_files_that_make_no_body_are_refused_with_numbers(tmp_path, monkeypatch, name, options, kind, message):
    points, tets, label = shell(1)
    write(tmp_path / "a.vtu", points, tets, label)
    write(tmp_path / "columns.vtu", points, tets, np.ones((len(tets), 3)))
    write(tmp_path / "solid.vtu", *ball(2))
    write(tmp_path / "large.vtu", *shell(2))
    meshio.Mesh(np.eye(8)[:, :3], [("hexahedron", [range(8)])]).write(tmp_path / "hex.vtu")
    meshio.Mesh(points, [("triangle", tets[:, :3])]).write(tmp_path / "tri.vtu")
    (tmp_path / "a.stuff").write_text("mine")
    monkeypatch.setattr(tet_files, "MOST_BRICKS", 2000)
    with pytest.raises(kind, match=rf"{name}: .*{message}"):
        bilayer(tmp_path / name, **options)


@pytest.mark.parametrize("name", ["lh.white", "a.vtu"])
def test_a_surface_is_refused_and_the_shape_and_the_command_for_it_are_named(tmp_path, name):
    write_surface(tmp_path / name, Surface(*icosphere(1)))
    with pytest.raises(WrongFile, match=rf"{name}: .*geometry\.shape = 'cortex'.*\bsubject\b.*`morphofold unfold`"):
        bilayer(tmp_path / name)
