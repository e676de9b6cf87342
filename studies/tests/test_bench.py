"""``python3 run.py bench``: its help and its examples; the studies themselves have files of their own."""

import re
import shlex
import subprocess
import sys

from morphofold.cli import parsed
from morphofold.studies.bench import app, main
from morphofold.studies.pages.command_pages import commands_below


def test_every_benchmark_has_help_with_an_example_that_is_understood(capsys):
    for (name,), command in commands_below(app()):
        assert main([name, "--help"]) == 0
        assert "python3 run.py bench" in capsys.readouterr().out
        for line in re.findall("- `(.*)`", command.help):
            words = shlex.split(line)
            assert words[:4] == ["python3", "run.py", "bench", name]
            assert type(parsed(app(), words[3:])).__name__.lower() == name


def test_the_module_is_a_program_whose_errors_name_it():
    argv = [sys.executable, "-m", "morphofold.studies.bench", "speed", "--seconds", "nan"]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("run.py bench speed: --seconds ")
    assert done.stderr.endswith(" [out-of-range]\n")
