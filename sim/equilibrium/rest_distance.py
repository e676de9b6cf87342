"""Distance of a body from rest at its present growth, estimated from its own motion, which costs little time.

A damped body moves slowly in its softest modes. A mode of stiffness over mass w^2, damped at the rate c, moves at
c/2 - sqrt(c^2/4 - w^2) of its distance from rest per unit of time if it creeps (w < c/2), and at w of its amplitude if
it swings. So the speed of a body says how far it is from rest. The softness of the motion follows from Rayleigh's
quotient of the displacement dx and the change da of the accelerations, w^2 = -dx.m da / dx.m dx. For a drift, w^2 is
limited to that of the softest modes of folds (``SOFT_MODE_W2``), which the motion may contain, and to that of the mode
in which a slender body bends (:func:`softest`). Compared with K^-1 f, with the exact stiffness of folded octants, the
distance is right within a factor of three, or too large (docs/solver.md, section 3).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from morphofold.frozen_arrays import Array
from morphofold.geometry import dot, less, position
from morphofold.kernels import kernel
from morphofold.threads import one_blas_thread

if TYPE_CHECKING:
    from morphofold.sim.body import Body

SOFT_MODE_W2 = 0.004  # w^2 of the softest modes of folded bodies, 0.002 to 0.01 [1/tick^2]
REST_SHARE_OF_DISPLACEMENT = 0.01  # a slender body counts as at rest within this share of its whole displacement
LEAST_MOTION_TICKS = 2.0  # least time over which a motion is measured [ticks]: faster motions are vibrations
#: the distance is larger by the factor by which it falls more slowly than assumed, averaged over so long; most factor
TREND_TICKS, MOST_SLOWNESS = 6.0, 3.0
TRIAL_DISPLACEMENT = 1e-3  # trial displacements, over the size of the body
RIGID_MODE_W2 = 1e-6  # stiffness over mass, per tick^2, below which a mode is that of a floating body
SAVED_SCALARS = ("w2", "distance", "left", "mean", "calm", "seen")


class Balance:
    """Measures the distance from rest of one run.

    Parameters
    ----------
    tick : float
        Steps in which a shear wave crosses the cortex (``Body.crossing``).
    X : (N, 3) float64
        Reference positions [mm].
    limit : float
        Distance from rest below which the body counts as at rest [mm]. If its motion is softer than that of folds, as
        in a slender body that bends, the distance must also be below ``REST_SHARE_OF_DISPLACEMENT`` of its displacement
        from X.
    softest : float
        Stiffness over mass of the softest mode in which growth bends the body, from :func:`softest` [1/tick^2].

    Attributes
    ----------
    slender : bool
        Whether that mode is softer than folds.
    w2 : float
        Stiffness over mass along the motion of the last two to four ticks [1/step^2]; negative if the motion leads away
        from rest, 0 if nothing moves and before ``LEAST_MOTION_TICKS``.
    distance : float
        Distance from rest, rms over the nodes [mm]; 0 before ``LEAST_MOTION_TICKS``.
    left : float
        The same, larger by the factor by which ``distance`` falls more slowly than that of the softest mode would:
        near a saddle, and where modes are softer than assumed [mm].
    mean : float
        Mean of ``distance`` since growth stopped, with weights that fall in ``TREND_TICKS`` [mm].
    calm : int
        Number of steps for which the body has been at rest.
    seen : int
        Step of the last call of ``update``.
    """

    def __init__(self, tick: float, X: Array, limit: float, softest: float = SOFT_MODE_W2):
        self._tick, self._X, self._limit = tick, X, limit
        self.slender = softest < SOFT_MODE_W2
        self._softest = min(softest, SOFT_MODE_W2)
        self.w2, self.distance, self.left, self.mean, self.calm, self.seen = 0.0, 0.0, 0.0, 0.0, 0, 0
        self._step = np.full(2, -1)  # steps of two earlier states, the older first; -1: none
        self._x, self._a = np.zeros((2, *X.shape)), np.zeros((2, *X.shape))  # their positions and accelerations

    @property
    def soft(self) -> float:
        """Stiffness over mass of the softest mode that the motion may contain [1/tick^2]."""
        w2 = self.w2 * self._tick**2
        return min(w2, self._softest) if w2 > 0 else self._softest

    def update(self, step: int, x: Array, a: Array, mass: Array, damping: float) -> None:
        """Update the distance from a state of the run.

        Parameters
        ----------
        step : int
        x, a : (N, 3) float64
            Positions [mm], and accelerations there without damping, 0 where a coordinate is fixed [mm/step^2].
        mass : (N,) float64
        damping : float
            Share of the velocity lost per step.
        """
        measured_steps = LEAST_MOTION_TICKS * self._tick
        if self._step[1] >= 0 and step - self._step[1] >= measured_steps:
            self._step[:], self._x[0], self._a[0] = (self._step[1], -1), self._x[1], self._a[1]
        if self._step[0] >= 0 and step - self._step[0] >= measured_steps:
            dx_dx, dx_da, dx_a, dx_rms, from_X = _displacement_products(x, self._x[0], a, self._a[0], self._X, mass)
            self.w2, pull_ratio = (dx_da / dx_dx, abs(dx_a) / dx_dx) if dx_dx > 0 else (0.0, 0.0)
            softest_w2, trend_steps = self.soft / self._tick**2, TREND_TICKS * self._tick
            overdamping = 0.25 * damping**2 - softest_w2
            # speed over distance from rest of the softest mode: of its slower part if it is overdamped
            slowest_rate = 0.5 * damping - overdamping**0.5 if overdamping > 0 else softest_w2**0.5
            creep_ratio = 1 / (step - self._step[0]) / slowest_rate
            self.distance = dx_rms * max(creep_ratio, pull_ratio / (self.w2 if self.w2 > 0 else softest_w2))
            new_weight = min(1.0, (step - self.seen) / trend_steps) if self.mean else 1.0
            self.mean += new_weight * (self.distance - self.mean)
            falling_rate = (1 - self.distance / self.mean) / trend_steps if self.mean else slowest_rate
            self.left = self.distance * min(MOST_SLOWNESS, max(1.0, slowest_rate / max(falling_rate, 1e-9)))
            limit = self._limit if self.soft == SOFT_MODE_W2 else min(self._limit, REST_SHARE_OF_DISPLACEMENT * from_X)
            self.calm = self.calm + step - self.seen if self.distance < limit or self.distance == 0 else 0
        slot = 0 if self._step[0] < 0 else 1
        if self._step[slot] < 0 and (slot == 0 or step - self._step[0] >= measured_steps):
            self._step[slot], self._x[slot], self._a[slot] = step, x, a
        self.seen = step

    def forget(self) -> None:
        """Discard the motion so far, because growth has stopped."""
        self._step[:], self.w2, self.mean, self.calm = -1, 0.0, 0.0, 0

    def save(self) -> dict[str, NDArray[np.generic]]:
        """Arrays for a checkpoint; ``load`` restores them."""
        scalars = {key: np.array(getattr(self, key)) for key in SAVED_SCALARS}
        return scalars | {"step": self._step.copy(), "x": self._x.copy(), "a": self._a.copy()}

    def load(self, arrays: dict[str, NDArray]) -> None:
        """Restore the arrays of ``save``."""
        for key in SAVED_SCALARS:
            setattr(self, key, arrays[key].item())
        self._step, self._x, self._a = (arrays[key].copy() for key in ("step", "x", "a"))


@one_blas_thread()
def softest(body: Body) -> float:
    """Stiffness over mass [1/tick^2] of the softest mode by which growth bends a body as a whole; inf if none does.

    By Ritz's method, before the body grows, with the body's own forces. The displacements are polynomials of second
    degree in position, as in a bent beam, and 0 where a coordinate is fixed; so the result is an upper bound. A mode
    counts if growth by 1 would move the body by more than the thickness of the cortex. (The shift of a sphere on its
    hole is softer than its folds, but growth does not cause it.) Motions of a floating body without energy do not
    count. The body is grown for this and then restored; ``rest`` is measured again.
    """
    X, free, growth = body.X, body.free, body.growth
    half_size = 0.5 * float(np.ptp(X, axis=0).max())
    trial_size, unit_X = TRIAL_DISPLACEMENT * half_size, ((X - X.mean(axis=0)) / half_size).T
    polynomials = np.stack([np.ones(len(X)), *unit_X, *(unit_X[r] * unit_X[s] for r in range(3) for s in range(r, 3))])
    K, M, gram = np.zeros((3, 30, 30))
    is_split = body.split_bulk(False)
    body.grow(1.0)
    for r in range(3):
        free_part, rows = polynomials * free[:, r], slice(10 * r, 10 * r + 10)
        M[rows, rows], gram[rows, rows] = (free_part * body.smooth_mass) @ free_part.T, free_part @ free_part.T / len(X)
        for i, polynomial in enumerate(free_part):
            displacement = np.zeros_like(X)
            displacement[:, r] = trial_size * polynomial
            pull = body.all_forces(X - displacement) - body.all_forces(X + displacement)  # one side alone bends spheres
            K[10 * r + i] = (polynomials @ (pull / (2 * trial_size) * free)).T.ravel()
    body.grow(1.0 + TRIAL_DISPLACEMENT)
    growth_load = (polynomials @ (body.forces(X) * free)).T.ravel() / TRIAL_DISPLACEMENT
    mass_eigenvalues, basis = np.linalg.eigh(M)
    is_usable = mass_eigenvalues > 1e-10 * mass_eigenvalues[-1]
    basis = basis[:, is_usable] / np.sqrt(mass_eigenvalues[is_usable])
    w2, modes = np.linalg.eigh(basis.T @ (K + K.T) @ basis / 2)
    modes = basis @ modes
    is_bending = w2 * body.crossing**2 > RIGID_MODE_W2
    displacements = modes * np.divide(modes.T @ growth_load, w2, out=np.zeros_like(w2), where=is_bending)
    is_bending &= np.sqrt(np.einsum("ik,ij,jk->k", displacements, gram, displacements)) > body.thickness
    body.grow(growth)
    body.split_bulk(is_split)
    if growth == 1:
        body.find_rest()
    return float(np.min(w2 * body.crossing**2, where=is_bending, initial=np.inf))


@kernel
def _displacement_products(x, x0, a, a0, X, mass):
    """dx.m dx, -dx.m da and dx.m a, with dx = x - x0 and da = a - a0; rms over the nodes of dx and of x - X."""
    dx_m_dx, dx_m_da, dx_m_a, sum_dx_squared, sum_from_X_squared = 0.0, 0.0, 0.0, 0.0, 0.0
    for node in range(len(x)):
        x_n, a_n = position(x, node), position(a, node)
        dx, dx_from_X = less(x_n, position(x0, node)), less(x_n, position(X, node))
        dx_squared = dot(dx, dx)
        dx_m_dx += mass[node] * dx_squared
        dx_m_da += mass[node] * dot(dx, less(position(a0, node), a_n))
        dx_m_a += mass[node] * dot(dx, a_n)
        sum_dx_squared += dx_squared
        for r in range(3):
            sum_from_X_squared += dx_from_X[r] ** 2
    return dx_m_dx, dx_m_da, dx_m_a, (sum_dx_squared / len(x)) ** 0.5, (sum_from_X_squared / len(x)) ** 0.5
