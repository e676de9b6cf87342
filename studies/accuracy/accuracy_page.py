"""The generated parts of docs/accuracy.md, and the table that forecasts read, from a study.

``python -m morphofold.studies.accuracy.accuracy_page OUT PAGE --table FILE``: OUT is the folder that ``python3 run.py
bench accuracy -o OUT`` wrote. Parts are written between marks such as ``<!-- answer -->`` and ``<!-- /answer -->``:
the rows that matter most, of tables that go to TSV files beside PAGE, as do the pictures. Text outside of the marks is
written by hand.
"""

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cyclopts

from morphofold.digests_and_json import strict_json
from morphofold.errors import MissingPart, WrongFile
from morphofold.io.files import write_text
from morphofold.io.json_files import read_json
from morphofold.studies.accuracy.accuracy_plots import bounded
from morphofold.studies.accuracy.accuracy_report import CONTENT_TEXT
from morphofold.studies.accuracy.accuracy_study import HALVES, PEER_NAMES
from morphofold.studies.accuracy.error_points import OTHER_PEER, OUR_CODE
from morphofold.studies.accuracy.folds_by_mesh import FINEST_MESH, OWN_LIMIT
from morphofold.studies.index_schemas import AccuracyIndex
from morphofold.studies.markdown import Row, number, renewed, table_with_tsv
from morphofold.tables import read_table

TEXT_KEYS = ("half", "subject", "quantity", "against", "method", "axis", "setting", "preset", "dominated_by")
CURE_ADVICE = "Name the folder that `python3 run.py bench accuracy -o FOLDER` wrote."
#: of a law of several seeds, by carried_states; it is taken for all edges that were studied
SEEDS_KEYS = ("coefficient", "power", "spread", "against", "finest", "coarsest")
PRESET_NAMES = ("draft", "standard", "fine", "finest")
#: subjects, quantities and references of the rows that the page shows; the TSV files beside it have all
SHOWN = (
    ("bumpy sphere", "mean curvature", "exact"),
    ("parallel surfaces", "cortical thickness", "exact"),
    ("S1, pial", "mean curvature", "split surface"),
    ("S1", "mean cortical thickness", "split surface"),
    ("S1", "hinges", "split surface"),
    ("fig6-thick, octant", "gyrification index, g = 2", FINEST_MESH),
    ("fig6-thick, octant", "gyrification index, g = 2", OWN_LIMIT),
    ("fig6-thick, octant", "wavelength, g = 2", FINEST_MESH),
)
SHOWN_PEERS = (
    ("bumpy sphere, 1 % noise", "libigl principal_curvature, 5 rings"),
    ("bumpy sphere, 1 % noise", "pyvista curvature"),
    ("parallel surfaces", "libigl point_mesh_squared_distance"),
    ("parallel surfaces", "scipy cKDTree of vertices"),
)
PEER_COLUMNS = (
    "subject | quantity | vertices or elements | peer | peer time (range) | our time (range) | "
    "peer time / ours | peer error | our error"
)


def read_study(out: Path) -> tuple[dict[str, Any], dict[str, list[Row]]]:
    """Summary and tables of a study.

    Raises
    ------
    FileNotFoundError
        If the folder holds no summary, or lacks a file that the summary names.
    WrongFile
        If the summary is of another command.
    """
    summary_file = out / "summary.json"
    summary = read_json(summary_file, AccuracyIndex, CURE_ADVICE)
    if summary["shows"] != CONTENT_TEXT:
        raise WrongFile(f"{summary_file}: is not the summary of a study of accuracy. {CURE_ADVICE}")
    names = ("points", "laws", "presets", "budget", "peers")
    return summary, {
        name: read_table(out / f"{name}.tsv", TEXT_KEYS) if f"{name}.tsv" in summary["files"] else [] for name in names
    }


def text_answers(out: Path) -> list[str]:
    """Lines of text with the time that half the error takes, one line per quantity."""
    _, tables = read_study(out)
    return [
        f"{row['subject']}, {row['quantity']}, {row['axis']}: half the error takes {_factor(row)} times as long"
        for row in tables["laws"]
        if row["half_the_error"] is not None and row["method"] == OUR_CODE
    ] or ["no law of the error was found"]


