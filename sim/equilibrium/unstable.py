"""How many modes a run would leave its state by: negative eigenvalues of the exact stiffness, contact in it.

Residual forces do not tell a state that is stable from one that is not: both are small. The number of negative
eigenvalues does, which a symmetric factorisation counts exactly (Sylvester's law of inertia).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from morphofold.sim.equilibrium.rest import SOFT
from morphofold.sim.equilibrium.sparse_factor import Dissection, Factor
from morphofold.sim.equilibrium.tangent import Tangent

if TYPE_CHECKING:
    from morphofold.sim.dynamics import Dynamics


def unstable_modes(run: Dynamics, softer_than: float = -SOFT) -> int:
    """Modes of a run's state with less stiffness over mass than ``softer_than`` [1/tick^2].

    By default those that grow e-fold within 36 ticks, in which growth would rise by 0.2. Slower ones are left out:
    modes that contact holds at the edge of its reach are among them.

    Notes
    -----
    Contact counts with the pairs that press now and the stiffness of its penalty; that its forces turn with the surface
    is left out. It takes as long as 200 (strips) to 1,500 steps (octants). Memory grows as the number of nodes on the
    surface, times its logarithm, times the square of the number of nodes below each.
    """
    body, x = run.body, run.state.x
    rows = np.flatnonzero(body.free)
    tangent = Tangent(body)
    pressing = sparse.csr_matrix((x.size, x.size))
    for effect in run.effects:
        pressing = pressing + effect.stiffness(body, x)
    shift = sparse.diags(np.repeat(body.mass, 3) * softer_than / body.crossing**2)
    matrix = sparse.csr_matrix(sparse.csr_matrix(tangent.at(x) + pressing - shift)[rows][:, rows])
    links = sparse.coo_matrix(pressing)
    beside = sparse.csr_matrix((np.ones(links.nnz), (links.row // 3, links.col // 3)), shape=(len(x), len(x)))
    beside.data[:] = 1.0
    graph = sparse.csr_matrix(tangent.graph().maximum(beside))
    return Factor(Dissection(x, graph, rows, matrix), matrix).negative
