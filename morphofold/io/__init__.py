"""Read and write files: surfaces, per-vertex maps, regions and whole cortices."""

# ruff: noqa: F401  (the public names, imported on first use)
from typing import TYPE_CHECKING

from morphofold.lazy import importer, public_names

if TYPE_CHECKING:
    from morphofold.io.cortices import read_cortex, sample_path
    from morphofold.io.files import atomic_file
    from morphofold.io.folders import (
        atomic_folder,
        begin_collection,
        files_of,
        refuse_foreign,
        refuse_no_collection,
        remove_folder,
    )
    from morphofold.io.formats import (
        read_annotation,
        read_label,
        read_morph,
        read_surface,
        write_annotation,
        write_gifti_map,
        write_label,
        write_morph,
        write_surface,
    )
    from morphofold.io.freesurfer import flip_curvature_sign, scanner_transform

_PUBLIC = public_names(__file__)
__all__ = sorted(_PUBLIC)
__getattr__ = importer(__name__, _PUBLIC)
