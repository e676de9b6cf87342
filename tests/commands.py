"""Commands as a user gives them."""

from morphofold.cli import main


def refused(capsys, argv, *words):
    """The command ends with 2, says all the words in few lines, and shows no traceback."""
    assert main(argv) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert len(told.err.strip().splitlines()) == 1
    for word in words:
        assert word in told.err
    assert "Traceback" not in told.err