def write_page(out: Path, page: Path, *, table: Path | None = None) -> None:
    """Update the marked parts of ``page`` and the pictures beside it.

    Parameters
    ----------
    out : Path
        Folder of the study.
    page : Path
        With one pair of marks for each of ``PART_MAKERS``.
    table : Path, optional
        JSON file whose ``"errors"`` are updated.

    Raises
    ------
    FileNotFoundError, ValueError
        If the study, one of its halves, a page or a pair of marks is missing; then nothing is written.
    """
    summary, tables = read_study(out)
    if summary["halves"] != sorted(HALVES) or summary["errors"] is None:
        halves_text = " and ".join(summary["halves"]) or "nothing"
        raise MissingPart(f"{out}: holds only {halves_text}. The page needs both halves of the study.")
    old_text = page.read_text("utf-8")
    renewed(page, old_text, {name: () for name in PART_MAKERS})  # before a table beside the page is written
    text_by_part = {name: make_part(tables, summary, page) for name, make_part in PART_MAKERS.items()}
    text_by_path = {page: renewed(page, old_text, text_by_part)}
    if table is not None:
        content, error_table = json.loads(table.read_text("utf-8")), {**summary["errors"], "made": summary["made"]}
        of_seeds = content.get("errors", {}).get("quantities", {}).get("gyrification index", {})
        kept_law = {key: value for key, value in of_seeds.items() if key in SEEDS_KEYS}
        error_table["quantities"].get("gyrification index", {}).update(kept_law)
        text_by_path[table] = strict_json({**content, "errors": error_table})
    for path, text in text_by_path.items():
        write_text(path, text)
    for name in summary["files"]:
        if name.endswith(".png"):
            shutil.copyfile(out / name, page.parent / f"accuracy-{Path(name).name}")


def _factor(law_row: Mapping[str, Any]) -> str:
    time_factor, low_factor, high_factor = (law_row[f"half_the_error{suffix}"] for suffix in ("", "_low", "_high"))
    return f"{bounded(time_factor)} ({low_factor:.2g} to {bounded(high_factor)})"


def _power(law_row: Mapping[str, Any], quantity: str) -> str:
    if law_row[f"{quantity}_power"] is None:
        return "–"
    return f"{number(law_row[f'{quantity}_power'], '{:.2f}')} ± {law_row[f'{quantity}_power_pm']:.2f}"


def _percent(fraction: float | None) -> str:
    return "–" if fraction is None else f"{100 * fraction:.2g} %"


