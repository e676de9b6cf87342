"""Random damage of every format ends in the same, something else that is whole, or one clear line."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hard_cases.cases import hard_case
from hard_cases.made_files import needs_linux

SCRIPT = Path(__file__).with_name("fuzz.py")


def fuzzed(seconds, seed, *words):
    """Files read and findings, of the script in a process of its own."""
    needs_linux()
    command = [sys.executable, str(SCRIPT), "--seconds", str(seconds), "--seed", str(seed), *words]
    environment = {**os.environ, "NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    count, _, _, findings, _ = done.stdout.splitlines()[-1].split()
    return int(count), int(findings), done.stdout


@pytest.mark.slow
@hard_case(
    "files",
    "a minute of random damage of files of every format",
    peers="meshio, nibabel, VTK: hangs, ends of the process, dozens of exceptions (measured)",
)
def test_a_minute_of_fuzzing(holds):
    count, findings, output = fuzzed(60, 20150901)
    holds("files read", count, at_least=1000)
    holds("hangs, crashes, unclear errors", findings, at_most=0)
    assert not findings, output
