"""Contact of the pial surface with its mirror image: nodes stay half a gap away from a symmetry plane."""

from morphofold.sim.body import Body
from morphofold.sim.effects import contact
from morphofold.sim.rigid_shells import PlaneShell
from morphofold.sim.rigid_walls import RigidWalls


class Symmetry(RigidWalls):
    """Keeps nodes from crossing the symmetry planes; ``Body`` holds the nodes that lie on them."""

    def prepare(self, body: Body) -> None:
        ungrown_x = body.bilayer.mesh.p[:, : body.n_surface]
        self.shells = [PlaneShell(plane, ungrown_x[plane.axis] == plane.at) for plane in body.bilayer.planes]

    def gap(self, body: Body) -> float:
        return -0.5 * contact.GAP_IN_CELLS * body.cell
