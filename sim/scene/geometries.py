"""The bodies that a scene can have."""

import math
import re
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, model_validator

from morphofold.errors import ImpossibleBody, NamedTwice, OptionsClash
from morphofold.io.files import existing_file
from morphofold.sim.scene.table_bases import Direction, Length, SphereMap, Spot, Table, key, read_variant

LONGEST_OVER_MEAN_EDGE = 1.34  # of the cells on an unfolded cortex (sim/hemisphere)

# keys that several bodies share
Radius = Annotated[Length, key("radius of the outer (pial) surface", "mm")]
HoleRadius = Annotated[Length, key("radius of the hole in the middle, inside the core; its wall is held fixed", "mm")]
Depth = Annotated[Length, key("depth of cortex and core together; the base is held fixed", "mm")]
Portion = Annotated[
    Literal["full", "half", "quarter", "octant"],
    key("simulated part, cut by symmetry planes; output is mirrored to the whole body"),
]
ThicknessMap = Annotated[
    SphereMap | None,
    key("map whose values, over their mean, multiply `cortex_thickness`; the factor is kept within 0.6 and 1.5"),
]
ThicknessSpots = Annotated[
    tuple[Spot, ...], key("regions of another thickness; their factors multiply `cortex_thickness`", strict=False)
]


class Layers(Table):
    """What every body has: a cortex on a core [mm]."""

    cortex_thickness: Length = key("thickness of the cortex before growth", "mm", default=2.0)

    @model_validator(mode="after")
    def _layers_fit(self) -> "Layers":
        sizes = getattr(self, "semi_axes", [getattr(self, name) for name in ("radius", "depth") if hasattr(self, name)])
        size, hole_share = min(sizes, default=math.inf), None  # least depth, where it is known before meshing [mm]
        if (hole_radius := getattr(self, "hole_radius", None)) is None:
            hole_share = getattr(self, "hole_share", 0.0)
            hole_radius = hole_share * size if hole_share else 0.0
        core_depth = size - self.cortex_thickness
        if core_depth <= 0:
            raise ImpossibleBody(
                f"cortex_thickness {self.cortex_thickness:g} leaves no core in a body of {size:g} mm; make it smaller"
            )
        if hole_radius >= core_depth:
            hole_text = f"hole_radius {hole_radius:g}" if hole_share is None else f"hole_share {hole_share:g}"
            limit_text = f"{core_depth:g}" if hole_share is None else f"{core_depth / size:.3g}"
            raise ImpossibleBody(
                f"{hole_text} is not inside the core of radius {core_depth:g} ({size:g} - cortex_thickness "
                f"{self.cortex_thickness:g}); make it smaller than {limit_text}"
            )
        return self


class Sphere(Layers):
    """Bilayer sphere (Razavi et al. 2015, Fig. 2): C = radius, C - B = cortex_thickness, A = hole_radius [mm].

    ``thickness_spots``: regions of another cortical thickness; their factors multiply ``cortex_thickness``.
    """

    shape: Literal["sphere"] = key("type of body", default="sphere")
    radius: Radius = 50.0
    hole_radius: HoleRadius = 25.0
    portion: Portion = "half"
    thickness_spots: ThicknessSpots = ()
    thickness_map: ThicknessMap = None

    @property
    def semi_axes(self) -> Direction:
        return (self.radius, self.radius, self.radius)

    @property
    def quarter(self) -> float:
        """Length of a quarter of the longest circle on the pial surface [mm]."""
        return 0.5 * math.pi * self.radius

    @property
    def hole_share(self) -> float:
        """Size of the hole over that of the outer surface."""
        return self.hole_radius / self.radius


class Ellipsoid(Layers):
    """Bilayer ellipsoid: ``semi_axes`` of the pial surface [mm]; the hole has its shape, scaled by ``hole_share``."""

    shape: Literal["ellipsoid"] = key("type of body")
    semi_axes: tuple[Length, Length, Length] = key(
        "semi-axes of the outer (pial) surface, along x, y and z", "mm", strict=False, default=(60.0, 45.0, 40.0)
    )
    hole_share: float = key("size of the hole over that of the outer surface", gt=0, lt=1, default=0.5)
    portion: Portion = "half"
    thickness_spots: ThicknessSpots = ()
    thickness_map: ThicknessMap = None

    @property
    def quarter(self) -> float:
        """Length of a quarter of a circle of the longest semi-axis [mm]."""
        return 0.5 * math.pi * max(self.semi_axes)


