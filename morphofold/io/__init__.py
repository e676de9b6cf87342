"""Read and write files: surfaces, per-vertex maps, regions and whole cortices."""

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

__all__ = [
    "atomic_file",
    "atomic_folder",
    "begin_collection",
    "files_of",
    "flip_curvature_sign",
    "read_annotation",
    "read_cortex",
    "read_label",
    "read_morph",
    "read_surface",
    "refuse_foreign",
    "refuse_no_collection",
    "remove_folder",
    "sample_path",
    "scanner_transform",
    "write_annotation",
    "write_gifti_map",
    "write_label",
    "write_morph",
    "write_surface",
]
