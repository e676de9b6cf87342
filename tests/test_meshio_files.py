"""What morphofold needs of meshio: meshes and their values come back as they were written."""

import numpy as np
import pytest

from morphofold.io.meshio_files import Mesh, read_mesh, write_mesh

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1.1]]) / 3
TETS = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])


@pytest.mark.parametrize("ending", [".vtu", ".vtk", ".msh", ".mesh", ".inp"])
def test_tetrahedra_come_back(tmp_path, ending):
    file = tmp_path / f"body{ending}"
    write_mesh(file, Mesh(POINTS, [("tetra", TETS)]))
    mesh = read_mesh(file, file.read_bytes())
    np.testing.assert_allclose(mesh.points, POINTS, rtol=1e-15)
    assert np.array_equal(mesh.get_cells_type("tetra"), TETS)


@pytest.mark.parametrize("kind", ["tetra", "hexahedron"])
def test_a_volume_comes_back_to_the_last_bit_with_its_fields(tmp_path, rng, kind):
    points, corners = rng.standard_normal((9, 3)), np.arange(4 if kind == "tetra" else 8)[None]
    fields = {"reference": rng.standard_normal((9, 3)), "x": rng.standard_normal(9)}
    stress = rng.standard_normal((1, 6)).astype(np.float32)
    file = tmp_path / "volume.vtu"
    write_mesh(file, Mesh(points, [(kind, corners)], fields, {"stress": [stress]}), compression=None)
    mesh = read_mesh(file)
    assert mesh.points.tobytes() == points.tobytes()
    assert {name: values.tobytes() for name, values in mesh.point_data.items()} == {
        name: values.tobytes() for name, values in fields.items()
    }
    assert mesh.cell_data["stress"][0].tobytes() == stress.tobytes()
