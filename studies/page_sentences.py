"""Pages of the docs as tests read them: their tables, and the numbers in their sentences."""

import csv
import re
from collections.abc import Iterable
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"
Row = dict[str, float | str]


class Page:
    """A page of the docs, by its name without ``.md``; minus signs are read as hyphens."""

    def __init__(self, name: str):
        self.path = DOCS / f"{name}.md"
        self.text = self.path.read_text("utf-8").replace("−", "-")
        self.prose = " ".join(re.sub(r"<!-- ([\w-]+) -->.*?<!-- /\1 -->", "", self.text, flags=re.S).split())

    def tables(self, mark: str) -> list[list[Row]]:
        """The tables between marks, rows by column; a second column of a name ends in 2. Cells are numbers where they
        can be."""
        (part,) = re.findall(rf"<!-- {mark} -->(.*?)<!-- /{mark} -->", self.text, re.S)
        blocks = re.findall(r"(?:^\|.*\n)+", part, re.M)
        return [_rows([_cells(line) for k, line in enumerate(block.splitlines()) if k != 1]) for block in blocks]

    def tsv_rows(self, name: str) -> list[Row]:
        """All rows of the table ``PAGE-name.tsv`` beside the page, as those of :meth:`tables`."""
        tsv_file = self.path.with_name(f"{self.path.stem}-{name}.tsv")
        text = tsv_file.read_text("utf-8").replace("−", "-")
        return _rows([*csv.reader(text.splitlines(), delimiter="\t", quoting=csv.QUOTE_NONE)])

    def numbers(self, sentence: str) -> list[float]:
        """The numbers of a sentence that the page has once; each is a ``#`` in ``sentence``."""
        pattern = re.escape(sentence).replace(r"\#", r"(-?\d+(?:\.\d+)?)")
        (match,) = re.finditer(pattern, self.prose)
        return [float(number) for number in match.groups()]

    def assert_sentence(self, sentence: str, *values: float, tolerance: float = 0.001) -> None:
        """The page has this sentence once, and its numbers, each a ``#`` here, are the values."""
        numbers = self.numbers(sentence)
        assert len(numbers) == len(values), sentence
        differences = [abs(number - value) for number, value in zip(numbers, values)]
        assert all(difference <= tolerance for difference in differences), f"{sentence}: {numbers}, not {values}"


def spread(values: Iterable[float]) -> tuple[float, float]:
    """The least and the greatest of the values."""
    values = [*values]
    return min(values), max(values)


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.split("|")[1:-1]]


def _rows(lines: list[list[str]]) -> list[Row]:
    heads, *rows = lines
    heads = [f"{head} 2" if head in heads[:k] else head for k, head in enumerate(heads)]
    return [dict(zip(heads, map(_as_number, row))) for row in rows]


def _as_number(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell
