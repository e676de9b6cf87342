"""The BIDS derivatives dataset that subjects are written to: its own files, and what is refused.

Of the files of a subject BIDS defines only the regions (``_dseg.label.gii``). All others are in ``.bidsignore``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from morphofold import __version__
from morphofold.errors import NotReadable
from morphofold.io import atomic_file
from morphofold.io.json_files import Record, read_json
from morphofold.provenance import printable, strict_json
from morphofold.results.layouts import Layout

BIDSIGNORE_LINES = Path(__file__).with_name("bidsignore.txt").read_text(encoding="utf-8")
README_TEXT = Path(__file__).with_name("dataset_readme.md").read_text(encoding="utf-8")


def begin_dataset(dataset: Path, ignoring: Sequence[str] = ()) -> None:
    """Make a folder a dataset to which subjects can be written; names ``ignoring`` are added to ``.bidsignore``.

    Raises
    ------
    FileExistsError
        If it contains something else.
    """
    refuse_other_dataset(dataset)
    dataset.mkdir(parents=True, exist_ok=True)
    write_dataset_files(dataset, ignoring)


def subject_place(dataset: Path, name: str) -> Path:
    """Folder in a dataset to which a subject of this name is written; raises as ``write_dataset``."""
    label = "".join(c for c in name.removeprefix("sub-") if c.isascii() and c.isalnum())
    if not label:
        raise NotReadable(f"{name!r}: BIDS names subjects by letters and digits, but this has none. Pass another name.")
    refuse_other_dataset(dataset)
    place = dataset / f"sub-{label}"
    other = _json_or_empty(Layout(place, place.name).path("summary")).get("subject", printable(name))
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


def write_dataset_files(dataset: Path, ignoring: Sequence[str] = ()) -> None:
    """Write the files that make a folder a dataset; in a dataset of an older version, bring them up to date."""
    content = _our_description(dataset)
    if not content:
        content = {
            "Name": "Cortical morphometry by morphofold",
            "BIDSVersion": "1.11.1",
            "DatasetType": "derivative",
            "GeneratedBy": [],
        }
        _write(dataset / "README.md", README_TEXT)
    others = [maker for maker in content["GeneratedBy"] if not _is_morphofold(maker)]
    content["GeneratedBy"] = [*others, {"Name": "morphofold", "Version": __version__}]
    ignored = dataset / ".bidsignore"
    lines = ignored.read_text(encoding="utf-8").splitlines() if ignored.is_file() else []
    _write(ignored, "\n".join([*dict.fromkeys([*lines, *BIDSIGNORE_LINES.splitlines(), *ignoring]), ""]))
    _write(dataset / "dataset_description.json", strict_json(content))


def _our_description(dataset: Path) -> dict[str, Any]:
    """The description of a dataset that morphofold wrote; empty for any other folder."""
    content = _json_or_empty(dataset / "dataset_description.json")
    makers = content.get("GeneratedBy")
    ours = isinstance(makers, list) and any(map(_is_morphofold, makers)) and content.get("DatasetType") == "derivative"
    return content if ours else {}


def _is_morphofold(maker: Any) -> bool:
    return isinstance(maker, dict) and maker.get("Name") == "morphofold"


def _json_or_empty(path: Path) -> dict[str, Any]:
    """Content of a JSON object; empty if it can't be read."""
    try:
        return read_json(path, Record, "")
    except (OSError, ValueError):
        return {}


def _write(path: Path, text: str) -> None:
    with atomic_file(path) as file:
        file.write_text(text, encoding="utf-8")
