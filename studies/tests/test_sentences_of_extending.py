"""docs/how-it-is-built.md names every package, docs/extending.md has the numbers of the code."""

import re

from morphofold.sim.dynamics import STEPS_PER_MEASUREMENT
from morphofold.studies.import_layers import PACKAGE_ORDER
from morphofold.studies.page_sentences import Page


def test_the_table_of_packages_has_every_package_in_order():
    rows = re.findall(r"^\| (.*?) \| ", Page("how-it-is-built").text, re.M)[2:]
    names = [name.strip("` ").removesuffix(".py") for row in rows for name in row.split(",")]
    assert names == [*PACKAGE_ORDER]


def test_hooks_are_called_as_often_as_the_page_says():
    page = Page("extending")
    page.assert_sentence("a function that is called every # steps", STEPS_PER_MEASUREMENT, tolerance=0)
    assert len(re.findall(rf"\| every {STEPS_PER_MEASUREMENT} steps \|", page.text)) == 2
