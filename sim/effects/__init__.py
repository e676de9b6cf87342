"""Optional effects, one file each; an effect is imported only if the scene names it.

A module ``effects/NAME.py`` has a function ``build(options, scene) -> Effect``, where ``options`` is the table
``[effects.NAME]`` of the scene. Without it, its class of that name, ``BulkViscosity`` of ``bulk_viscosity``, is called
with the keys of the table. An effect overrides the hooks that it needs; the others cost nothing.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Iterable
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from morphofold.errors import DoesNotApply, NamedTwice, NotReadable
from morphofold.frozen_arrays import Array

if TYPE_CHECKING:
    from morphofold.sim.body import Body
    from morphofold.sim.mesh.brick_mesh import Bilayer
    from morphofold.sim.scene import Scene

#: names reserved for the run itself
PHASES_OF_RUN = ("grow", "elements", "filter", "advance", "measure", "rest", "balance")


class Running(Protocol):
    """The part of a run that an effect sees: body, state (x, v, step, growth), growth rate and damping per step."""

    body: Body
    state: Any
    rate: float
    damping: float
    waits_for_balance: bool


class Effect:
    """Base class of optional effects. Hooks are called in the order of ``scene.plugins.HOOK_ORDER``."""

    name = ""
    #: attributes that a checkpoint holds: numbers and arrays
    saved: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls) -> None:
        """An effect of this package has the name of its file."""
        package, _, module_name = cls.__module__.rpartition(".")
        if package == __name__:
            cls.name = module_name

    def reshape(self, bilayer: Bilayer, X: Array) -> Array:
        """Reference positions (N, 3), before the body is built."""
        return X

    def moduli(self, bilayer: Bilayer) -> Array | float:
        """Factor on the moduli of each element (E,), before the body is built."""
        return 1.0

    def prepare(self, body: Body) -> None:
        """Called once, when the body is built."""

    def refresh(self, run: Running) -> None:
        """Called every ``STEPS_PER_MEASUREMENT`` steps, after the mass is updated."""

    def add_element_forces(self, body: Body, x: Array, v: Array) -> None:
        """Add to the element forces ``body.elements.blocks.force``, every step."""

    def add_forces(self, body: Body, x: Array, v: Array, extra: Array) -> None:
        """Add forces on the surface nodes to ``extra`` (S, 3), every step."""

    def stiffness(self, body: Body, x: Array) -> sparse.csr_matrix:
        """Stiffness (3 N, 3 N): minus the derivative of its forces, at velocity 0, for the pairs of the last step."""
        return sparse.csr_matrix((x.size, x.size))

    def springs(self, body: Body, x: Array) -> Array:
        """Stiffness over mass (S,) that its forces add at each surface node, every ``STEPS_PER_MEASUREMENT`` steps."""
        return np.zeros(body.n_surface)

    def after_step(self, x: Array, v: Array) -> None:
        """Correct positions and velocities (N, 3) in place, every step."""

    def pace(self, g: float) -> float:
        """Factor on the growth rate at growth g."""
        return 1.0

    def energy(self) -> float:
        """Energy stored in the effect at the last step."""
        return 0.0

    def record(self) -> dict[str, Any]:
        """Numbers for the log."""
        return {}

    def save(self) -> dict[str, NDArray]:
        """Arrays for a checkpoint, those of ``saved`` by default; ``load`` restores them."""
        return {name.lstrip("_"): np.array(getattr(self, name)) for name in self.saved}

    def load(self, arrays: dict[str, NDArray]) -> None:
        """Restore the arrays of ``save``."""
        for name in self.saved:
            array = arrays[name.lstrip("_")]
            setattr(self, name, array.copy() if array.ndim else array.item())


def overriding(effects: tuple[Effect, ...], hook: str) -> list[Effect]:
    """The effects that override a hook."""
    return [effect for effect in effects if getattr(type(effect), hook) is not getattr(Effect, hook)]


def joined_springs(nodes: NDArray[np.int64], stiffness: Array, x: Array) -> sparse.csr_matrix:
    """Stiffness (3 N, 3 N) of springs (P,), each with a stiffness (P, 12, 12) of its four nodes (P, 4)."""
    coordinates = (3 * nodes[:, :, None] + np.arange(3)).reshape(-1, 12)
    rows_and_columns = np.repeat(coordinates, 12, axis=1).ravel(), np.tile(coordinates, (1, 12)).ravel()
    return sparse.csr_matrix((stiffness.ravel(), rows_and_columns), shape=(x.size, x.size))


def build_effects(scene: Scene) -> list[Effect]:
    """The effects of a scene; imports only their modules."""
    return [_build(name, options, scene) for name, options in scene.called_effects.items()]


def _build(name: str, options: Any, scene: Scene) -> Effect:
    module = import_module(f"{__name__}.{name}")
    if hasattr(module, "build"):
        return module.build(options, scene)
    return getattr(module, name.title().replace("_", ""))(**dict(options or {}))


def need_growth(scene: Scene, key_name: str) -> None:
    """Raise ``DoesNotApply`` if the cortex does not grow."""
    if scene.growth.final == 1:
        raise DoesNotApply(f"{key_name} needs a cortex that grows: growth.final is 1")


def own_effects(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """The caller's own effects, checked.

    Raises
    ------
    TypeError, ValueError
        If one is not an ``Effect``; or its name is not an identifier, is given twice, or is used by morphofold.
    """
    all_effects = tuple(effects)
    used_names = {*PHASES_OF_RUN, *(module.name for module in pkgutil.iter_modules(__path__))}
    for effect in all_effects:
        if not isinstance(effect, Effect):
            raise TypeError(f"effects: {effect!r:.60} is not an Effect; give instances of a subclass of Effect.")
        if not (isinstance(effect.name, str) and effect.name.isidentifier()):
            raise NotReadable(f"effects: {type(effect).__name__} has the name {effect.name!r}; give it an identifier.")
        if effect.name in used_names:
            raise NamedTwice(f"effects: the name {effect.name!r} of {type(effect).__name__} is taken; choose another.")
        used_names.add(effect.name)
    return all_effects
