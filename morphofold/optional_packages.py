"""Packages that only an extra of morphofold installs, and what to type if one of them, or any other, is missing."""

import importlib
import re
from importlib import metadata
from typing import Any


def import_optional(package: str) -> Any:
    """The module of a package that only an extra of morphofold installs.

    Raises
    ------
    ModuleNotFoundError
        If it is not installed, with a note that says what to type.
    """
    try:
        return importlib.import_module(package)
    except ModuleNotFoundError as error:
        raise with_cure(error) from None


def with_cure(error: ImportError) -> ImportError:
    """The error with a note: the extra that installs the package that is missing, or that morphofold is damaged.

    An error that names no module was raised with a message of its own, and stays as it is.
    """
    if error.name and not getattr(error, "__notes__", ()):
        extra = _extra_of(error.name.partition(".")[0])
        error.add_note(
            f"Install it: pip install 'morphofold[{extra}]'."
            if extra
            else "The installation is damaged. Reinstall it: pip install --force-reinstall morphofold."
        )
    return error


def _extra_of(package: str) -> str:
    """The first extra of morphofold that names the package; empty if none does."""
    try:
        requirements = metadata.requires("morphofold") or []
    except metadata.PackageNotFoundError:  # a checkout on Python's path
        return ""
    for requirement in requirements:
        name, _, marker = requirement.partition(";")
        extra = re.search(r"extra == ['\"]([\w-]+)", marker)
        if extra and not name.startswith("morphofold") and re.search(rf"\b{re.escape(package)}\b", name):
            return extra[1]
    return ""
