"""Run by ``mesh_files.read_vtk`` in a process of its own, because VTK ends its process on some damaged files.

The path of a VTK file is the argument; points, connectivity, offsets and types of cells go to standard output as npz.
"""

import sys

import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkFiltersCore import vtkAppendFilter
from vtkmodules.vtkIOLegacy import vtkGenericDataObjectReader
from vtkmodules.vtkIOXML import vtkXMLGenericDataObjectReader

if __name__ == "__main__":
    with open(sys.argv[1], "rb") as file:
        reader = vtkGenericDataObjectReader() if file.read(5) == b"# vtk" else vtkXMLGenericDataObjectReader()
    reader.SetFileName(sys.argv[1])
    to_grid = vtkAppendFilter()
    to_grid.AddInputConnection(reader.GetOutputPort())
    to_grid.Update()
    grid, cells = to_grid.GetOutput(), to_grid.GetOutput().GetCells()
    parts = grid.GetPoints().GetData(), cells.GetConnectivityArray(), cells.GetOffsetsArray(), grid.GetCellTypesArray()
    np.savez(sys.stdout.buffer, *map(vtk_to_numpy, parts))
