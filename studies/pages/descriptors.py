"""Descriptions of commands for other programs, from the parser: Boutiques, and a Snakefile.

``python -m morphofold.studies.pages.descriptors descriptors`` writes ``analyze.boutiques.json``, with which Boutiques
(and CBRAIN) runs ``morphofold analyze``, and ``Snakefile``, which analyzes each subject of a folder.
"""

import sys
from pathlib import Path
from typing import Any

from cyclopts.argument import Argument

from morphofold import __version__
from morphofold.cli import app
from morphofold.digests_and_json import strict_json
from morphofold.io.files import write_text
from morphofold.studies.pages.command_pages import meaning, value_word

#: no options of a pipeline whose input is a folder: for a person at a terminal, or for another kind of input
HIDDEN = (
    *("--debug", "--json", "--into-subject", "--white", "--pial", "--surface", "--subject", "--subjects-dir"),
    *("--thickness", "--mask", "--sphere", "--name"),
)
OF_ONE_FOLDER = ("--stages", "--layout", "--out", "--threads", "--quiet")  # not of the Snakefile's rule
TYPES = {"": "Flag", "INT": "Number", "FLOAT": "Number", "TEXT": "String", "PATH": "File"}
SNAKEFILE = """# Analyze every subject of a folder, with options such as accuracy=draft:
# snakemake --cores 2 --config subjects=SUBJECTS_DIR out=OUT accuracy=draft no_report=true
# A subject of which one hemisphere could not be measured (exit code 1) fails: add --keep-going for the others.
from pathlib import Path

SUBJECTS, OUT = Path(config["subjects"]), Path(config["out"])
NAMES = sorted(surf.parent.name for surf in SUBJECTS.glob("*/surf"))
FLAGS = {flags}
WITH_VALUE = {with_value}
OPTIONS = [f"--{{key.replace('_', '-')}}" for key in FLAGS if str(config.get(key, "")).lower() in ("1", "true", "yes")]
OPTIONS += [f"--{{key.replace('_', '-')}}={{config[key]}}" for key in WITH_VALUE if key in config]


rule all:
    input:
        expand(OUT / "{{subject}}" / "summary.json", subject=NAMES),


rule analyze:
    input:
        SUBJECTS / "{{subject}}" / "surf",
    output:
        OUT / "{{subject}}" / "summary.json",
    threads: 1
    shell:
        "morphofold analyze {{SUBJECTS:q}}/{{wildcards.subject:q}} -o {{OUT:q}}/{{wildcards.subject:q}} "
        "--threads {{threads}} {{OPTIONS:q}}"
"""


def arguments(command: str) -> list[Argument]:
    """The arguments of a command that a pipeline may give."""
    collection = app()[command].assemble_argument_collection(parse_docstring=True)
    return [argument for argument in collection if argument.name not in HIDDEN]


def boutiques(command: str) -> dict[str, Any]:
    """A descriptor of a command in Boutiques' schema 0.5."""
    inputs: list[dict[str, Any]] = []
    for argument in arguments(command):
        name = argument.name.lstrip("-").replace("-", "_")
        choices = argument.get_choices()
        is_out = name == "out"
        entry = {"id": name, "name": name.replace("_", " "), "value-key": f"[{name.upper()}]", "optional": not is_out}
        entry["type"] = "String" if choices or is_out else TYPES[value_word(argument)]
        entry["description"] = "Folder to write." if is_out else meaning(argument)
        if value_word(argument) == "INT":
            entry["integer"] = True
        if argument.index is None:
            entry["command-line-flag"] = argument.name
        else:
            entry |= {"type": "File", "optional": False}
        if choices:
            entry["value-choices"] = list(choices)
        inputs.append(entry)
    keys = " ".join(entry["value-key"] for entry in inputs)
    out = {"id": "folder", "name": "folder of results", "path-template": "[OUT]", "optional": False}
    return {
        "name": f"morphofold {command}",
        "description": " ".join((app()[command].help or "").partition("For example:")[0].split()),
        "tool-version": __version__,
        "schema-version": "0.5",
        "command-line": f"morphofold {command} {keys}",
        "inputs": inputs,
        "output-files": [out],
    }


def snakefile() -> str:
    """A Snakefile with a rule for ``morphofold analyze``, whose options are keys of ``--config``."""
    given = [a for a in arguments("analyze") if a.index is None and a.name not in OF_ONE_FOLDER]
    key_of = {a.name: a.name[2:].replace("-", "_") for a in given}  # what Snakemake takes as a name
    flags = [key_of[a.name] for a in given if not value_word(a)]
    with_value = [key_of[a.name] for a in given if value_word(a)]
    return SNAKEFILE.format(flags=flags, with_value=with_value)


def write_descriptors(folder: Path) -> None:
    """Write both files."""
    folder.mkdir(exist_ok=True)
    write_text(folder / "analyze.boutiques.json", strict_json(boutiques("analyze")))
    write_text(folder / "Snakefile", snakefile())


if __name__ == "__main__":
    write_descriptors(Path(sys.argv[1]))
