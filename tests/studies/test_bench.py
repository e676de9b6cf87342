"""``python3 run.py bench``: its help and its examples; the studies themselves have files of their own."""

import shlex
import subprocess
import sys

from morphofold.studies.bench import EXAMPLES, main, parser
from morphofold.studies.pages.commands import subcommands


def test_every_benchmark_has_help_with_an_example_that_is_understood(capsys):
    shown = []
    for name, question in subcommands(parser()).items():
        assert main([name, "--help"]) == 0
        assert capsys.readouterr().out.startswith("Example")
        for line in question.examples:
            words = shlex.split(line)
            assert words[:4] == ["python3", "run.py", "bench", name]
            assert parser().parse_args(words[3:]).what == name  # leaves the test with what is wrong
        shown += question.examples
    assert shown == list(EXAMPLES)


def test_the_module_is_a_program_whose_errors_name_it():
    argv = [sys.executable, "-m", "morphofold.studies.bench", "speed", "--seconds", "nan"]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("run.py bench: --seconds ")
    assert done.stderr.endswith(" [out-of-range]\n")
