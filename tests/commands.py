"""Commands as a user gives them."""

import json

import pytest

from morphofold import cli
from morphofold.studies import bench


def main(argv):
    """Exit code of ``morphofold`` with these arguments, or of ``python3 run.py`` where the first is bench."""
    return bench.main(argv[1:]) if argv[:1] == ["bench"] else cli.main(argv)


def run_json(argv, capsys):
    """What a command with --json prints; it ends with 0."""
    assert main(argv) == 0
    printed = capsys.readouterr().out
    return json.loads(printed[printed.index("{") :], parse_constant=pytest.fail)


def refused(capsys, argv, *phrases):
    """The line of a command that ends with 2; it says all the words and shows no traceback."""
    assert main(argv) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.strip().splitlines()) == 1
    assert [phrase for phrase in phrases if phrase not in captured.err] == []
    assert "Traceback" not in captured.err
    assert "defect" not in captured.err
    return captured.err


def refused_run(capsys, *words, scene, settings):
    """What ``simulate`` into the folder ``run`` says where it is refused."""
    return refused(capsys, ["simulate", scene, "-o", "run", "-q", *(w for s in settings for w in ("--set", s)), *words])
