"""What a package that is not installed says: the extra that has it, or that the installation is damaged."""

import sys
from importlib import metadata

import pytest

from morphofold.cli import main
from morphofold.lazy import importer
from morphofold.optional_packages import import_optional, with_cure

REQUIREMENTS = ["numpy>=2.0", 'dask[distributed]>=2024.12; extra == "group"', "nilearn>=0.11; extra == 'nilearn'"]


@pytest.mark.parametrize(
    ("requirements", "package", "words"),
    [
        (REQUIREMENTS, "distributed.system", "morphofold[group]"),
        (REQUIREMENTS, "nilearn", "morphofold[nilearn]"),
        (REQUIREMENTS, "numpy.nothing", "--force-reinstall"),
        (None, "dask", "--force-reinstall"),
    ],
)
def test_a_missing_package_is_named_with_what_to_type(monkeypatch, requirements, package, words):
    monkeypatch.setattr(metadata, "requires", lambda name: requirements)
    (note,) = with_cure(ModuleNotFoundError("no", name=package)).__notes__
    assert words in note


def test_a_module_that_is_there_is_imported_and_another_is_not():
    assert import_optional("json").loads("1") == 1
    with pytest.raises(ModuleNotFoundError) as caught:
        import_optional("no_such_package")
    assert len(caught.value.__notes__) == 1


def test_a_public_name_whose_package_is_missing_says_what_to_type(monkeypatch):
    monkeypatch.setattr(metadata, "requires", lambda name: REQUIREMENTS)
    value_of = importer("morphofold", {"Client": "nilearn_of_nobody", "nothing": "dask.no_such_module"})
    for name, words in (("Client", "--force-reinstall"), ("nothing", "morphofold[group]")):
        with pytest.raises(ModuleNotFoundError) as caught:
            value_of(name)
        assert words in caught.value.__notes__[0]


def test_a_command_without_its_package_ends_with_one_line_and_code_1(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(metadata, "requires", lambda name: REQUIREMENTS)
    monkeypatch.setitem(sys.modules, "distributed", None)  # as if it were not installed
    monkeypatch.setattr("morphofold.cli.resolve_name", lambda name: import_optional("distributed"))
    assert main(["overlap", str(tmp_path)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("morphofold overlap: ")
    assert "pip install 'morphofold[group]'" in line
