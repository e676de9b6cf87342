"""The files of ``morphofold overlap``: maps, the table of regions, summary.json and a page."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from morphofold import __version__
from morphofold.group.overlap import COLUMNS, WHOLE, Overlap
from morphofold.group.spaces import Space
from morphofold.io import atomic_folder, write_gifti_map, write_morph
from morphofold.io.json_files import write_json
from morphofold.tables import write_table

#: draws the page of a study with its summary into a folder
DrawOverlap = Callable[[Space, Sequence[Overlap], Mapping[str, Any], Path], object]
DENSITY_MAPS = {"hinges": "hinge_density", "crests": "crest_density"}


def write_overlap(
    space: Space,
    found: Sequence[Overlap],
    summary: Mapping[str, Any],
    out: str | Path,
    report: DrawOverlap | None = None,
) -> Path:
    """Write what hinges and crests of a study have in common, completely or not at all.

    ``overlap.tsv`` has the rows of each :class:`Overlap`; ``maps/?h.hinge_density.shape.gii`` [1/cm^2] and
    ``?h.crest_density`` [mm/cm^2] the densities, ``..._chance`` what is expected by chance, and ``..._p`` the corrected
    p; each also in FreeSurfer's format.
    """
    with atomic_folder(out) as folder:
        (folder / "maps").mkdir()
        for one in found:
            for ending, maps, unknown in (("", one.density, 0.0), ("_chance", one.chance, 0.0), ("_p", one.p, 1.0)):
                for hemi, values in maps.items():
                    file = folder / "maps" / f"{hemi}.{DENSITY_MAPS[one.kind]}{ending}"
                    side = space.side(hemi)
                    write_gifti_map(file.with_name(f"{file.name}.shape.gii"), values, nan=np.nan, hemi=side)
                    write_morph(file, values, nan=unknown)
        write_table(folder / "overlap.tsv", COLUMNS, [row for one in found for row in one.rows])
        write_json(folder / "summary.json", summary)
        if report is not None:
            report(space, found, summary, folder)
    return Path(out)


def overlap_summary(space: Space, found: Sequence[Overlap], *, fwhm: float, spins: int, seed: int) -> dict[str, Any]:
    """What was compared and found, as JSON; numbers of whole hemispheres only."""
    return {
        "morphofold": __version__,
        "space": space.folder.parent.name,
        "radius_mm": found[0].radius,
        "density_fwhm_mm": fwhm,
        "rotations": spins,
        "seed": seed,
        "hemispheres": [row for one in found for row in one.rows if row["region"] == WHOLE],
        "smallest_density_p": {one.kind: {hemi: float(np.nanmin(p)) for hemi, p in one.p.items()} for one in found},
    }
