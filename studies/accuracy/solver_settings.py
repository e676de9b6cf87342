"""The settings of the solver that the study varies, and the body of each setting."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from morphofold.sim.build import build_bilayer, build_body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.effects.contact import PENALTY_STIFFNESS, Contact
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.scene import LEVELS, Scene, elements_through
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.accuracy.error_points import Point, Timing
from morphofold.studies.speed.solver_speed import cut_bricks

SCENE_NAME = "fig6-thick"  # has few folds, so it can be grown on meshes far finer than those in use
PORTION = "octant"
STUDY_BODY = f"{SCENE_NAME}, {PORTION}"
STANDARD_EDGE = LEVELS["standard"]
THREE_LAYERS = "mesh, 3 elements"  # axis of the mesh with three elements through the cortex throughout
NESTED = "nested meshes"  # axis of the level fine
MESH_AND_PACE = "mesh and pace"  # axis that refines both, without folding: bodies of another pace fold differently


@dataclass(frozen=True)
class Setting:
    """How the body of the study is discretised and grown; other values are those of ``standard``.

    Attributes
    ----------
    axis, label : str
        The varied quantity, and its value as text.
    value : float
        Position on the axis; along axes of the mesh :attr:`built_edge`.
    edge : float
        Requested largest edge of the ungrown surface over the thickness of the cortex.
    n_layers : int, optional
        Elements through the cortex; None: as many as belong to the edge.
    kappa_ratio, rate : float
        As in a scene.
    element : {"brick", "tet"}
        Tetrahedra are cut from the bricks, six from each.
    contact_factor : float
        Stiffness of contact over the built-in stiffness.
    precision : {"single", "double"}
        Precision of the forces of bricks.
    nested : bool
        Whether folds grow on two nested meshes, as at ``fine``; the edge is that of the finer one.
    """

    axis: str
    label: str
    value: float
    edge: float = STANDARD_EDGE
    n_layers: int | None = None
    kappa_ratio: float = 50.0
    rate: float = 1.0
    element: str = "brick"
    contact_factor: float = 1.0
    precision: str = "single"
    nested: bool = False

    @property
    def through(self) -> int:
        """Elements through the cortex."""
        return self.n_layers or elements_through(self.edge)

    @property
    def name(self) -> str:
        """Name for a file."""
        name = f"h{self.edge:g}-n{self.through}-k{self.kappa_ratio:g}-r{self.rate:g}-c{self.contact_factor:g}"
        return f"{name}-{self.element}-{self.precision}" + "-nested" * self.nested

    @property
    def built_edge(self) -> float:
        """Largest edge over thickness of the actual mesh: a quarter circle has a whole, even number of cells."""
        scene = self.scene()
        geometry: Any = scene.geometry
        return float(0.5 * np.pi * geometry.radius / scene.cells / geometry.cortex_thickness)

    @property
    def preset(self) -> str:
        """The name of the level of accuracy that this setting equals, else empty."""
        if self.nested:
            return "fine"
        level_by_edge = {edge: level for level, edge in LEVELS.items() if level != "fine"}
        return level_by_edge.get(self.edge, "") if self.name == Setting("", "", 0.0, edge=self.edge).name else ""

    def scene(self, settings: tuple[str, ...] = ()) -> Scene:
        """The scene of the study with this setting and further ones."""
        thickness = load_scene(SCENE_NAME).geometry.cortex_thickness
        return load_scene(
            SCENE_NAME,
            [
                f"geometry.portion={PORTION}",
                'accuracy.level="fine"' if self.nested else f"accuracy.edge={self.edge * thickness!r}",
                f"accuracy.elements_through_cortex={self.through}",
                f"material.kappa_ratio={float(self.kappa_ratio)!r}",
                f"growth.rate={float(self.rate)!r}",
                f"accuracy.precision={self.precision}",
                *settings,
            ],
        )

    def point(self, quantity: str, error: float, against: str, n_elements: int, timing: Timing) -> Point:
        """The error of a quantity with this setting, and its time."""
        axis_info = self.axis, self.label, self.value, n_elements
        return Point("solver", STUDY_BODY, quantity, error, against, *axis_info, **timing._asdict(), preset=self.preset)

    def bilayer(self) -> Bilayer:
        """The mesh of the ungrown body."""
        brick_mesh = build_bilayer(self.scene())
        return cut_bricks(brick_mesh) if self.element == "tet" else brick_mesh

    def dynamics(self, *, with_folds: bool) -> Dynamics:
        """A run at rest on one mesh: with imperfection and contact, or without both."""
        scene = self.scene(() if with_folds else ("effects={}",))
        effects = build_effects(scene)
        for effect in effects:
            if isinstance(effect, Contact):
                effect.per_mass = self.contact_factor * PENALTY_STIFFNESS
        body = build_body(scene, effects, self.bilayer())
        return Dynamics.of(scene, body, effects)


def axes() -> dict[str, list[Setting]]:
    """All settings by axis; along each axis from cheap to expensive, including ``standard``."""
    layers_format = "{} elements through the cortex"
    settings_by_axis = {
        "mesh": _along("mesh", "h = {:.2f} T", "edge", EDGE_SIZES),
        THREE_LAYERS: _along(
            THREE_LAYERS, "h = {:.2f} T, 3 elements through the cortex", "edge", EDGE_SIZES, n_layers=3
        ),
        NESTED: [Setting(NESTED, "h = 0.27 T, nested in 0.45 T", LEVELS["fine"], edge=LEVELS["fine"], nested=True)],
        MESH_AND_PACE: [
            Setting(MESH_AND_PACE, f"h = {h:.2f} T, pace {h / STANDARD_EDGE:.2f}", h, edge=h, rate=h / STANDARD_EDGE)
            for h in EDGE_SIZES
        ],
        "layers": [
            *_along("layers", "1 element through the cortex", "n_layers", (1,)),
            *_along("layers", layers_format, "n_layers", (2, 3, 4, 6)),
        ],
        "layers, fine": _along("layers, fine", f"h = 0.27 T, {layers_format}", "n_layers", (2, 3), edge=0.27),
        "kappa": _along("kappa", "kappa/mu = {:g}", "kappa_ratio", (12.5, 25.0, 50.0, 100.0, 200.0)),
        "pace": _along("pace", "pace {:g}", "rate", (4.0, 2.0, 1.0, 0.5, 0.25)),
        "contact": _along("contact", "contact x {:g}", "contact_factor", (0.25, 0.5, 1.0, 1.3)),
        "element": _along("element", "tetrahedra, h = {:.2f} T", "edge", (0.8, 0.6, 0.45), element="tet"),
        "precision": [
            Setting("precision", f"{name} precision", n_bits, precision=name)
            for name, n_bits in (("single", 24), ("double", 53))
        ],
    }
    for axis in EDGE_AXES:
        settings_by_axis[axis] = [replace(setting, value=setting.built_edge) for setting in settings_by_axis[axis]]
    return settings_by_axis


def _along(axis: str, label_format: str, field_name: str, values: Sequence[float], **more_fields: Any) -> list[Setting]:
    """A setting for each value of the field ``field_name``, with the other fields as given."""
    return [Setting(axis, label_format.format(value), value, **{field_name: value, **more_fields}) for value in values]


EDGE_AXES = ("mesh", THREE_LAYERS, MESH_AND_PACE, "element")
EDGE_SIZES = (1.20, 1.00, 0.80, 0.60, 0.45, 0.36, 0.27)
#: reference for the folds of all settings
FINEST_SETTING = Setting("mesh", "finest: h = 0.18 T", 0.18, edge=0.18)
