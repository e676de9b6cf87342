"""The BIDS derivatives dataset that subjects are written to: its own files, and what is refused.

Of the files of a subject BIDS defines only the regions (``_dseg.label.gii``). All others are in ``.bidsignore``.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from morphofold import __version__
from morphofold.errors import NotReadable
from morphofold.io.files import write_text
from morphofold.io.json_files import Record, read_json, write_json
from morphofold.provenance import printable
from morphofold.results.layouts import Layout

BIDSIGNORE_LINES = Path(__file__).with_name("bidsignore.txt").read_text(encoding="utf-8").splitlines()
README_TEXT = Path(__file__).with_name("dataset_readme.md").read_text(encoding="utf-8")
NEW_DESCRIPTION: dict[str, Any] = {
    "Name": "Cortical morphometry by morphofold",
    "BIDSVersion": "1.11.1",
    "DatasetType": "derivative",
    "GeneratedBy": [],
}


class _Description(Record):
    """``dataset_description.json`` of derivatives."""

    DatasetType: Literal["derivative"]
    GeneratedBy: list[dict[str, Any]]


def subject_place(dataset: Path, name: str) -> Path:
    """Folder in a dataset to which a subject of this name is written.

    Raises
    ------
    NotReadable
        If ``name`` has no letters or digits.
    FileExistsError
        If morphofold did not write ``dataset``, or the folder holds a subject with another name that shortens to the
        same.
    """
    label = "".join(c for c in name.removeprefix("sub-") if c.isascii() and c.isalnum())
    if not label:
        raise NotReadable(f"{name!r}: BIDS names subjects by letters and digits, but this has none. Pass another name.")
    refuse_other_dataset(dataset)
    place = dataset / f"sub-{label}"
    other = _json_or_empty(Layout(place, place.name).path("summary"), Record).get("subject", printable(name))
    if other != printable(name):
        raise FileExistsError(f"{place}: holds {other!r}, and {name!r} becomes the same BIDS name. Pass another name.")
    return place


def refuse_other_dataset(dataset: Path) -> None:
    """Raise ``FileExistsError`` if a folder contains anything but a dataset that morphofold wrote."""
    if not dataset.exists() or _our_description(dataset):  # read first, because it is quick for any number of files
        return
    if not dataset.is_dir() or any(not path.name.startswith(".") for path in dataset.iterdir()):
        raise FileExistsError(
            f"{dataset}: is not a BIDS dataset whose dataset_description.json names morphofold. Name such a dataset, "
            "or a new folder."
        )


def begin_dataset(dataset: Path, ignoring: Sequence[str] = ()) -> None:
    """Write the files that make a folder a dataset, or bring those of an older version up to date.

    ``ignoring`` are further lines of ``.bidsignore``. :func:`refuse_other_dataset` is asked before.
    """
    dataset.mkdir(parents=True, exist_ok=True)
    content, ignored = _our_description(dataset), dataset / ".bidsignore"
    if not content:
        write_text(dataset / "README.md", README_TEXT)
    lines = ignored.read_text(encoding="utf-8").splitlines() if ignored.is_file() else []
    write_text(ignored, "\n".join([*dict.fromkeys([*lines, *BIDSIGNORE_LINES, *ignoring]), ""]))
    content = content or NEW_DESCRIPTION
    others = [maker for maker in content["GeneratedBy"] if maker.get("Name") != "morphofold"]
    makers = [*others, {"Name": "morphofold", "Version": __version__}]
    write_json(dataset / "dataset_description.json", content | {"GeneratedBy": makers})


def _our_description(dataset: Path) -> dict[str, Any]:
    """The description of a dataset that morphofold wrote; empty for any other folder."""
    content = _json_or_empty(dataset / "dataset_description.json", _Description)
    return content if any(maker.get("Name") == "morphofold" for maker in content.get("GeneratedBy", [])) else {}


def _json_or_empty(path: Path, schema: type[Record]) -> dict[str, Any]:
    """Content of a JSON object; empty if it can't be read."""
    try:
        return read_json(path, schema, "")
    except (OSError, ValueError):
        return {}
