"""Analyses on disk: written in our own layout or as a subject of a BIDS dataset, and read from either."""

from morphofold.results.bids import subject_place, write_dataset
from morphofold.results.into_subject import check_subject, write_into_subject
from morphofold.results.plain import check_wide, write_analysis
from morphofold.results.reading import is_analysis_of, read_analysis, read_pial, read_stages
from morphofold.results.summary import COLUMNS

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
