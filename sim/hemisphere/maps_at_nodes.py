"""Maps of a scene at the nodes of its body: from a file on a sphere, or from the point data of a mesh file."""

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.arrays import Array
from morphofold.errors import MissingPart, NotFinite, UnknownName
from morphofold.sim.hemisphere.sphere_maps import SmoothMap, read_map, smooth_map
from morphofold.sim.hemisphere.subject import subject_of_cortex
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.scene import MeshFile, UnfoldedCortex
from morphofold.sim.scene.geometries import map_files
from morphofold.sim.scene.tables import SphereMap

AREA_RATIO = "area_ratio"  # the name of the subject's own map of areas, folded over unfolded


class MapAtNodes:
    """The map of a table of a scene; it is read when it is needed.

    Parameters
    ----------
    table : SphereMap
    geometry
        That of the scene.
    name : str
        Of the table, for messages.
    positive : bool
        Whether values of 0 and less on a sphere are no values.
    """

    def __init__(self, table: SphereMap, geometry: Any, name: str, *, positive: bool = False):
        self._table, self._geometry, self._name, self._positive = table, geometry, name, positive

    @property
    def _own_areas(self) -> bool:
        return isinstance(self._geometry, UnfoldedCortex) and self._table.file == AREA_RATIO

    @property
    def files(self) -> dict[str, Path]:
        """The files to read, by content; those of the subject or the mesh aside."""
        if isinstance(self._geometry, MeshFile) or self._own_areas:
            return {}
        return map_files(self._table, self._geometry, self._name)

    @cached_property
    def on_sphere(self) -> SmoothMap | None:
        """The map on the unit sphere; None if it is point data of a mesh."""
        if isinstance(self._geometry, MeshFile):
            return None
        if not self._own_areas:
            return read_map(self._table, self._geometry, positive=self._positive)
        subject = subject_of_cortex(self._geometry)
        return smooth_map(subject.unfolding.area_ratio(), subject.vertices(), self._table.degree, AREA_RATIO)

    @property
    def mean(self) -> float:
        """Mean over the cortex; 1 for point data."""
        return 1.0 if self.on_sphere is None else self.on_sphere.mean

    def at(self, bilayer: Bilayer) -> Array:
        """Values at the nodes (N,): the same at all depths, unless they are point data."""
        if self.on_sphere is not None:
            if bilayer.sphere is None:
                raise MissingPart(f"{self._table.file}: is a map on a sphere, but this body has none. Leave it out.")
            return np.tile(self.on_sphere(bilayer.sphere), len(bilayer.share) // bilayer.n_surface)
        values = bilayer.point_data.get(self._table.file)
        if values is None:
            known = ", ".join(sorted(bilayer.point_data)) or "none"
            raise UnknownName(f"{self._name}: the mesh has no point data {self._table.file!r}; it has {known}.")
        if not np.isfinite(values).all():
            raise NotFinite(
                f"{self._name}: {self._table.file!r} is not finite at {int((~np.isfinite(values)).sum()):,} of "
                f"{len(values):,} nodes. Give every node a number."
            )
        return values
