"""Analyses on disk: written in our own layout or as a subject of a BIDS dataset, and read from either."""

from morphofold.results.analyses import (
    COLUMNS,
    check_wide,
    is_analysis_of,
    read_analysis,
    read_pial,
    read_stages,
    write_analysis,
    write_dataset,
)
from morphofold.results.dataset import subject_place
from morphofold.results.subject_files import check_subject, write_into_subject

__all__ = [
    "COLUMNS",
    "check_subject",
    "check_wide",
    "is_analysis_of",
    "read_analysis",
    "read_pial",
    "read_stages",
    "subject_place",
    "write_analysis",
    "write_dataset",
    "write_into_subject",
]
