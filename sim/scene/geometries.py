"""The bodies that a scene can have."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Tag, model_validator

from morphofold.errors import ImpossibleBody
from morphofold.sim.scene.tables import Direction, Length, Spot, Table, key

# keys that several bodies have
Radius = Annotated[Length, key("of the outer (pial) surface", "mm")]
HoleRadius = Annotated[Length, key("of the hole in the middle, whose wall is held fixed; inside the core", "mm")]
Depth = Annotated[Length, key("of cortex and core together; the base is held fixed", "mm")]
Portion = Annotated[
    Literal["full", "half", "quarter", "octant"],
    key("part that is simulated, cut by symmetry planes; output is mirrored to the whole"),
]
ThicknessSpots = Annotated[
    tuple[Spot, ...], key("regions of another thickness, factors times `cortex_thickness`", strict=False)
]


class Layers(Table):
    """What every body has: a cortex on a core [mm]."""

    cortex_thickness: Annotated[Length, key("of the cortex before growth", "mm")] = 2.0


class Sphere(Layers):
    """Bilayer sphere (Razavi et al. 2015, Fig. 2): C = radius, C - B = cortex_thickness, A = hole_radius [mm].

    ``thickness_spots``: regions of another cortical thickness, their factors times ``cortex_thickness``.
    """

    shape: Annotated[Literal["sphere"], key("which body")] = "sphere"
    radius: Radius = 50.0
    hole_radius: HoleRadius = 25.0
    portion: Portion = "half"
    thickness_spots: ThicknessSpots = ()

    @model_validator(mode="after")
    def _layers_fit(self) -> Sphere:
        _check_layers(self.radius, self.cortex_thickness, self.hole_radius)
        return self

    @property
    def semi_axes(self) -> Direction:
        return (self.radius, self.radius, self.radius)

    @property
    def hole_share(self) -> float:
        """Size of the hole over that of the outer surface."""
        return self.hole_radius / self.radius


class Ellipsoid(Layers):
    """Bilayer ellipsoid; ``semi_axes`` of the pial surface [mm], the hole a copy of it, ``hole_share`` as large."""

    shape: Annotated[Literal["ellipsoid"], key("which body")]
    semi_axes: Annotated[
        tuple[Length, Length, Length], key("of the outer (pial) surface, along x, y and z", "mm", strict=False)
    ] = (60.0, 45.0, 40.0)
    hole_share: Annotated[float, key("size of the hole over that of the outer surface", gt=0, lt=1)] = 0.5
    portion: Portion = "half"
    thickness_spots: ThicknessSpots = ()

    @model_validator(mode="after")
    def _layers_fit(self) -> Ellipsoid:
        _check_layers(min(self.semi_axes), self.cortex_thickness, self.hole_share * min(self.semi_axes))
        return self


class Patch(Layers):
    """A flat block of ``size`` along x and y and of ``depth`` [mm], symmetry planes on its sides, held at its base."""

    shape: Annotated[Literal["patch"], key("which body")]
    size: Annotated[tuple[Length, Length], key("along x and y; the sides are symmetry planes", "mm", strict=False)] = (
        40.0,
        40.0,
    )
    depth: Depth = 25.0

    @model_validator(mode="after")
    def _layers_fit(self) -> Patch:
        _check_layers(self.depth, self.cortex_thickness, 0.0)
        return self


class Strip(Layers):
    """A slice of a patch in plane strain: ``length`` along x and ``depth`` [mm]."""

    shape: Annotated[Literal["strip"], key("which body")]
    length: Annotated[Length, key("along x; plane strain across", "mm")] = 80.0
    depth: Depth = 25.0

    @model_validator(mode="after")
    def _layers_fit(self) -> Strip:
        _check_layers(self.depth, self.cortex_thickness, 0.0)
        return self


class Radial(Layers):
    """The sphere in one dimension: it stays a sphere, whether stable or not. Names as in the sphere [mm]."""

    shape: Annotated[Literal["radial"], key("which body")]
    radius: Radius = 50.0
    hole_radius: HoleRadius = 25.0

    @model_validator(mode="after")
    def _layers_fit(self) -> Radial:
        _check_layers(self.radius, self.cortex_thickness, self.hole_radius)
        return self


class MeshFile(Layers):
    """Any body of tetrahedra, from a ``file`` that meshio reads, lengths times ``scale`` to mm.

    The cortex is what lies less than ``cortex_thickness`` below the outer surface, or the tetrahedra whose cell data
    ``label`` hold the value ``cortex_label``. ``held`` names what never moves: an ``inner`` surface (a ventricle), or
    ``nothing``.
    """

    cortex_thickness: Annotated[
        Length, key("of the cortex before growth; with a `label` it sets the imperfection", "mm")
    ] = 2.0
    shape: Annotated[Literal["mesh"], key("which body")]
    file: Annotated[
        str, key("tetrahedra in any format that meshio reads: a path, or one of data_samples", min_length=1)
    ]
    scale: Annotated[float, key("lengths of the file times this are mm", ge=1e-6, le=1e6)] = 1.0
    label: Annotated[
        str | None, key("cell data that say what is cortex; without it, what lies within `cortex_thickness`")
    ] = None
    cortex_label: Annotated[int, key("value of `label` in the cortex")] = 1
    held: Annotated[
        Literal["inner", "nothing"], key("what never moves: the inner surface (a ventricle), or nothing")
    ] = "nothing"

    def path(self) -> Path:
        """Where the file is: as named, or else the sample of that name.

        Raises
        ------
        FileNotFoundError, ValueError
            If it is neither, or no file.
        """
        from morphofold.io import sample_path
        from morphofold.io.files import existing_file

        path = Path(self.file)
        if not path.exists():
            with suppress(FileNotFoundError):
                path = sample_path(self.file)
        return existing_file(path, "tetrahedral mesh")


def _check_layers(radius: float, thickness: float, hole: float) -> None:
    if thickness >= radius:
        raise ImpossibleBody(f"cortex_thickness {thickness:g} leaves no core in {radius:g} mm; make it smaller")
    if hole >= radius - thickness:
        raise ImpossibleBody(
            f"hole_radius {hole:g} is not inside the core of radius {radius - thickness:g} ({radius:g} - "
            f"cortex_thickness {thickness:g}); make it smaller than {radius - thickness:g}"
        )


SHAPES: dict[str, type[Layers]] = {
    "sphere": Sphere,
    "ellipsoid": Ellipsoid,
    "patch": Patch,
    "strip": Strip,
    "radial": Radial,
    "mesh": MeshFile,
}


def _shape(table: Any) -> str:
    """Which geometry a table means; a sphere unless it says otherwise."""
    named = table.get("shape", "sphere") if isinstance(table, dict) else getattr(table, "shape", "sphere")
    return str(named)


Geometry = Annotated[
    Annotated[Sphere, Tag("sphere")]
    | Annotated[Ellipsoid, Tag("ellipsoid")]
    | Annotated[Patch, Tag("patch")]
    | Annotated[Strip, Tag("strip")]
    | Annotated[Radial, Tag("radial")]
    | Annotated[MeshFile, Tag("mesh")],
    Discriminator(_shape, custom_error_type="shape", custom_error_message=f"must be one of {', '.join(SHAPES)}"),
]
