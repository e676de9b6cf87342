"""The generated parts of docs/accuracy.md, and the table that forecasts read, from a study.

``python -m morphofold.studies.accuracy.accuracy_page OUT PAGE --table FILE``: OUT is the folder that ``python3 run.py
bench accuracy -o OUT`` wrote. All peers go to accuracy-peers.tsv beside PAGE. Parts are written between marks such as
``<!-- answer -->`` and ``<!-- /answer -->``, pictures beside PAGE. Text outside of the marks is written by hand.
"""

import json
import shutil
from collections.abc import Mapping
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
from morphofold.studies.markdown import Row, number, renewed, table as markdown_table
from morphofold.tables import read_table

TEXT_KEYS = ("half", "subject", "quantity", "against", "method", "axis", "setting", "preset", "dominated_by")
CURE_ADVICE = "Name the folder that `python3 run.py bench accuracy -o FOLDER` wrote."
#: of a law of several seeds, by carried_states; it is taken for all edges that were studied
SEEDS_KEYS = ("coefficient", "power", "spread", "against", "finest", "coarsest")
PRESET_NAMES = ("draft", "standard", "fine", "finest")
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
    text_by_part = {name: make_part(tables, summary) for name, make_part in PART_MAKERS.items()}
    text_by_path = {page: renewed(page, page.read_text("utf-8"), text_by_part)}
    if table is not None:
        content, error_table = json.loads(table.read_text("utf-8")), {**summary["errors"], "made": summary["made"]}
        of_seeds = content.get("errors", {}).get("quantities", {}).get("gyrification index", {})
        kept_law = {key: value for key, value in of_seeds.items() if key in SEEDS_KEYS}
        error_table["quantities"].get("gyrification index", {}).update(kept_law)
        text_by_path[table] = strict_json({**content, "errors": error_table})
    if tables["peers"]:
        text_by_path[page.with_name("accuracy-peers.tsv")] = _all_peers(tables)
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


def _answer(tables: Mapping[str, list[Row]], _: Any) -> list[str]:
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
    return [markdown_table(heads, rows)]


def _presets(tables: Mapping[str, list[Row]], _: Any) -> list[str]:
    markdown_tables = []
    for half in ("solver", "measuring"):
        rows = [row for row in tables["presets"] if row["half"] == half]
        group_keys = list(dict.fromkeys((row["subject"], row["quantity"], row["against"]) for row in rows))
        table_rows = []
        for group_key in group_keys:
            row_by_preset = {
                row["preset"]: row for row in rows if (row["subject"], row["quantity"], row["against"]) == group_key
            }
            table_rows.append([*group_key, *(_of_preset(row_by_preset.get(preset)) for preset in PRESET_NAMES)])
        if table_rows:
            markdown_tables.append(markdown_table(["subject", "quantity", "against", *PRESET_NAMES], table_rows))
    return markdown_tables or ["No preset was studied."]


def _of_preset(preset_row: Mapping[str, Any] | None) -> str:
    if preset_row is None:
        return "–"
    law_text = f" (by law {_percent(preset_row['error_by_law'])})" if preset_row["error_by_law"] is not None else ""
    error_text = f"**{_percent(preset_row['error'])}**" if preset_row["front"] else _percent(preset_row["error"])
    return f"{error_text}{law_text} in {_seconds(preset_row['seconds'])}"


def _budget(tables: Mapping[str, list[Row]], _: Any) -> list[str]:
    rows = [row for row in tables["budget"] if row["against"] not in (FINEST_MESH, OWN_LIMIT)]
    quantities = list(dict.fromkeys(row["quantity"] for row in rows))
    axis_keys = list(dict.fromkeys((row["axis"], row["against"]) for row in rows if row["against"] != "theory"))
    table_rows = []
    for quantity in quantities:
        error_by_axis = {(row["axis"], row["against"]): row["error"] for row in rows if row["quantity"] == quantity}
        if any(axis_key in error_by_axis for axis_key in axis_keys):
            table_rows.append([quantity, *(_percent(error_by_axis.get(axis_key)) for axis_key in axis_keys)])
    return (
        [markdown_table(["quantity", *(reference for _, reference in axis_keys)], table_rows)]
        if table_rows
        else ["No solver was studied."]
    )


def _peers(tables: Mapping[str, list[Row]], summary: Any) -> list[str]:
    """Peers on the largest mesh that each of them and we measured; :func:`_all_peers` has the other meshes, too."""
    if not tables["peers"]:
        return [f"{summary['left_out'].get('peers', 'No peer was measured')}."]
    cells_by_peer: dict[tuple[str, ...], list[str]] = {}
    for row in _peer_cells(tables):  # meshes come from coarse to fine
        cells_by_peer[row[0], row[1], row[3]] = row
    return [markdown_table(PEER_COLUMNS, list(cells_by_peer.values()))]


def _all_peers(tables: Mapping[str, list[Row]]) -> str:
    """All meshes as a table of tabs."""
    return "".join("\t".join(peer_cells) + "\n" for peer_cells in (PEER_COLUMNS.split(" | "), *_peer_cells(tables)))


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


def _dominated(tables: Mapping[str, list[Row]], _: Any) -> list[str]:
    """How often each of our settings is on a front."""
    setting_flags: dict[tuple[str, str, str], list[int]] = {}
    for row in tables["points"]:
        if row["method"] == OUR_CODE and row["half"] == "solver" and row["against"] != OTHER_PEER:
            setting_flags.setdefault((row["axis"], row["setting"], row["preset"] or ""), []).append(int(row["front"]))
    rows = [
        [axis, setting + (f" ({preset})" if preset else ""), f"{sum(front_flags)} of {len(front_flags)}"]
        for (axis, setting, preset), front_flags in setting_flags.items()
    ]
    return (
        [markdown_table(["axis", "setting", "quantities in which no setting dominates it"], rows)]
        if rows
        else ["Nothing."]
    )


def _made(_: Any, summary: Mapping[str, Any]) -> list[str]:
    env = summary["made"]
    packages = [name for name in ("morphofold", "numpy", "scipy", "numba", "scikit-fem", *PEER_NAMES) if env.get(name)]
    versions = ", ".join(f"{name} {env[name]}" for name in packages)
    return [f"{env['processor']}, {env['threads']} threads of {env['cores']}; Python {env['python']}, {versions}."]


PART_MAKERS = {
    "answer": _answer,
    "presets": _presets,
    "budget": _budget,
    "dominated": _dominated,
    "peers": _peers,
    "made": _made,
}


if __name__ == "__main__":
    cyclopts.run(write_page)