class Patch(Layers):
    """A flat block, ``size`` along x and y, ``depth`` [mm]; its sides are symmetry planes, its base is held fixed."""

    shape: Literal["patch"] = key("type of body")
    size: tuple[Length, Length] = key(
        "size along x and y; the sides are symmetry planes", "mm", strict=False, default=(40.0, 40.0)
    )
    depth: Depth = 25.0


class Strip(Layers):
    """A slice of a patch in plane strain: ``length`` along x and ``depth`` [mm]."""

    shape: Literal["strip"] = key("type of body")
    length: Length = key("length along x; plane strain across it", "mm", default=80.0)
    depth: Depth = 25.0


class Radial(Layers):
    """The sphere in one dimension: it stays a sphere, stable or not. Names as in ``Sphere`` [mm]."""

    shape: Literal["radial"] = key("type of body")
    radius: Radius = 50.0
    hole_radius: HoleRadius = 25.0


class MeshFile(Layers):
    """Any body of tetrahedra, from a ``file`` that meshio reads, or in the text format of the folding codes of Tallinen
    and BrainGrowth (cell data ``label``); its lengths times ``scale`` are mm.

    The cortex is the part less than ``cortex_thickness`` below the outer surface, or the tetrahedra whose cell data
    ``label`` have the value ``cortex_label``. ``held`` names the part that is held fixed: all ``inner`` surfaces
    (ventricles), or ``nothing``; ``held_facets`` and ``held_map`` hold more. Where the body is cut flat, it can be
    mirrored (``symmetry``). Maps are point data of the file, labels of facets are cell data of its triangles.
    """

    cortex_thickness: Length = key(
        "thickness of the cortex before growth; with a `label` it sets the imperfection", "mm", default=2.0
    )
    shape: Literal["mesh"] = key("type of body")
    file: str = key(
        "file of tetrahedra that meshio reads, or of a folding code: a path from the scene, or one of data_samples",
        min_length=1,
    )
    scale: float = key("factor from the lengths of the file to mm", ge=1e-6, le=1e6, default=1.0)
    label: str | None = key(
        "cell data that mark the cortex; without it, the cortex is what lies within `cortex_thickness`", default=None
    )
    cortex_label: int = key("value of `label` in the cortex", default=1)
    held: Literal["inner", "nothing"] = key(
        "part that is held fixed: all inner surfaces (ventricles), or nothing", default="nothing"
    )
    held_map: str | None = key("point data that are not 0 where nodes are held, too", default=None)
    symmetry: tuple[Literal["x", "y", "z"], ...] = key(
        "axes along which one end of the body is a flat cut; output is mirrored there", strict=False, default=()
    )
    facets: str | None = key("cell data that label the triangles of the file", default=None)
    held_facets: tuple[int, ...] = key(
        "labels in `facets` of triangles whose nodes are held, too", strict=False, default=()
    )
    cut_facets: tuple[int, ...] = key(
        "labels in `facets` of parts of the outer surface that are no cortex", strict=False, default=()
    )
    thickness_map: str | None = key("point data that multiply `cortex_thickness` at the pial nodes", default=None)
    regions: str | None = key(
        "point data, or cell data of tetrahedra, that label regions of the pial surface; 0 is none", default=None
    )

    @model_validator(mode="after")
    def _keys_fit(self) -> "MeshFile":
        facet_keys = [name for name in ("held_facets", "cut_facets") if getattr(self, name)]
        if bool(facet_keys) != (self.facets is not None):
            raise OptionsClash(
                f"{facet_keys[0]} needs facets, the name of the cell data that label triangles; add it"
                if facet_keys
                else "facets is used only by held_facets and cut_facets; add one of these, or leave it out"
            )
        if self.thickness_map is not None and self.label is not None:
            raise OptionsClash("thickness_map does not apply with a label, which defines the cortex; leave out one")
        if len(set(self.symmetry)) < len(self.symmetry):
            raise NamedTwice("symmetry names an axis twice; name each once")
        return self

    def path(self) -> Path:
        """Path of the file: the one named, or else the sample of that name.

        Raises
        ------
        FileNotFoundError, ValueError
            If there is neither, or if it is not a file.
        """
        return existing_file(path_or_sample(self.file), "tetrahedral mesh")


