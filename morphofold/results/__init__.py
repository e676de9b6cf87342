"""Analyses on disk: written in our own layout or as a subject of a BIDS dataset, and read from either."""

# ruff: noqa: F401  (the public names, imported on first use)
from typing import TYPE_CHECKING

from morphofold.lazy import importer, public_names

if TYPE_CHECKING:
    from morphofold.results.analysis_files import (
        COLUMNS,
        check_wide,
        is_analysis_of,
        read_analysis,
        read_pial,
        read_stages,
        write_analysis,
        write_dataset,
    )
    from morphofold.results.freesurfer_results import check_subject, write_into_subject
    from morphofold.results.layouts import subject_place

_PUBLIC = public_names(__file__)
__all__ = sorted(_PUBLIC)
__getattr__ = importer(__name__, _PUBLIC)
