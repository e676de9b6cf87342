"""Maps and labels of a file of tetrahedra: held nodes, cut facets, thickness, regions, and maps for effects."""

import meshio
import numpy as np
import pytest
from made_octants import HOLE, R, T, bilayer, boundary, mirrored, octant, written
from skfem import MeshTet

from morphofold import read_cortex, simulate
from morphofold.errors import (
    DoesNotApply,
    MissingPart,
    NoCortex,
    NotFinite,
    OptionsClash,
    OutOfRange,
    TooLarge,
    UnknownName,
)
from morphofold.io import read_annotation, write_annotation
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.mesh.checked_tets import COLOUR_STEP
from morphofold.sim.scene.scene_files import load_scene

WALL, BASE = 3, 8  # labels of facets


@pytest.fixture(scope="module")
def whole():
    """Points and tetrahedra of a hollow ball, its boundary, and the radius of the points."""
    points, tets = mirrored(*octant(5))
    return points, tets, boundary(tets), np.linalg.norm(points, axis=1)


def labelled(path, whole, **options):
    """The ball with a label on the facets of its side x > 40, WALL, and on those of its hole, BASE."""
    points, tets, faces, _ = whole
    centre = points[faces].mean(axis=1)
    labels = np.where(np.linalg.norm(centre, axis=1) < R - T, BASE, np.where(centre[:, 0] > 40, WALL, 0))
    return written(path, points, tets, triangles=faces, labels=labels, **options), labels


def nodes_at(b, points):
    """Numbers of points of the file in a bilayer."""
    return {tuple(p) for p in np.round(points, 9).tolist()}, {tuple(p) for p in np.round(b, 9).tolist()}


# held ---------------------------------------------------------------------------------------------------------


def test_a_map_holds_exactly_the_nodes_where_it_is_not_zero(tmp_path, whole):
    points, tets, *_ = whole
    low = points[:, 2] < -35
    path = written(tmp_path / "a.vtu", points, tets, point_data={"stiff": np.where(low, -0.5, 0.0)})
    b = bilayer(path, held_map="stiff")
    np.testing.assert_array_equal(b.held, np.flatnonzero(b.mesh.p[2] < -35))
    both = bilayer(path, held_map="stiff", held="inner")
    hole = np.isclose(np.linalg.norm(both.mesh.p, axis=0), HOLE)
    np.testing.assert_array_equal(both.held, np.flatnonzero(hole | (both.mesh.p[2] < -35)))


@pytest.mark.parametrize("ending", ["vtu", "vtk", "msh", "mesh"])
def test_labels_of_facets_hold_their_nodes_in_every_format(tmp_path, whole, ending):
    points, _, faces, _ = whole
    path, labels = labelled(tmp_path / "a.vtu", whole)
    name = "facet"
    if ending != "vtu":
        mesh = meshio.read(path)
        name = {"msh": "gmsh:physical", "mesh": "medit:ref"}.get(ending, name)
        data = {key: mesh.cell_data["facet"] for key in ([name, "gmsh:geometrical"] if ending == "msh" else [name])}
        path = tmp_path / f"a.{ending}"
        format = {"file_format": "gmsh22"} if ending == "msh" else {}
        meshio.Mesh(mesh.points, mesh.cells, cell_data=data).write(path, **format)
    b = bilayer(path, facets=name, held_facets=(WALL, BASE))
    expected, held = nodes_at(b.mesh.p.T[b.held], points[np.unique(faces[labels > 0])])
    assert held == expected
    assert len(b.held) == len(expected)


def test_held_nodes_of_the_surface_stay_and_others_grow(tmp_path, whole):
    path, _ = labelled(tmp_path / "a.vtu", whole)
    keys = f'shape = "mesh"\nfile = "{path}"\ncortex_thickness = {T}\nfacets = "facet"\nheld_facets = [{WALL}]\n'
    (tmp_path / "a.toml").write_text(f'name = "a"\n[geometry]\n{keys}')
    scene = load_scene(tmp_path / "a.toml")
    body = build_body(scene)
    run = Dynamics(body, [], steps_per_unit=1000)
    run.grow_to(1.03)
    moved = np.linalg.norm(run.state.x - body.X, axis=1)
    assert not moved[body.bilayer.held].any()
    assert (body.bilayer.held < body.n_surface).all()
    assert moved[np.setdiff1d(np.arange(body.n_surface), body.bilayer.held)].min() > 0.01


