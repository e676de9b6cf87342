"""The subject whose cortex grows: its files, its folded surface with what it unfolds to, and where it is cortex."""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from morphofold.arrays import Array, Bools
from morphofold.errors import MissingPart
from morphofold.geometry import vertex_areas
from morphofold.io.cortices import folded_files, read_folded
from morphofold.mesh_quality.checks import cortex_label
from morphofold.mesh_quality.repair import Mended, unfoldable
from morphofold.provenance import sha256_of
from morphofold.sim.scene.geometries import UnfoldedCortex
from morphofold.unfolding.spheres import sphere_of
from morphofold.unfolding.unfold import Unfolding, unfold

_OF_THE_BODY_ONLY = {"held": "hole", "thickness_map": None, "cortex_thickness": 1.0, "hole_share": 0.25}


class Vertices(NamedTuple):
    """Vertices of a sphere: points (N, 3) of the unit sphere, and areas (N,) that weight them; 0 where they are not
    cortex."""

    points: Array
    areas: Array


class Subject(NamedTuple):
    """The hemisphere of a subject as it was read and repaired, what it unfolds to, where it is cortex (N,), and what
    says so: a word of :func:`~morphofold.mesh_quality.checks.cortex_label`."""

    mended: Mended
    unfolding: Unfolding
    cortex: Bools
    marked_by: str

    def vertices(self) -> Vertices:
        """Its vertices on the sphere, weighted by the area of the smooth surface."""
        smooth = self.unfolding.smooth()
        return Vertices(self.unfolding.points, vertex_areas(smooth.verts, smooth.faces) * self.cortex)


def files_of_subject(geometry: UnfoldedCortex) -> dict[str, Path]:
    """The files of the subject, by content."""
    return folded_files(geometry.place(), geometry.hemi, surface=geometry.surface, sphere=geometry.sphere)


def subject_of_cortex(geometry: UnfoldedCortex) -> Subject:
    """The hemisphere that a body is made of, as it was read, and what it unfolds to.

    Raises
    ------
    MissingPart
        If the medial wall is to be held, and nothing marks it; before the surface is unfolded.
    """
    asked = geometry.model_copy(update=_OF_THE_BODY_ONLY), digests_of(files_of_subject(geometry))
    if geometry.held == "medial wall" and cortex_label(_read(*asked).cortex)[0].all():
        raise MissingPart(
            f"{geometry.subject}: has no medial wall: neither label/{geometry.hemi}.cortex.label nor "
            f"{geometry.hemi}.aparc.annot marks one, surf/{geometry.hemi}.sphere.reg is missing, and white and pial "
            "meet on no large patch. Add the label, or set geometry.held = 'hole'."
        )
    return _subject(*asked)


def digests_of(files: Mapping[str, Path]) -> tuple[str, ...]:
    return tuple(sha256_of(path) for path in files.values())


@lru_cache(maxsize=8)
def _read(geometry: UnfoldedCortex, digests: tuple[str, ...]) -> Mended:
    """The repaired cortex of a geometry; ``digests`` are those of its files, so that a changed file is read again."""
    place = geometry.place()
    return unfoldable(read_folded(place, geometry.hemi, surface=geometry.surface, sphere=geometry.sphere))


@lru_cache(maxsize=8)
def _subject(geometry: UnfoldedCortex, digests: tuple[str, ...]) -> Subject:
    mend = _read(geometry, digests)
    white = mend.cortex.white
    unfolding = unfold(white, mend.cortex.sphere or sphere_of(white), geometry.unfold, radius=geometry.radius)
    return Subject(mend, unfolding, *cortex_label(mend.cortex))