def _seconds(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 0.1 else f"{1000 * seconds:.3g} ms"


# parts ------------------------------------------------------------------------------------------------------


def _is_shown(cells: list[str], first: int = 0) -> bool:
    """Whether a row is among ``SHOWN``; its subject is in the cell number ``first``."""
    return tuple(cells[first : first + 3]) in SHOWN


def _answer(tables: Mapping[str, list[Row]], _: Any, page: Path) -> list[str]:
    heads = (
        "half | subject | quantity | against | refined | time scales with edge to the power | "
        "error scales with edge to the power | half the error takes so many times as long"
    )
    rows = []
    for row in tables["laws"]:
        if row["method"] == OUR_CODE and row["error_power"] is not None:
            factor_text = _factor(row) if row["half_the_error"] is not None else "not clear"
            first_cells = [row[column] for column in ("half", "subject", "quantity", "against", "axis")]
            rows.append([*first_cells, _power(row, "seconds"), _power(row, "error"), factor_text])
    return [table_with_tsv(page, "laws", heads, rows, lambda cells: _is_shown(cells, 1))]


def _presets(tables: Mapping[str, list[Row]], _: Any, page: Path) -> list[str]:
    rows = tables["presets"]
    if not rows:
        return ["No preset was studied."]
    row_by_preset: dict[tuple[str, ...], dict[str, Row]] = {}
    for row in rows:
        row_by_preset.setdefault((row["subject"], row["quantity"], row["against"]), {})[row["preset"]] = row
    table_rows = [
        [*key, *(_of_preset(by_preset.get(preset)) for preset in PRESET_NAMES)]
        for key, by_preset in row_by_preset.items()
    ]
    heads = ["subject", "quantity", "against", *PRESET_NAMES]
    return [table_with_tsv(page, "presets", heads, table_rows, _is_shown)]


def _of_preset(preset_row: Mapping[str, Any] | None) -> str:
    if preset_row is None:
        return "–"
    law_text = f" (by law {_percent(preset_row['error_by_law'])})" if preset_row["error_by_law"] is not None else ""
    error_text = f"**{_percent(preset_row['error'])}**" if preset_row["front"] else _percent(preset_row["error"])
    return f"{error_text}{law_text} in {_seconds(preset_row['seconds'])}"


def _budget(tables: Mapping[str, list[Row]], _: Any, page: Path) -> list[str]:
    rows = [row for row in tables["budget"] if row["against"] not in (FINEST_MESH, OWN_LIMIT)]
    quantities = list(dict.fromkeys(row["quantity"] for row in rows))
    axis_keys = list(dict.fromkeys((row["axis"], row["against"]) for row in rows if row["against"] != "theory"))
    table_rows = []
    for quantity in quantities:
        error_by_axis = {(row["axis"], row["against"]): row["error"] for row in rows if row["quantity"] == quantity}
        if any(axis_key in error_by_axis for axis_key in axis_keys):
            table_rows.append([quantity, *(_percent(error_by_axis.get(axis_key)) for axis_key in axis_keys)])
    if not table_rows:
        return ["No solver was studied."]
    heads = ["quantity", *(reference for _, reference in axis_keys)]
    return [table_with_tsv(page, "budget", heads, table_rows, lambda cells: cells[0].endswith("g = 2"))]


def _peers(tables: Mapping[str, list[Row]], summary: Any, page: Path) -> list[str]:
    """Some peers, on the largest mesh that each of them and we measured."""
    if not tables["peers"]:
        return [f"{summary['left_out'].get('peers', 'No peer was measured')}."]
    all_rows = _peer_cells(tables)  # meshes come from coarse to fine
    largest = {(cells[0], cells[1], cells[3]): cells for cells in all_rows}
    shown = [cells for cells in largest.values() if (cells[0], cells[3]) in SHOWN_PEERS and "Gaussian" not in cells[1]]
    return [table_with_tsv(page, "peers", PEER_COLUMNS, all_rows, lambda cells: cells in shown)]


def _peer_cells(tables: Mapping[str, list[Row]]) -> list[list[str]]:
    cell_rows = []
    for row in sorted(tables["peers"], key=lambda row: row["our_size"]):
        first_cells = row["subject"], row["quantity"], f"{row['our_size']:,}", row["method"]
        time_cells = _range(row, "") or row["setting"], _range(row, "our_"), number(row["seconds_ratio"], "{:.2g}")
        cell_rows.append([*first_cells, *time_cells, _percent(row["error"]), _percent(row["our_error"])])
    return cell_rows


def _range(row: Mapping[str, Any], prefix: str) -> str:
    """Median time and range; empty if the work failed."""
    if row[f"{prefix}seconds"] is None:
        return ""
    median, fastest, slowest = (_seconds(row[f"{prefix}{column}"]) for column in ("seconds", "fastest", "slowest"))
    return f"{median} ({fastest} to {slowest})"


def _dominated(tables: Mapping[str, list[Row]], _: Any, page: Path) -> list[str]:
    """How often each of our settings is on a front."""
    setting_flags: dict[tuple[str, str, str], list[int]] = {}
    for row in tables["points"]:
        if row["method"] == OUR_CODE and row["half"] == "solver" and row["against"] != OTHER_PEER:
            setting_flags.setdefault((row["axis"], row["setting"], row["preset"] or ""), []).append(int(row["front"]))
    rows = [
        [axis, setting + (f" ({preset})" if preset else ""), f"{sum(front_flags)} of {len(front_flags)}"]
        for (axis, setting, preset), front_flags in setting_flags.items()
    ]
    if not rows:
        return ["Nothing."]
    heads = ["axis", "setting", "quantities in which no setting dominates it"]
    is_preset = lambda cells: cells[0] in ("mesh", "nested meshes") and cells[1].endswith(")")
    return [table_with_tsv(page, "settings", heads, rows, is_preset)]


def _made(_: Any, summary: Mapping[str, Any], page: Path) -> list[str]:
    env = summary["made"]
    packages = [name for name in ("morphofold", "numpy", "scipy", "numba", "scikit-fem", *PEER_NAMES) if env.get(name)]
    versions = ", ".join(f"{name} {env[name]}" for name in packages)
    return [f"{env['processor']}, {env['threads']} threads of {env['cores']}; Python {env['python']}, {versions}."]


PART_MAKERS: dict[str, Callable[[Any, Any, Path], list[str]]] = {
    "answer": _answer,
    "presets": _presets,
    "budget": _budget,
    "dominated": _dominated,
    "peers": _peers,
    "made": _made,
}


if __name__ == "__main__":
    cyclopts.run(write_page)
