"""Files and folders. Begin at ``read_cortex``, which makes a ``Cortex`` of a folder, or at ``read_surface``,
``write_morph`` and so on for one file.

``cortices`` finds the files of a hemisphere; ``formats`` chooses the format of a file, whose bytes ``freesurfer``,
``gifti`` and ``mesh_files`` read. ``files`` checks a path and writes a file completely or not at all;
``atomic_folders`` does so with folders of results; ``json_files`` reads JSON by a schema.
"""

# ruff: noqa: F401  (the public names, imported on first use)
from typing import TYPE_CHECKING

from morphofold.lazy import importer, public_names

if TYPE_CHECKING:
    from morphofold.io.atomic_folders import (
        atomic_folder,
        begin_collection,
        files_of,
        refuse_foreign,
        refuse_no_collection,
        remove_folder,
    )
    from morphofold.io.cortices import read_cortex, sample_path
    from morphofold.io.files import atomic_file
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