class UnfoldedCortex(Layers):
    """A person's cortex before it folded: the white surface, unfolded by heat flow on its sphere.

    Lengths are those of a body whose pial surface has the area of a sphere of ``radius``. ``held`` names the part that
    is held fixed: the wall of the hole, and by default the medial wall, which does not grow either.
    """

    cortex_thickness: Length = key(
        "mean thickness of the cortex before growth; `morphofold unfold` shows the thickest that fits",
        "mm",
        default=2.5,
    )
    shape: Literal["cortex"] = key("type of body")
    subject: str = key(
        "folder of a FreeSurfer subject, or file of a closed surface: a path from the scene, or a sample", min_length=1
    )
    hemi: Literal["lh", "rh"] = key("hemisphere, of a subject or of the file", default="lh")
    surface: str = key("folded surface of a subject, `surf/?h.NAME`", min_length=1, default="white")
    sphere: str | None = key(
        "its sphere, `surf/?h.NAME`, or a file if `subject` is one; by default `?h.sphere`, or one is made, which "
        "takes two minutes for 150,000 vertices",
        default=None,
    )
    unfold: float = key("time of the heat flow on the unit sphere; larger is smoother", ge=0.005, le=0.3, default=0.03)
    radius: Length = key("of the sphere with the area of the pial surface before growth", "mm", default=50.0)
    thickness_map: ThicknessMap = None
    hole_share: float = key("size of the hole over that of the body", ge=0.05, le=0.6, default=0.25)
    held: Literal["medial wall", "hole"] = key(
        "part that is held fixed: the wall of the hole, alone or with the medial wall, which does not grow then",
        default="medial wall",
    )

    @property
    def semi_axes(self) -> Direction:
        """Of the sphere of the same area [mm]."""
        return (self.radius, self.radius, self.radius)

    @property
    def quarter(self) -> float:
        """Length of the longest edge times the number of cells along an edge of the cube [mm]."""
        return LONGEST_OVER_MEAN_EDGE * math.sqrt(4 * math.pi / 6) * self.radius

    def place(self) -> Path:
        """Path of the subject: the one named, or else the sample of that name.

        Raises
        ------
        FileNotFoundError
            If there is neither.
        """
        subject = path_or_sample(self.subject)
        return subject if subject.is_dir() else existing_file(subject, "folder of a subject or closed surface")


def path_or_sample(name: str) -> Path:
    """The path itself, or if there is nothing the sample of that name, if there is one."""
    from morphofold.io import sample_path  # loads numba, which the theory does not need

    path = Path(name)
    if not path.exists():
        with suppress(FileNotFoundError):
            return sample_path(name)
    return path


def map_files(table: SphereMap, geometry: Any, name: str) -> dict[str, Path]:
    """The files of a map, by content; ``geometry`` is that of the scene."""
    files = {name: map_file(table, geometry)}
    if table.sphere is not None:
        files[f"sphere of {name}"] = existing_file(path_or_sample(table.sphere), "sphere")
    return files


def map_file(table: SphereMap, geometry: Any) -> Path:
    """The file of a map: that of the subject, ``surf/?h.NAME``, or a path, or a sample."""
    if isinstance(geometry, UnfoldedCortex) and re.fullmatch(r"[\w.-]+", table.file):
        subject_file = geometry.place() / "surf" / f"{geometry.hemi}.{table.file}"
        if subject_file.is_file():
            return subject_file
    return existing_file(path_or_sample(table.file), "map")


Shaped = Sphere | Ellipsoid | Patch | Strip | Radial | UnfoldedCortex | MeshFile
SHAPES: dict[str, type[Layers]] = {get_args(t.model_fields["shape"].annotation)[0]: t for t in get_args(Shaped)}
Geometry = Annotated[
    Shaped, BeforeValidator(lambda table: read_variant(table, "shape", "sphere", SHAPES, SHAPES.__getitem__))
]
