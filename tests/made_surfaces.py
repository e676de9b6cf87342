"""What tests of files write: names of every format, a footer, a text; and what they ask of surfaces and errors."""

import numpy as np

from morphofold.shapes import icosphere

FORMATS = ["lh.white", "bare", "a.gii", "a.surf.gii.gz", "a.ply", "a.obj", "a.off", "a.glb", "a.vtp", "a.vtk", "a.vtu"]
FOOTER = {
    "head": np.array([2, 0, 20]),
    "valid": "1  # volume info valid",
    "filename": "../mri/orig.mgz",
    "volume": np.array([256, 256, 256]),
    "voxelsize": np.ones(3),
    "xras": np.array([-1.0, 0.0, 0.0]),
    "yras": np.array([0.0, 0.0, -1.0]),
    "zras": np.array([0.0, 1.0, 0.0]),
    "cras": np.array([-0.5, 29.25, -48.875]),
}
NO_SURFACE = "Dear colleague,\n\nplease find the surface attached.\n" * 40


def area(surface):
    """Sum of the areas of its triangles."""
    a, b, c = np.moveaxis(surface.verts[surface.faces], 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def one_line(error, limit=420):
    """The message of an exception, after seeing that it is one line of readable length."""
    message = str(error.value)
    assert "\n" not in message
    assert len(message) < limit
    return message


def small_sphere():
    """A sphere of 42 vertices as polygons of VTK, with values of its points and of its cells."""
    import pyvista

    verts, faces = icosphere(1, radius=3.0)
    mesh = pyvista.PolyData.from_regular_faces(verts, faces)
    mesh.point_data["a"] = np.arange(20.0 * len(verts)).reshape(-1, 20)
    mesh.cell_data["b"] = np.ones((len(faces), 3), dtype=np.uint8)
    return mesh


def is_small_sphere(surface, atol=1e-5):
    verts, faces = icosphere(1, radius=3.0)
    np.testing.assert_allclose(surface.verts, verts, atol=atol)
    np.testing.assert_array_equal(surface.faces, faces)


def write_legacy_vtk(path, version, binary):
    from vtkmodules.vtkIOLegacy import vtkPolyDataWriter

    writer = vtkPolyDataWriter()
    writer.SetInputData(small_sphere())
    writer.SetFileName(str(path))
    writer.SetFileVersion(version)
    writer.SetFileTypeToBinary() if binary else writer.SetFileTypeToASCII()
    assert writer.Write()
