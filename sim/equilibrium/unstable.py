"""Number of unstable modes of a state: negative eigenvalues of the exact stiffness, contact included.

Residual forces do not distinguish stable from unstable states: they are small in both. The number of negative
eigenvalues does; a symmetric factorisation counts them exactly (Sylvester's law of inertia).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from morphofold.sim.equilibrium.rest import SOFT_MODE_W2
from morphofold.sim.equilibrium.sparse_factor import Dissection, Factor
from morphofold.sim.equilibrium.tangent import Tangent

if TYPE_CHECKING:
    from morphofold.sim.dynamics import Dynamics


def unstable_modes(run: Dynamics, softer_than: float = -SOFT_MODE_W2) -> int:
    """Number of modes of a run's state with less stiffness over mass than ``softer_than`` [1/tick^2].

    By default these are modes that grow e-fold within 36 ticks, in which growth would rise by 0.2. Slower modes are
    left out: some of them are held by contact at the edge of its range.

    Notes
    -----
    Contact is included with the pairs that press now, those beside them, and the stiffness of its penalty; the rotation
    of its forces with the surface is left out. The time is that of 200 (strips) to 1,500 steps (octants). Memory grows
    as the number of nodes on the surface, times its logarithm, times the square of the number of nodes below each.
    """
    body, x = run.body, run.state.x
    rows = np.flatnonzero(body.free)
    tangent = Tangent(body)
    pressing = sparse.csr_matrix((x.size, x.size))
    for effect in run.effects:
        pressing = pressing + effect.stiffness(body, x)
    shift = sparse.diags(np.repeat(body.smooth_mass, 3) * softer_than / body.crossing**2)
    matrix = sparse.csr_matrix(sparse.csr_matrix(tangent.at(x) + pressing - shift)[rows][:, rows])
    links = sparse.coo_matrix(pressing)
    beside = sparse.csr_matrix((np.ones(links.nnz), (links.row // 3, links.col // 3)), shape=(len(x), len(x)))
    beside.data[:] = 1.0
    graph = sparse.csr_matrix(tangent.graph().maximum(beside))
    return Factor(Dissection(x, graph, rows, matrix), matrix).negative
