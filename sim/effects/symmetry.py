"""Contact of the pial surface with its mirror image: nodes stay half a gap away from a symmetry plane."""

import numpy as np

from morphofold.arrays import Bools
from morphofold.sim.body import Body
from morphofold.sim.effects import contact
from morphofold.sim.mesh.brick_mesh import Plane
from morphofold.sim.rigid_planes import RigidPlanes


def build(options, scene) -> "Symmetry":
    return Symmetry()


class Symmetry(RigidPlanes):
    """Keeps nodes from crossing the symmetry planes; ``Body`` holds the nodes that lie on them."""

    name = "symmetry"

    def find_planes(self, body: Body) -> list[tuple[Plane, Bools]]:
        first = body.bilayer.mesh.p[:, : body.n_surface]
        return [(plane, np.ascontiguousarray(first[plane.axis] == plane.at)) for plane in body.bilayer.planes]

    def gap(self, body: Body) -> float:
        return 0.5 * contact.GAP_IN_CELLS * body.cell
