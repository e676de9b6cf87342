"""The core grows where it is under stress (Bayly and others 2013, Phys. Biol. 10, 016005), a part at a time.

Each brick of the core, or patch of tetrahedra, has a growth tensor G. While the cortex grows by dg,

    dG G^-1 = rate M / mu |dg|,

with M the mean Mandel stress of the part, A^T dW/dA, over its grown volume, and mu its shear modulus. For small strain
M is the Cauchy stress. So tension lengthens the core, pressure shortens it, and stress relaxes like that of a Maxwell
solid: shear by exp(-2 rate dg), pressure by exp(-3 rate (kappa/mu) dg). The paper has a growth that follows stress;
this law for a solid of three dimensions, and its unit, are ours. Time is counted in growth of the cortex, so that only
the ratio of both rates matters. Without growth nothing relaxes.

Growth of the core costs energy, or sets it free, at fixed positions. What it takes from the stored energy is recorded,
so that stored, kinetic, dissipated and released energy add up to the work of the growing cortex.
"""

import math
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from morphofold.errors import DoesNotApply, OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.sim.body import Body
from morphofold.sim.dynamics import STEPS_PER_INCREMENT, STEPS_PER_MEASUREMENT
from morphofold.sim.effects import Effect, need_growth
from morphofold.sim.scene import Scene
from morphofold.sim.scene.table_bases import EffectOptions, key

#: relaxation of stress between two measurements, beyond which the cortex grows more slowly
MOST_RELAXED = 0.5
#: ticks in which growth rises by 1, at least, where the volume follows pressure: faster growth makes pressure swing
LEAST_TICKS_PER_UNIT = 220.0
#: largest relaxation of stress per unit of growth: such runs take ten to fifty times as long
FASTEST_RELAXATION = 2000.0


class Options(EffectOptions):
    """The core grows in proportion to its stress, while the cortex grows.

    With ``volume = false`` it keeps its volume and only its shape follows. With ``volume = true`` its pressure relaxes
    too: growth takes twice as long as otherwise, more above a ``rate`` of 0.5 to 0.9, depending on the body, and above
    ``rate`` times kappa / mu of 670 it is refused. A core that yields folds sooner and in longer waves than an elastic
    one (docs/theory.md, section 7). The imperfection, and the growth at which a run slows down for first folds, are
    those of the elastic one.
    """

    counted = "stress_growth"
    history = True
    example = "{rate = 0.2}"

    rate: Annotated[
        float, key("growth strain of the core under a stress of one shear modulus, while g rises by 1", gt=0, le=1000)
    ] = 0.2
    volume: Annotated[bool, key("whether the volume of the core follows its pressure, not its shape alone")] = True

    def check(self, scene: Scene) -> None:
        need_growth(scene, "effects.stress_growth")
        if "core_growth" in scene.effects:
            raise DoesNotApply(
                "effects.stress_growth and effects.core_growth both set the growth of the core; remove one"
            )
        relaxation = _relaxation(self.rate, self.volume, scene.material.kappa_ratio)
        if relaxation > FASTEST_RELAXATION:
            raise OutOfRange(
                f"effects.stress_growth.rate = {self.rate:g} relaxes stress by a factor of e {relaxation:.0f} times "
                f"while g rises by 1, more than {FASTEST_RELAXATION:g}; reduce it, or set "
                "effects.stress_growth.volume = false"
            )


def _relaxation(rate: float, volume: bool, kappa_ratio: float) -> float:
    """Fastest relaxation of stress per unit of growth: of pressure, or of shear if the volume does not follow."""
    return rate * (max(2.0, 3.0 * kappa_ratio) if volume else 2.0)


class StressGrowth(Effect):
    """Growth of the core by its stress; ``rate`` and ``volume`` as in :class:`Options`.

    Attributes
    ----------
    G : (n_core, 3, 3) float64
        Growth tensors of the parts of the core: its bricks, or patches of tetrahedra.
    released : float
        Energy that their growth has taken from the stored energy, at fixed positions.
    """

    saved = ("G", "released")

    def __init__(self, rate: float, volume: bool = True):
        self._rate, self._volume = rate, volume
        self.released = 0.0

    def prepare(self, body: Body) -> None:
        self._body, self._volumes = body, body.elements.core_volumes
        self.G = np.tile(np.eye(3), (len(self._volumes), 1, 1))
        self._grown_at, self._steps, self._pace_limit = body.growth, 0, 1.0
        kappa_ratio = float(np.max(body.kappa / body.mu)) + body.elements.LOCAL
        self._relaxation = _relaxation(self._rate, self._volume, kappa_ratio)

    def refresh(self, run) -> None:
        self._grown_at, self._steps = run.body.growth, 0
        max_rate = MOST_RELAXED / (self._relaxation * STEPS_PER_MEASUREMENT)
        if self._volume and run.waits_for_balance:
            max_rate = min(max_rate, 1 / (LEAST_TICKS_PER_UNIT * run.body.crossing))
        self._pace_limit = min(1.0, max_rate / run.rate)

    def add_element_forces(self, body: Body, x: Array, v: Array) -> None:
        """In the middle between two measurements the core grows for all of that time; G acts from the next step on."""
        self._steps += 1
        middle = STEPS_PER_MEASUREMENT // 2 + 1
        if self._steps == middle and body.growth != self._grown_at:
            steps_grown = STEPS_PER_INCREMENT * math.ceil(middle / STEPS_PER_INCREMENT)
            growth_step = STEPS_PER_MEASUREMENT / steps_grown * abs(body.growth - self._grown_at)
            energy_before = self._stored(x)
            body.elements.grow_by_stress(x, body.X, self.G, self._rate * growth_step, self._volume)
            self.released += energy_before - self._stored(x)

    def _stored(self, x: Array) -> float:
        self._body.elements.measure(x)
        return float(self._body.elements.state()["energy"].sum())

    def pace(self, g: float) -> float:
        return self._pace_limit

    def record(self) -> dict[str, Any]:
        """Energy that growth of the core took from the stored one; norm of G - 1, the largest and the mean by volume;
        and volume of the core over that before growth."""
        growth_strain = np.linalg.norm(self.G - np.eye(3), axis=(1, 2))
        volume_ratios = np.einsum("ei,ei->e", self.G[:, 0], np.cross(self.G[:, 1], self.G[:, 2]))
        return {
            "released_energy": self.released,
            "largest_growth_strain": float(growth_strain.max(initial=0.0)),
            "mean_growth_strain": float(np.average(growth_strain, weights=self._volumes)),
            "core_volume_ratio": float(np.average(volume_ratios, weights=self._volumes)),
        }

    def load(self, arrays: dict[str, NDArray]) -> None:
        super().load(arrays)
        self._body.elements.grow_by_stress(self._body.X, self._body.X, self.G, 0.0, self._volume)
