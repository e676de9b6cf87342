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

HIDDEN = ("--debug", "--json", "--into-subject")  # no options of a pipeline
TYPES = {"": "Flag", "INT": "Number", "FLOAT": "Number", "TEXT": "String", "PATH": "File"}
SNAKEFILE = """# Analyze every subject of a folder, with options such as accuracy=draft:
# snakemake --cores 2 --config subjects=SUBJECTS_DIR out=OUT accuracy=draft
from pathlib import Path

SUBJECTS, OUT = Path(config["subjects"]), Path(config["out"])
NAMES = sorted(surf.parent.name for surf in SUBJECTS.glob("*/surf"))
FLAGS = {flags}
WITH_VALUE = {with_value}
OPTIONS = [f"--{{name}}" for name in FLAGS if config.get(name)]
OPTIONS += [f"--{{name}}={{config[name]}}" for name in WITH_VALUE if name in config]


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
        "morphofold analyze {{SUBJECTS}}/{{wildcards.subject}} -o {{OUT}}/{{wildcards.subject}} "
        "--threads {{threads}} {{OPTIONS}}"
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
        entry["description"] = meaning(argument)
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
    given = [a for a in arguments("analyze") if a.index is None and a.name not in ("--out", "--threads", "--quiet")]
    of_many = [a for a in given if value_word(a) != "PATH" and a.name not in ("--subject", "--subjects-dir", "--name")]
    flags = [a.name[2:] for a in of_many if not value_word(a)]
    with_value = [a.name[2:] for a in of_many if value_word(a)]
    return SNAKEFILE.format(flags=flags, with_value=with_value)


def write_descriptors(folder: Path) -> None:
    """Write both files."""
    folder.mkdir(exist_ok=True)
    write_text(folder / "analyze.boutiques.json", strict_json(boutiques("analyze")))
    write_text(folder / "Snakefile", snakefile())


if __name__ == "__main__":
    write_descriptors(Path(sys.argv[1]))
