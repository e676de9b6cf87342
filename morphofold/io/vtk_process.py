"""A script: VTK reads the file that is named, and its points, cells and their data go to standard output as npz."""

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
    grid = to_grid.GetOutput()
    arrays = {
        "points": grid.GetPoints().GetData(),
        "connectivity": grid.GetCells().GetConnectivityArray(),
        "offsets": grid.GetCells().GetOffsetsArray(),
        "types": grid.GetCellTypesArray(),
    }
    for kind, data in (("point", grid.GetPointData()), ("cell", grid.GetCellData())):
        arrays |= {f"{kind} {data.GetArrayName(k)}": data.GetArray(k) for k in range(data.GetNumberOfArrays())}
    np.savez(sys.stdout.buffer, **{name: vtk_to_numpy(array) for name, array in arrays.items() if array is not None})
