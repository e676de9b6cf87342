"""The tables of a scene. An effect runs if and only if its table is present."""

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from morphofold.errors import DoesNotApply, NamedTwice, OutOfRange, TooLarge
from morphofold.sim.scene.effect_registry import read_effects, read_material
from morphofold.sim.scene.geometries import (
    SHAPES,
    Ellipsoid,
    Geometry,
    MeshFile,
    Patch,
    Radial,
    Sphere,
    Strip,
    UnfoldedCortex,
    map_files,
)
from morphofold.sim.scene.table_bases import Positive, SphereMap, Spot, Table, key

__all__ = [
    "LEVELS",
    "MOST_BRICKS",
    "SHAPES",
    "SLOWEST_RATE",
    "Accuracy",
    "Ellipsoid",
    "Growth",
    "MeshFile",
    "Output",
    "Patch",
    "Radial",
    "Scene",
    "Sphere",
    "Spot",
    "Strip",
    "UnfoldedCortex",
    "elements_through",
    "in_double",
]

#: accuracy level: surface edge over cortex thickness, chosen by the errors and times in docs/accuracy.md
LEVELS = {"draft": 0.60, "standard": 0.45, "fine": 0.27, "finest": 0.27}
COARSE_LEVEL = "standard"  # of the coarse mesh that ``fine`` has beside its own, where meshes can be nested
COARSE_EDGE_OVER_T = 0.5  # edge over thickness above which a third element through the cortex is not worth its time
CROSSINGS_PER_UNIT_GROWTH = 110.0  # of a wave through the cortex while growth rises by 1
SLOWEST_RATE = 1e-3  # least growth.rate
MOST_BRICKS = 5_000_000  # about 6 GB of memory


class Growth(Table):
    """Growth law and final growth stretch of the cortex; ``rate``: pace over the default pace.

    ``thickness``: points (g, factor), linear in between: growth stretch along the thickness where the cortex has grown
    by g along the surface. The law must be tangential, which without them has 1; points with factor = g make it
    isotropic. A cortex that thins has factors below 1. Before growth the factor is 1.
    """

    law: Literal["isotropic", "tangential"] = key(
        "growth in all directions, or along the surface only", default="isotropic"
    )
    final: float = key("final growth stretch: a ratio of lengths", ge=1, le=4, default=2.0)
    rate: float = key("pace over the default pace; slower is closer to equilibrium", ge=SLOWEST_RATE, le=4, default=1.0)
    thickness: tuple[Annotated[tuple[float, Annotated[float, Field(ge=0.25, le=4)]], Field(strict=False)], ...] = key(
        "points (g, growth stretch along the thickness), for tangential growth", strict=False, default=()
    )

    @model_validator(mode="after")
    def _thickness_is_a_curve(self) -> "Growth":
        growths = [g for g, _ in self.thickness]
        if growths and self.law != "tangential":
            raise DoesNotApply('growth.thickness needs growth.law = "tangential"; isotropic growth sets the thickness')
        if sorted(set(growths)) != growths:
            raise OutOfRange("growth.thickness: growths must rise from point to point")
        if self.thickening(1.0) != 1:
            raise OutOfRange("growth.thickness: the factor must be 1 before growth, at g = 1")
        return self

    def thickening(self, g: Any) -> Any:
        """Growth stretch along the thickness at growth g, a float or an array, beside that of an isotropic law; 1 at
        NaN."""
        if not self.thickness:
            return 1.0
        growths, factors = zip(*self.thickness)
        return np.where(np.isnan(g), 1.0, np.interp(g, growths, factors))[()]


def elements_through(edge_over_T: float) -> int:
    """Number of elements through the cortex for an edge over its thickness, unless a scene sets the number."""
    return 2 if edge_over_T > COARSE_EDGE_OVER_T else 3


class Accuracy(Table):
    """Preset, number of element layers through the cortex, largest surface edge [mm], and precision of brick forces.

    The edge overrules the preset, unless the preset is set later.
    """

    level: Literal["draft", "standard", "fine", "finest"] = key(
        "sets the surface edge, as a share of the thickness of the (thinnest) cortex; fine grows on the mesh of "
        "standard before first wrinkles and once walls have met, finest never does",
        default="standard",
    )
    elements_through_cortex: Annotated[int, Field(ge=1, le=12)] | None = key(
        "layers of bricks in the cortex; by default 2 if edges are longer than half its thickness, else 3", default=None
    )
    edge: Positive | None = key("largest surface edge; it replaces that of the level", "mm", default=None)
    precision: Literal["single", "double"] = key(
        "precision of the forces of bricks; single is accurate to 1e-5 and a third faster", default="single"
    )