def test_all_ventricles_are_held(tmp_path):
    """Two holes: what is left when the tetrahedra around two inner nodes are taken out."""
    mesh = MeshTet.init_ball(3)
    points, tets = R * mesh.p.T, mesh.t.T.astype(np.int64)
    holes = [np.linalg.norm(points - [side * 17, 0, 0], axis=1).argmin() for side in (-1, 1)]
    around = [(tets == hole).any(axis=1) for hole in holes]
    walls = [np.setdiff1d(tets[at], [hole]) for at, hole in zip(around, holes)]
    assert not np.intersect1d(*walls).size
    path = written(tmp_path / "a.vtu", points, tets[~(around[0] | around[1])])
    b = bilayer(path, held="inner")
    expected, held = nodes_at(b.mesh.p.T[b.held], points[np.concatenate(walls)])
    assert held == expected
    np.testing.assert_allclose(np.linalg.norm(b.mesh.p[:, : b.n_surface], axis=0), R)
    left = np.zeros(len(points))
    left[walls[0]] = 1
    path = written(tmp_path / "b.vtu", points, tets[~(around[0] | around[1])], point_data={"left": left})
    b = bilayer(path, held_map="left")  # one of them alone
    expected, held = nodes_at(b.mesh.p.T[b.held], points[walls[0]])
    assert held == expected


# facets that are no cortex ------------------------------------------------------------------------------------


def test_cut_facets_stay_in_the_surface_and_are_no_cortex(tmp_path, whole):
    path, _ = labelled(tmp_path / "a.vtu", whole)
    b, every = bilayer(path, facets="facet", cut_facets=(WALL,)), bilayer(path)
    X = b.mesh.p.T
    assert b.n_surface == every.n_surface
    assert len(b.faces) == len(every.faces)
    assert b.closed
    centre = X[b.faces].mean(axis=1)
    np.testing.assert_array_equal(b.cortex, np.isin(np.arange(b.n_surface), b.faces[centre[:, 0] <= 40]))
    assert not b.cortex.all()
    gap = np.linalg.norm(b.white @ X - X[: b.n_surface], axis=1)
    assert gap[b.cortex].min() > 0.85 * T
    assert not b.share[: b.n_surface][X[: b.n_surface, 0] == R].any()
    at = X[b.mesh.t.T].mean(axis=1)
    deep = at[np.linalg.norm(X[b.mesh.t.T], axis=2).max(axis=1) > R - 1e-6]
    grows = at[: len(b.mesh.subdomains["cortex"])]
    assert len(grows) < len(every.mesh.subdomains["cortex"])
    assert grows[:, 0].max() < 46 < deep[:, 0].max()


@pytest.mark.parametrize(
    ("keys", "kind", "numbers"),
    [
        ({"cut_facets": (BASE,)}, DoesNotApply, r"\b200 of 200 triangles\b"),
        ({"cut_facets": (0, WALL)}, NoCortex, r"\b200 faces\b"),
        ({"cut_facets": (7,)}, UnknownName, r"facet = 7.*0 \(\d+\), 3 \(\d+\), 8 \(200\)"),
        ({"held_facets": (7,)}, UnknownName, r"facet = 7"),
        ({"held_facets": (0,), "facets": "mine"}, UnknownName, r"facet.*'mine'"),
        ({"held_map": "none"}, DoesNotApply, r"'none'"),
        ({"held_map": "gap"}, NotFinite, r"'gap'.* 1 of "),
        ({"held_map": "there"}, UnknownName, r"all, none, gap.*'there'"),
        ({"thickness_map": "none"}, OutOfRange, r"0 to 0\b.*\b102 of 102\b"),
        ({"thickness_map": "gap"}, NotFinite, r"'gap'"),
        ({"regions": "gap"}, OutOfRange, r"'gap'"),
        ({"regions": "none"}, MissingPart, r"'none'"),
        ({"regions": "half"}, OutOfRange, r"102 of 102 .* 0\.5\b"),
        ({"regions": "vector"}, UnknownName, r"'vector'"),
    ],
)
def test_maps_and_labels_that_say_nothing_are_refused_with_numbers(tmp_path, whole, keys, kind, numbers):
    points, _, _, r = whole
    n = len(points)
    maps = {
        "all": np.ones(n),
        "none": np.zeros(n),
        "gap": np.ones(n),
        "half": np.full(n, 0.5),
        "vector": np.ones((n, 3)),
    }
    maps["gap"][r.argmax()] = np.nan
    path, _ = labelled(tmp_path / "a.vtu", whole, point_data=maps)
    facets = {"facets": "facet"} if {"cut_facets", "held_facets"} & set(keys) else {}
    with pytest.raises(kind, match=rf"a\.vtu: .*{numbers}"):
        bilayer(path, **{**facets, **keys})


