"""Templates, to which the maps of subjects are brought over through registered spheres."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold.errors import MissingPart, OutOfRange
from morphofold.group.tasks import INPUT_ERRORS
from morphofold.io import read_label, read_surface
from morphofold.io.cortices import registered_sphere
from morphofold.provenance import sha256_of
from morphofold.spheres.templates import template_folder, template_sphere, template_surface

HEMIS = ("lh", "rh")
SYMMETRY_TOLERANCE = 1e-4  # of the radius, between a vertex of the left sphere and the mirrored one of the right
TEMPLATE_SURFACES = ("white", "pial", "inflated", "sphere", "sphere.reg")


@dataclass(frozen=True)
class Template:
    """A template, and how maps are smoothed on it.

    Attributes
    ----------
    name : str
    folder : str
        With ``surf/?h.sphere.reg`` or, of a template that others are registered to, ``surf/?h.sphere``.
    fwhm : float or None
        Full width at half maximum [mm] of the smoothing along its white surface.
    xhemi : bool
        Both hemispheres come to its left one, the right one mirrored, by FreeSurfer's ``surfreg --xhemi``.
    """

    name: str
    folder: str
    fwhm: float | None = None
    xhemi: bool = False

    @property
    def place(self) -> str:
        """Name of the folder for maps on it."""
        return self.name + "-xhemi" * self.xhemi + (f"-fwhm{self.fwhm:g}" if self.fwhm is not None else "")

    def side(self, hemi: str) -> str:
        """Its hemisphere to which one of a subject comes."""
        return "lh" if self.xhemi else hemi

    def registration(self, subject: str | Path, hemi: str) -> Path:
        """The file of a subject's sphere that is registered to it; raises if there is none."""
        if not self.xhemi:
            return registered_sphere(subject, hemi)
        name, mirrored = f"{self.name}.sphere.reg", Path(subject) / "xhemi" if hemi == "rh" else subject
        return registered_sphere(mirrored, "lh", name, f"surfreg --s SUBJECT --t {self.name} --lh [--xhemi] writes it.")

    def is_symmetric(self) -> bool:
        """Whether vertex i of its left hemisphere belongs to vertex i of the right one: their spheres are mirrored."""
        if self.xhemi or not all(self.has_sphere(hemi) for hemi in HEMIS):
            return self.xhemi
        left, right = (read_surface(self.sphere(hemi)).verts for hemi in HEMIS)
        near = SYMMETRY_TOLERANCE * np.abs(left).max()
        return left.shape == right.shape and bool(np.abs(left * (-1, 1, 1) - right).max() <= near)

    def sphere(self, hemi: str) -> Path:
        """The file of its sphere."""
        return template_sphere(self.folder, self.side(hemi))

    def cortex(self, hemi: str, n: int) -> NDArray[np.bool_] | None:
        """Its cortex (n,), by ``label/?h.cortex.label``; None if it has none."""
        file = self.label(hemi, "cortex.label")
        return read_label(file, n) if file.is_file() else None

    def label(self, hemi: str, name: str) -> Path:
        """Where one of its labels is, if it has it."""
        return Path(self.folder) / "label" / f"{self.side(hemi)}.{name}"

    def has_sphere(self, hemi: str) -> bool:
        """Whether it has that hemisphere."""
        try:
            self.sphere(hemi)
        except MissingPart:
            return False
        return True

    def digests(self) -> dict[str, Any]:
        """Digests of the files on which maps depend, or why there is none, and the smoothing."""
        found: dict[str, Any] = {"fwhm": self.fwhm, "xhemi": self.xhemi}
        for hemi in HEMIS:
            found[hemi] = [digest_or_reason(self.sphere, hemi)]
            found[hemi] += [digest_or_reason(self.surface, hemi, "white")]
            if self.fwhm is not None:
                found[hemi] += [digest_or_reason(self.label, hemi, "cortex.label")]
        return found

    def surface(self, hemi: str, kind: str) -> Path:
        """The file of one of its surfaces; raises if there is none."""
        return template_surface(self.folder, self.side(hemi), kind)


def template(name: str, fwhm: float | None = None, *, xhemi: bool = False) -> Template:
    """The template of a name: a folder, or a sample such as ``"fsaverage5"``.

    Raises
    ------
    FileNotFoundError
        If there is neither.
    ValueError
        If ``fwhm`` is not a positive length, or the folder has no sphere, or no white surface.
    """
    if fwhm is not None and not (np.isfinite(fwhm) and fwhm > 0):
        raise OutOfRange(f"smoothing must be a positive width in mm, got {fwhm!r}.")
    folder = template_folder(name)
    found = Template(folder.name, str(folder), fwhm, xhemi)
    hemis = [hemi for hemi in HEMIS if found.has_sphere(hemi)]
    if not hemis:
        found.sphere(HEMIS[0])  # raises
    for hemi in hemis:
        found.surface(hemi, "white")  # which statistics need, too
    return found


def digest_or_reason(find: Callable[..., Path], *what: str | Path) -> str:
    try:
        return sha256_of(find(*what))
    except INPUT_ERRORS as error:
        return str(error)