class Output(Table):
    """Growth stretches at which the body rests and surfaces are written; the final one is always written.

    ``stability``: count the unstable modes of each stage, by an exact factorisation of the stiffness. This takes half
    as long as the run of an octant, and far longer for larger bodies. By default it is done for strips only.
    """

    stages: tuple[Annotated[float, Field(ge=1)], ...] = key(
        "growth stretches at which the body rests and is written, besides the final one; at least 0.01 apart",
        strict=False,
        default=(),
    )
    volume: bool = key("also write the body of each stage as VTK", default=True)
    stability: bool | None = key(
        "count the unstable modes of each stage (slow); by default for strips only", default=None
    )
    patience: Annotated[float, Field(gt=0, le=20)] = key(
        "time for which a stage is held at most, over the default; few folded octants rest with 1", default=1.0
    )
    checkpoint_minutes: Positive = key("time between checkpoints", "min", default=0.5)


class Scene(Table):
    """Everything needed to repeat a simulation."""

    name: str = key(
        "name of the scene and, by default, of its folder",
        min_length=1,
        max_length=80,
        pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._+-]*$",
    )
    title: str = key("one line that describes the scene", max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$", default="")
    geometry: Geometry = Sphere()
    material: Annotated[Any, BeforeValidator(read_material), Field(validate_default=True)] = {}  # MaterialOptions
    growth: Growth = Growth()
    effects: Annotated[dict[str, Any], BeforeValidator(read_effects)] = {}  # of EffectOptions
    accuracy: Accuracy = Accuracy()
    output: Output = Output()

    @model_validator(mode="after")
    def _stages_within_growth(self) -> "Scene":
        late_stages = [g for g in self.output.stages if g > self.growth.final]
        if late_stages:
            raise OutOfRange(
                f"output.stages: {late_stages[0]:g} lies beyond growth.final = {self.growth.final:g}; "
                "remove it or raise growth.final"
            )
        stage_names = [f"{g:.2f}" for g in self.stages]
        if len(set(stage_names)) < len(stage_names):
            raise NamedTwice("output.stages: stages (with growth.final) must differ by at least 0.01")
        return self

    @model_validator(mode="after")
    def _effects_fit_the_rest(self) -> "Scene":
        shape = self.geometry.shape
        idle = [f"effects.{name}" for name, options in self.effects.items() if shape not in options.shapes]
        if shape == "radial":  # a neo-Hookean sphere
            idle += ["material.model"] * (not self.material.theory) + ["growth.thickness"] * bool(self.growth.thickness)
        if shape == "mesh" and self.accuracy != Accuracy():  # its file gives the mesh
            idle.append("accuracy")
        if idle:
            raise DoesNotApply(f"{idle[0]} does not apply with geometry.shape = {shape!r}; remove it")
        for options in self.effects.values():
            options.check(self)
        return self

    @model_validator(mode="after")
    def _fits_in_memory(self) -> "Scene":
        bricks = self.bricks
        if bricks > MOST_BRICKS:
            raise TooLarge(
                f"this needs about {bricks:.1e} bricks (surface edge {self.edge:.3g} mm), more than {MOST_BRICKS:.0e}; "
                "use a thicker cortex, a smaller portion, a coarser accuracy.level or a larger accuracy.edge"
            )
        return self

    @property
    def stages(self) -> tuple[float, ...]:
        """Growth stretches at which surfaces are written, in ascending order, the final one last."""
        return tuple(sorted({*self.output.stages, self.growth.final}))

    @property
    def thinnest(self) -> float:
        """Smallest thickness of the ungrown cortex, spots included [mm]."""
        least_factor = min((spot.factor for spot in getattr(self.geometry, "thickness_spots", ())), default=1.0)
        return self.geometry.cortex_thickness * min(least_factor, 1.0)

    @property
    def edge(self) -> float:
        """Largest surface edge that the scene asks for [mm]."""
        return self.accuracy.edge or LEVELS[self.accuracy.level] * self.thinnest

    @property
    def elements_through_cortex(self) -> int:
        """Number of layers of bricks in the cortex."""
        return self.accuracy.elements_through_cortex or elements_through(self.edge / self.thinnest)

    @property
    def cells(self) -> int:
        """Number of surface cells along an edge of the cube of a cubed sphere; a multiple of 4."""
        if not isinstance(self.geometry, Sphere | Ellipsoid | UnfoldedCortex):
            raise DoesNotApply(f"{self.name}: cells are counted only on a sphere, an ellipsoid or a cortex.")
        return max(4, 4 * math.ceil(0.25 * self.geometry.quarter / self.edge - 1e-9))

    @property
    def bricks(self) -> float:
        """Approximate number of bricks of the body; 0 if morphofold does not mesh it with bricks."""
        geometry, n_layers = self.geometry, self.elements_through_cortex + 8
        if isinstance(geometry, Sphere | Ellipsoid | UnfoldedCortex):
            portion = getattr(geometry, "portion", "full")
            portion_share = {"full": 1.0, "half": 0.5, "quarter": 0.25, "octant": 0.125}[portion]
            cells_along = max(4.0, geometry.quarter / self.edge)
            return 6 * cells_along * cells_along * portion_share * n_layers
        if isinstance(geometry, Patch):
            return (geometry.size[0] / self.edge) * (geometry.size[1] / self.edge) * n_layers
        if isinstance(geometry, Strip):
            return geometry.length / self.edge * n_layers
        return 0.0

    def steps_per_unit(self, crossing: float) -> float:
        """Number of steps in which growth rises by 1, if a wave crosses the cortex in ``crossing`` steps."""
        return CROSSINGS_PER_UNIT_GROWTH * crossing / self.growth.rate

    def without(self, *effects: str) -> "Scene":
        """The same scene without some of its effects."""
        remaining = {name: options for name, options in self.effects.items() if name not in effects}
        return self.model_copy(update={"effects": remaining})

    @property
    def beyond_theory(self) -> str:
        """Why the theory of the growing sphere does not apply to this scene; empty if it applies."""
        if not isinstance(self.geometry, Sphere | Radial):
            return f"theory is of spheres only; this is of shape {self.geometry.shape}"
        if getattr(self.geometry, "thickness_spots", ()) or getattr(self.geometry, "thickness_map", None):
            return "theory assumes a cortex of one thickness; this one has thickness spots or a map"
        if not self.material.theory:
            return "theory assumes a neo-Hookean material"
        if self.growth.thickness:
            return "theory does not include growth.thickness"
        beyond_names = [name for name, options in self.effects.items() if not options.theory]
        return f"theory does not include {beyond_names[0]}" if beyond_names else ""

    @property
    def real_time(self) -> bool:
        """Whether an effect makes time real, so that growth does not wait for equilibrium."""
        return any(options.real_time for options in self.effects.values())

    @property
    def map_files(self) -> dict[str, Path]:
        """Files of maps that the scene names, by content."""
        files: dict[str, Path] = {}
        if isinstance(table := getattr(self.geometry, "thickness_map", None), SphereMap):
            files |= map_files(table, self.geometry, "thickness_map")
        for options in self.effects.values():
            files |= options.files(self)
        return files

    @property
    def coarse(self) -> "Scene":
        """The same scene on the coarse one of two nested meshes."""
        return self.model_copy(update={"accuracy": self.accuracy.model_copy(update={"level": COARSE_LEVEL})})

    @property
    def not_nested(self) -> str:
        """Why a run at ``fine`` has only one mesh; empty if it has two."""
        if self.accuracy.level != "fine" or self.accuracy.edge is not None:
            return "accuracy.level is not fine, or an edge is given"
        if self.output.stability:
            return "output.stability makes stages wait for the modes of one mesh"
        return self.bound_to_mesh or ("" if self.material.theory else "theory does not tell when folds begin")

    @property
    def bound_to_mesh(self) -> str:
        """Why its states cannot be carried to another mesh; empty if they can."""
        if self.geometry.shape in ("mesh", "strip", "radial"):
            return f"meshes of shape {self.geometry.shape} are not nested"
        bound = [name for name, options in self.effects.items() if options.history or options.real_time]
        return f"effects.{bound[0]} has a state that is not carried to another mesh" if bound else ""

    @property
    def splits_bulk(self) -> bool:
        """Whether only a part of the bulk modulus acts at once: not in real time, not if stress has effects of its own,
        and not in double precision, for which forces are a function of positions."""
        is_whole = any(options.history or options.real_time for options in self.effects.values())
        return self.accuracy.precision == "single" and not is_whole

    @property
    def called_effects(self) -> dict[str, Any]:
        """Options of the effects that run, by name: those of the scene, and those that the geometry adds."""
        effect_options: dict[str, Any] = dict(self.effects)
        is_part = getattr(self.geometry, "portion", "full") != "full" or getattr(self.geometry, "symmetry", ())
        if (is_part or isinstance(self.geometry, Patch | Strip)) and "contact" in effect_options:
            effect_options["symmetry"] = None
        if isinstance(self.geometry, Strip):
            effect_options["plane_strain"] = None
        return effect_options


def in_double(scene: Scene) -> Scene:
    """The same scene with forces in double precision, which equilibria and their stability need."""
    return scene.model_copy(update={"accuracy": scene.accuracy.model_copy(update={"precision": "double"})})
