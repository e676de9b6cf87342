"""What a scene says, table by table. An effect runs if and only if its table is there."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from morphofold.errors import DoesNotApply, NamedTwice, OutOfRange, TooLarge
from morphofold.sim.scene.effects import read_effects
from morphofold.sim.scene.geometries import SHAPES, Ellipsoid, Geometry, MeshFile, Patch, Radial, Sphere, Strip
from morphofold.sim.scene.materials import read_material
from morphofold.sim.scene.tables import Positive, Spot, Table, key

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
    "elements_through",
    "in_double",
]

#: accuracy level: surface edge over cortex thickness, by error and time as docs/accuracy.md measures them
LEVELS = {"draft": 0.60, "standard": 0.45, "fine": 0.27}
COARSE = 0.5  # edge over thickness beyond which the time of a third element through the cortex goes elsewhere
CROSSINGS = 180.0  # times that a wave crosses the cortex while growth rises by 1
SLOWEST_RATE = 1e-3  # of growth.rate
MOST_BRICKS = 5_000_000  # about 6 GB of memory


class Growth(Table):
    """Growth law and final growth stretch of the cortex; ``rate``: pace, times that by default."""

    law: Annotated[Literal["isotropic", "tangential"], key("in all directions, or along the surface only")] = (
        "isotropic"
    )
    final: Annotated[float, key("growth stretch at the end: a ratio of lengths", ge=1, le=4)] = 2.0
    rate: Annotated[float, key("pace, times that by default; lower is slower and calmer", ge=SLOWEST_RATE, le=4)] = 1.0


def elements_through(edge_over_T: float) -> int:
    """Elements through the cortex that go with an edge over its thickness, unless a scene says how many."""
    return 2 if edge_over_T > COARSE else 3


class Accuracy(Table):
    """Preset, or the number of element layers through the cortex and the largest surface edge [mm], which overrules it
    unless the preset is set later; and the precision of the forces of bricks."""

    level: Annotated[
        Literal["draft", "standard", "fine"], key("sets the surface edge, as a share of the (thinnest) cortex")
    ] = "standard"
    elements_through_cortex: Annotated[
        Annotated[int, Field(ge=1, le=12)] | None,
        key("layers of bricks in the cortex; by default 2 with edges longer than half of it, 3 else"),
    ] = None
    edge: Annotated[Positive | None, key("largest surface edge, instead of that of the level", "mm")] = None
    precision: Annotated[
        Literal["single", "double"], key("of the forces of bricks: single is good to 1e-5 and a third faster")
    ] = "single"


class Output(Table):
    """Growth stretches at which the body rests and surfaces are written; the final one is always written.

    ``stability``: count the unstable modes of each stage, by an exact factorisation of the stiffness. That takes as
    long as half of a run of an octant, far longer for larger bodies, and is done for strips alone unless it is asked
    for.
    """

    stages: Annotated[
        tuple[Annotated[float, Field(ge=1)], ...],
        key("growth stretches where the body rests and is written, the final one too; 0.01 apart", strict=False),
    ] = ()
    volume: Annotated[bool, key("write the body of each stage as VTK too")] = True
    stability: Annotated[
        bool | None, key("count the unstable modes of each stage; by default of strips alone: it takes long")
    ] = None
    checkpoint_minutes: Annotated[Positive, key("between checkpoints", "min")] = 0.5


class Scene(Table):
    """Everything needed to repeat a simulation."""

    name: Annotated[
        str,
        key(
            "name of the scene, and of its folder by default",
            min_length=1,
            max_length=80,
            pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._+-]*$",
        ),
    ]
    title: Annotated[str, key("one line for people", max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")] = ""
    geometry: Geometry = Sphere()
    material: Annotated[Any, BeforeValidator(read_material), Field(validate_default=True)] = {}  # MaterialOptions
    growth: Growth = Growth()
    effects: Annotated[dict[str, Any], BeforeValidator(read_effects)] = {}  # of EffectOptions
    accuracy: Accuracy = Accuracy()
    output: Output = Output()

    @model_validator(mode="after")
    def _stages_within_growth(self) -> Scene:
        late = [g for g in self.output.stages if g > self.growth.final]
        if late:
            raise OutOfRange(
                f"output.stages: {late[0]:g} lies beyond growth.final = {self.growth.final:g}; drop it or grow further"
            )
        names = [f"{g:.2f}" for g in self.stages]
        if len(set(names)) < len(names):
            raise NamedTwice("output.stages: stages (with growth.final) must differ by 0.01 at least")
        return self

    @model_validator(mode="after")
    def _effects_fit_the_rest(self) -> Scene:
        shape = self.geometry.shape
        if shape == "radial" and not self.material.theory:
            raise DoesNotApply(
                "material.model makes no sense with geometry.shape = 'radial': it is neo-Hookean; drop it"
            )
        if shape == "mesh" and self.accuracy != Accuracy():
            raise DoesNotApply("accuracy makes no sense with geometry.shape = 'mesh': the mesh is the file's; drop it")
        for name, options in self.effects.items():
            if shape not in options.shapes:
                raise DoesNotApply(f"effects.{name} makes no sense with geometry.shape = {shape!r}; drop it")
            options.check(self)
        return self

    @model_validator(mode="after")
    def _fits_in_memory(self) -> Scene:
        bricks = self.bricks
        if bricks > MOST_BRICKS:
            many = f"about {bricks:.1e}" if bricks < 1e99 else "more than 1e+99"
            raise TooLarge(
                f"this takes {many} bricks (surface edge {self.edge:.3g} mm), more than {MOST_BRICKS:.0e}; "
                "take a thicker cortex, a smaller portion, a coarser accuracy.level or a larger accuracy.edge"
            )
        return self

    @property
    def stages(self) -> tuple[float, ...]:
        """Growth stretches at which surfaces are written, ascending, the final one last."""
        return tuple(sorted({*self.output.stages, self.growth.final}))

    @property
    def thinnest(self) -> float:
        """Thickness of the ungrown cortex where a spot makes it thinnest [mm]."""
        factor = min((spot.factor for spot in getattr(self.geometry, "thickness_spots", ())), default=1.0)
        return self.geometry.cortex_thickness * min(factor, 1.0)

    @property
    def edge(self) -> float:
        """Largest surface edge asked for [mm]."""
        return self.accuracy.edge or LEVELS[self.accuracy.level] * self.thinnest

    @property
    def elements_through_cortex(self) -> int:
        """Layers of bricks in the cortex."""
        return self.accuracy.elements_through_cortex or elements_through(self.edge / self.thinnest)

    @property
    def cells(self) -> int:
        """Surface cells along a quarter of a great circle of a sphere or ellipsoid, an even number."""
        if not isinstance(self.geometry, Sphere | Ellipsoid):
            raise DoesNotApply(f"{self.name}: cells are counted on a sphere or an ellipsoid only.")
        return max(4, 2 * math.ceil(0.5 * self._edges_along_a_quarter(self.geometry) - 1e-9))

    def _edges_along_a_quarter(self, body: Sphere | Ellipsoid) -> float:
        """Of the longest great circle, as the edge asks for; infinite if the edge is next to nothing."""
        return 0.5 * math.pi * max(body.semi_axes) / self.edge

    @property
    def bricks(self) -> float:
        """About how many bricks the body has; 0 where it isn't made of bricks by us."""
        geometry, layers = self.geometry, self.elements_through_cortex + 8
        if isinstance(geometry, Sphere | Ellipsoid):
            share = {"full": 1.0, "half": 0.5, "quarter": 0.25, "octant": 0.125}[geometry.portion]
            along = max(4.0, self._edges_along_a_quarter(geometry))
            return 6 * along * along * share * layers
        if isinstance(geometry, Patch):
            return (geometry.size[0] / self.edge) * (geometry.size[1] / self.edge) * layers
        if isinstance(geometry, Strip):
            return geometry.length / self.edge * layers
        return 0.0

    def steps_per_unit(self, crossing: float) -> float:
        """Steps for growth to rise by 1 in a body whose cortex a wave crosses in ``crossing`` steps."""
        return CROSSINGS * crossing / self.growth.rate

    def without(self, *effects: str) -> Scene:
        """The same scene without some of its effects."""
        left = {name: options for name, options in self.effects.items() if name not in effects}
        return self.model_copy(update={"effects": left})

    @property
    def beyond_theory(self) -> str:
        """Why the theory of the growing sphere is not of this scene; empty if it is."""
        if not isinstance(self.geometry, Sphere | Radial):
            return f"theory is of spheres, this is of shape {self.geometry.shape}"
        if getattr(self.geometry, "thickness_spots", ()):
            return "theory is of a cortex of one thickness, this has spots of another"
        if not self.material.theory:
            return "theory is of a neo-Hookean material"
        unknown = [name for name, options in self.effects.items() if not options.theory]
        return f"theory knows no {unknown[0]}" if unknown else ""

    @property
    def real_time(self) -> bool:
        """Whether an effect says that time is real: growth does not wait for equilibrium then."""
        return any(options.real_time for options in self.effects.values())

    @property
    def called_effects(self) -> dict[str, Any]:
        """Options of the effects that run, by name: those named, and those that the geometry brings along."""
        called: dict[str, Any] = dict(self.effects)
        planes = isinstance(self.geometry, Patch | Strip) or getattr(self.geometry, "portion", "full") != "full"
        if planes and "contact" in called:
            called["symmetry"] = None
        if isinstance(self.geometry, Strip):
            called["plane_strain"] = None
        return called


def in_double(scene: Scene) -> Scene:
    """The same scene with forces of double precision, as states at rest and their stability need them."""
    return scene.model_copy(update={"accuracy": scene.accuracy.model_copy(update={"precision": "double"})})
