"""The tables of docs/tables.md: every column of the tables of an analysis, with its unit and type.

``python -m morphofold.studies.pages.column_page docs/tables.md`` writes them between the marks of that page.
"""

import sys
from pathlib import Path

from morphofold.analysis.measures_result import FRAMES, column_type
from morphofold.quantities import column_words
from morphofold.studies.markdown import table, update_page


def columns(table_name: str) -> str:
    """A row for each column of a table, as a DataFrame has them."""
    table_rows = []
    for column in FRAMES[table_name]:
        meaning, unit = column_words(column)
        table_rows.append((f"`{column}`", column_type(column), unit, meaning))
    return table(("column", "type", "unit", "meaning"), table_rows)


def write(page: Path) -> None:
    """Put the tables between the marks of ``page``; raises as :func:`morphofold.studies.markdown.renewed`."""
    parts_of_page = {table_name: [columns(table_name)] for table_name in FRAMES}
    update_page(page, parts_of_page)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
