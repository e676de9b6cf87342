"""Lines of code are counted, and nothing else."""

from morphofold.studies.code_sizes import code_lines, functions

SOURCE = '''"""A module."""

# a comment
TEXT = """two
lines"""


def one(x):
    """What it
    does."""
    return x            # the same


class Two:
    """A class."""

    field: int = 3
    """Its text."""

    def three(self):

        return (
            3
        )
'''


def test_blank_lines_comments_and_docstrings_do_not_count():
    assert code_lines(SOURCE) == {4, 5, 8, 11, 14, 17, 20, 22, 23, 24}
    assert functions(SOURCE) == {"one": 2, "three": 4}