def test_a_file_without_triangles_has_no_labels_of_facets(tmp_path, whole):
    points, tets, *_ = whole
    with pytest.raises(MissingPart):
        bilayer(written(tmp_path / "a.vtu", points, tets), facets="facet", held_facets=(1,))


def test_facets_of_no_tetrahedron_are_refused(tmp_path, whole):
    points, tets, faces, _ = whole
    apart = np.concatenate([points, points[faces[0]] * 2])
    triangles = np.concatenate([faces, [[len(points), len(points) + 1, len(points) + 2]]])
    labels = np.append(np.zeros(len(faces), dtype=np.int64), 5)
    path = written(tmp_path / "a.vtu", apart, tets, triangles=triangles, labels=labels)
    for key in ("held_facets", "cut_facets"):
        with pytest.raises(DoesNotApply, match=r"\b1 of 1 triangles\b"):
            bilayer(path, facets="facet", **{key: (5,)})


@pytest.mark.parametrize("keys", ['facets="a"', "held_facets=[1]", "cut_facets=[1]", 'thickness_map="a"'])
def test_keys_that_need_or_exclude_each_other(keys):
    """The scene ``mesh`` has a label of the cortex."""
    with pytest.raises(OptionsClash, match=keys.split("=")[0]):
        load_scene("mesh", [f"geometry.{keys}"])


# thickness ----------------------------------------------------------------------------------------------------


def test_a_map_multiplies_the_thickness(tmp_path, whole):
    points, tets, *_ = whole
    flat = written(tmp_path / "a.vtu", points, tets, point_data={"t": np.full(len(points), 2.0)})
    doubled, direct = bilayer(flat, thickness_map="t", cortex_thickness=T / 2), bilayer(flat)
    for name in ("share", "radial", "foot", "faces"):
        np.testing.assert_allclose(getattr(doubled, name), getattr(direct, name), atol=1e-12)
    assert np.array_equal(doubled.mesh.t, direct.mesh.t)
    assert abs(doubled.white - direct.white).max() < 1e-9


def test_the_white_surface_follows_the_map(tmp_path):
    error = []
    for refinements in (3, 4):
        mesh = MeshTet.init_ball(refinements)
        points, tets = R * mesh.p.T, mesh.t.T.astype(np.int64)
        path = written(tmp_path / "a.vtu", points, tets, point_data={"t": 1 + 0.4 * points[:, 0] / R})
        b = bilayer(path, thickness_map="t")
        X, n = b.mesh.p.T, len(b.mesh.subdomains["cortex"])
        want = R - T * (1 + 0.4 * X[: b.n_surface, 0] / R)
        error.append(np.abs(np.linalg.norm(b.white @ X, axis=1) - want).max())
        centre = X[b.mesh.t.T].mean(axis=1)
        r = np.linalg.norm(centre, axis=1)
        depth = (R - r) / (1 + 0.4 * centre[:, 0] / r)  # the map counts at the pial point above
        sagitta = b.edge**2 / 6 / R
        assert depth[:n].max() < T + 2 * sagitta
        assert depth[n:].min() > T - 2 * sagitta
    assert error[1] < 0.15 * T
    assert error[1] < 0.6 * error[0]


# maps and regions ---------------------------------------------------------------------------------------------


def test_scalar_point_data_come_over_in_the_order_of_the_nodes(tmp_path, whole):
    points, tets, *_ = whole
    stray = np.concatenate([[[99.0, 99, 99]], points])  # a point that no tetrahedron uses
    maps = {"x": stray[:, 0], "whole": np.arange(len(stray)), "column": stray[:, 1:2], "vector": stray}
    b = bilayer(written(tmp_path / "a.vtu", stray, tets + 1, point_data=maps))
    assert set(b.point_data) == {"x", "whole", "column"}
    np.testing.assert_array_equal(b.point_data["x"], b.mesh.p[0])
    np.testing.assert_array_equal(b.point_data["column"], b.mesh.p[1])
    np.testing.assert_array_equal(stray[b.point_data["whole"].astype(int)], b.mesh.p.T)
    assert all(values.dtype == np.float64 for values in b.point_data.values())


def test_point_data_name_regions(tmp_path, whole):
    points, tets, *_ = whole
    label = np.select([points[:, 0] > 20, points[:, 0] < -20], [300, 12], 0)
    path = written(tmp_path / "a.vtu", points, tets, point_data={"lobe": label.astype(np.float64)})
    b = bilayer(path, regions="lobe")
    x = b.mesh.p[0, : b.n_surface]
    assert b.regions.names == ("region 12", "region 300")
    np.testing.assert_array_equal(b.regions.labels, np.select([x > 20, x < -20], [1, 0], -1))
    write_annotation(tmp_path / "lh.aparc.annot", b.regions)
    back = read_annotation(tmp_path / "lh.aparc.annot")
    assert back.names == b.regions.names
    np.testing.assert_array_equal(back.labels, b.regions.labels)
    assert bilayer(path).regions is None


def test_labels_of_tetrahedra_name_regions_by_the_most_around_a_vertex(tmp_path, whole):
    points, tets, *_ = whole
    label = np.random.default_rng(3).integers(1, 4, len(tets))
    b = bilayer(written(tmp_path / "a.vtu", points, tets, cell_data={"lobe": label}), regions="lobe")
    number = {tuple(p): k for k, p in enumerate(points.tolist())}
    for vertex, region in enumerate(b.regions.labels):
        labels = label[(tets == number[tuple(b.mesh.p[:, vertex])]).any(axis=1)]
        assert b.regions.names[region] == f"region {np.bincount(labels).argmax()}"  # the smallest of equally many


def test_each_label_has_its_own_colour():
    labels = np.arange(1, 2**24, 997)
    assert len(np.unique(labels * COLOUR_STEP % 2**24)) == len(labels)
    assert (labels * COLOUR_STEP % 2**24).min() > 0


def test_numbers_of_points_are_no_parcellation(tmp_path):
    points, tets = mirrored(*octant(17))
    with pytest.raises(TooLarge, match=r"\b1,158 labels\b.*\b1,000\b"):
        bilayer(written(tmp_path / "a.vtu", points, tets, point_data={"n": np.arange(len(points)) + 1}), regions="n")


# the run ------------------------------------------------------------------------------------------------------


def test_a_refused_file_leaves_nothing_behind(tmp_path, whole):
    path, _ = labelled(tmp_path / "a.vtu", whole)
    keys = f'shape = "mesh"\nfile = "{path}"\ncortex_thickness = {T}\n'
    for name, more in (("a", 'held_map = "there"'), ("b", 'symmetry = ["x"]'), ("c", 'regions = "there"')):
        (tmp_path / f"{name}.toml").write_text(f'name = "{name}"\n[geometry]\n{keys}{more}\n')
        with pytest.raises(ValueError, match=r"a\.vtu: "):
            simulate(tmp_path / f"{name}.toml", tmp_path / name)
        assert not (tmp_path / name).exists()


def test_a_scene_with_all_of_it_grows(tmp_path):
    """Half of a ball with a cut side, held hole, regions and a thickness map, written and read again."""
    points, tets = mirrored(*octant(4), axes=(0, 1))
    faces = boundary(tets)
    wall = (points[faces].mean(axis=1)[:, 0] > 38).astype(np.int64)
    maps = {"t": 1 + 0.1 * points[:, 0] / R, "lobe": np.where(points[:, 1] > 0, 2, 1)}
    path = written(tmp_path / "a.vtu", points, tets, maps, triangles=faces, labels=wall)
    keys = f'shape = "mesh"\nfile = "{path}"\ncortex_thickness = {T}\nsymmetry = ["z"]\nheld = "inner"\n'
    keys += 'facets = "facet"\ncut_facets = [1]\nthickness_map = "t"\nregions = "lobe"\n[effects.contact]\n'
    (tmp_path / "a.toml").write_text(f'name = "a"\n[geometry]\n{keys}')
    simulate(tmp_path / "a.toml", tmp_path / "a", settings=["growth.final=1.02", "growth.rate=4.0"])
    cortex = read_cortex(tmp_path / "a")
    assert cortex.portion == 0.5
    assert len(cortex.faces) == 2 * cortex.n_vertices - 4
    assert np.linalg.norm(cortex.pial.verts, axis=1).mean() > R
