"""Sentences of docs/cohorts.md have the numbers of the tables there and of the code."""

from morphofold.analysis.curvatures import CURVATURE_SCALE_MM
from morphofold.group import group_distributions as distributions
from morphofold.group.clusters import EXTENT_POWER, HEIGHT_POWER
from morphofold.group.design import ALLOWED_CALLS
from morphofold.group.group_tables import LEAST_POOLED_SHARE
from morphofold.group.measure_subject import COARSEST_MESH_RATIO, MOST_SUBJECTS_READ
from morphofold.group.overlap import DENSITY_FWHM_MM
from morphofold.group.permuted_model import FORMING_P
from morphofold.group.workers import MOST_WORKER_DEATHS, SETTINGS
from morphofold.group_pages.cohort_page import MOST_PICTURED_SUBJECTS
from morphofold.studies.page_sentences import Page

PAGE = Page("cohorts")


def test_costs_are_those_of_the_tables():
    (rows,) = PAGE.tables("cost")
    adult, load = rows[0], PAGE.tsv_rows("load")[-1]
    seconds, megabytes = adult["seconds"], adult["MB on disk"]
    PAGE.assert_sentence("An adult takes # s of one core", seconds)
    PAGE.assert_sentence("s of one core and # GiB", adult["GiB of a worker"], tolerance=0.05)
    PAGE.assert_sentence("500 adults without pages # hours of one core", 500 * seconds / 3600, tolerance=0.051)
    PAGE.assert_sentence("hours of one core and # GB (calculated)", 500 * megabytes / 1000, tolerance=0.51)
    times = [float(load[column].split()[0]) for column in ("overhead of each", "tables and page")]
    PAGE.assert_sentence(f"{load['subjects']} tiny subjects took # ms each, tables and page # s", *times)


def test_limits_are_those_of_the_code():
    PAGE.assert_sentence("from # subjects at most", MOST_SUBJECTS_READ)
    PAGE.assert_sentence("(# mm for FreeSurfer's meshes)", CURVATURE_SCALE_MM)
    PAGE.assert_sentence("(by area, E = #, H = #)", EXTENT_POWER, HEIGHT_POWER)
    PAGE.assert_sentence("clusters above a two-sided p of #", FORMING_P, tolerance=0)
    PAGE.assert_sentence("are smoothed by # mm", DENSITY_FWHM_MM)
    PAGE.assert_sentence("robust z, # (x - median)", distributions.NORMAL_MAD_OVER_SD, tolerance=0)
    PAGE.assert_sentence("above # in size", distributions.OUTLIER_Z)
    for name in ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_"):
        PAGE.assert_sentence(f"{name}=#", float(SETTINGS["distributed.nanny.pre-spawn-environ"][name]))


def test_limits_in_words_are_those_of_the_code():
    limit_of_words = {
        "over twice as coarse as the median": COARSEST_MESH_RATIO == 2,
        "if more than half have these": LEAST_POOLED_SHARE == 0.5,
        "after three workers it counts as failed": MOST_WORKER_DEATHS == 3,
        "of eight values or more": distributions.FEWEST_FOR_OUTLIERS == 8,
        "Twelve are drawn": MOST_PICTURED_SUBJECTS == 12,
    }
    assert all(is_limit and words in PAGE.prose for words, is_limit in limit_of_words.items())
    assert all(f"`{call}" in PAGE.prose for call in ALLOWED_CALLS)
