"""How far a body is from rest at its present growth, told by its own motion: it costs nothing.

What moves a damped body slowly is its softest modes. Such a mode, of stiffness over mass w^2, creeps at w^2 / c of its distance
from rest per unit of time, c being the rate of damping: a body that drifts at the speed s has c s / w^2 left to go. How soft
the motion is tells Rayleigh's quotient of the way dx that the body went and of the change da of its accelerations,
w^2 = -dx.m da / dx.m dx. It is never taken to be stiffer than the softest modes of folded bodies are (``SOFT``): a body that
shakes is so seen to drift as well. Held against K^-1 f with the exact stiffness of octants at rest, the distance is right within a
factor of three, and rather too large (docs/solver.md, section 4). A mode that is driven away from rest is seen as soon as it moves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SOFT = 0.005            # w^2 of the softest modes of folded bodies, 0.002 to 0.01 [1/tick^2]
NEAR_SHARE = 0.01       # of the way that a body has moved at all: how near to rest it has to be, too
LONG = 2.0              # least time over which a motion is looked at [ticks]: faster ones shake and go nowhere
SCALARS = ("w2", "distance", "calm", "seen")


class Balance:
    """The gauge of one run.

    Parameters
    ----------
    tick : float
        Steps in which a shear wave crosses the cortex (``Body.crossing``).
    nodes : int
        Of the body.

    Attributes
    ----------
    near : float
        Distance from rest below which the body is calm [mm].

    Attributes
    ----------
    w2 : float
        Stiffness over mass along the motion of the last two to four ticks [1/step^2]; negative where the motion is driven
        away from rest, 0 where nothing moves and before ``LONG``.
    distance : float
        From rest, rms over the nodes [mm]; 0 before ``LONG``.
    calm : int
        Steps since the body was not calm.
    """

    def __init__(self, tick: float, X: Array, near: float):
        self._tick, self._X, self._near = tick, X, near
        self.w2, self.distance, self.calm, self.seen = 0.0, 0.0, 0, 0
        self._step = np.full(2, -1)                                     # of two states before, the older first, -1: none,
        self._x, self._a = np.zeros((2, *X.shape)), np.zeros((2, *X.shape))     # their positions and accelerations

    @property
    def soft(self) -> float:
        """Stiffness over mass of the softest mode that may be moving [1/tick^2]."""
        w2 = self.w2 * self._tick**2
        return min(w2, SOFT) if w2 > 0 else SOFT

    def look(self, step: int, x: Array, a: Array, mass: Array, damping: float) -> None:
        """Take a state of the run.

        Parameters
        ----------
        step : int
        x, a : (N, 3) float64
            Positions [mm], and accelerations there without damping, 0 where nothing may move [mm/step^2].
        mass : (N,) float64
        damping : float
            Share of the velocity lost per step.
        """
        long = LONG * self._tick
        if self._step[1] >= 0 and step - self._step[1] >= long:
            self._step[:], self._x[0], self._a[0] = (self._step[1], -1), self._x[1], self._a[1]
        if self._step[0] >= 0 and step - self._step[0] >= long:
            dx = x - self._x[0]
            squares = _product(mass, dx, dx)
            self.w2 = _product(mass, dx, self._a[0] - a) / squares if squares > 0 else 0.0
            pull = max(abs(_product(mass, dx, a)) / squares, damping / (step - self._step[0])) if squares > 0 else 0.0
            self.distance = pull * _rms(dx) * self._tick**2 / self.soft
            calm = self.distance < self._near and self.distance < NEAR_SHARE * _rms(x - self._X)
            self.calm = self.calm + step - self.seen if calm or self.distance == 0 else 0
        k = 0 if self._step[0] < 0 else 1
        if self._step[k] < 0 and (k == 0 or step - self._step[0] >= long):
            self._step[k], self._x[k], self._a[k] = step, x, a
        self.seen = step

    def save(self) -> dict[str, NDArray[np.generic]]:
        """Arrays for a checkpoint; ``load`` takes them back."""
        scalars = {key: np.array(getattr(self, key)) for key in SCALARS}
        return scalars | {"step": self._step.copy(), "x": self._x.copy(), "a": self._a.copy()}

    def load(self, arrays: dict[str, NDArray]) -> None:
        """Take up what ``save`` gave."""
        for key in SCALARS:
            setattr(self, key, arrays[key].item())
        self._step, self._x, self._a = (arrays[key].copy() for key in ("step", "x", "a"))


def _rms(u: Array) -> float:
    return float(np.sqrt(np.sum(u * u) / len(u)))


def _product(mass: Array, u: Array, v: Array) -> float:
    return float(mass @ np.einsum("ij,ij->i", u, v))
