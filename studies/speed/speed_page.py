"""The generated parts of docs/speed.md: speed of elements and effects on this machine, and times of whole runs.

``python -m morphofold.studies.speed.speed_page PAGE --speed FILE --effects FILE SIMULATION...`` writes them after the
marks ``<!-- elements -->``, ``<!-- effects -->`` and ``<!-- runs -->`` of the Markdown page PAGE, up to the end marks.
The files hold the output of ``python3 run.py bench speed --json`` and of ``bench effects --json``; a SIMULATION is a
folder that ``morphofold simulate`` finished. Long tables have some of their rows on the page, and all in a file beside
it (``speed-elements.tsv``). Text outside of the marks is written by hand.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import cyclopts

from morphofold.errors import DamagedFile, NothingToDo, WrongFile
from morphofold.io.files import decoding, existing_file
from morphofold.sim.output.simulation_folder import Simulation
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.markdown import Row, cells, number, table, table_with_tsv, update_page
from morphofold.studies.speed.solver_speed import PEER_SPEEDS, PEERS_SOURCE

DECODING_TEXTS = "a file that `morphofold simulate` wrote", "Simulate again."
#: phases: contact of the surface with itself, and with its mirror image across symmetry planes
CONTACT_PHASES = ("contact", "symmetry")
LEAST_SHOWN_SHARE = 0.1  # of a step, for an effect to have a row on the page
#: writes a table, whole or as a page has it, from a name, heads, rows, and which rows a page shows
LongTable = Callable[[str, Sequence[str], Sequence[Sequence[str]], Callable[[list[str]], bool]], str]


def whole_table(
    name: str, heads: Sequence[str], rows: Sequence[Sequence[str]], shown: Callable[[list[str]], bool]
) -> str:
    """The table with all its rows, as bench prints it."""
    return table(heads, rows)


def write_page(page: Path, *simulations: Path, speed: Path, effects: Path) -> None:
    """Update the marked parts of ``page``, and the tables beside it.

    Parameters
    ----------
    page : Path
    simulations : Path
        Folders of finished simulations, in the order of their rows.
    speed, effects : Path
        Output of ``bench speed --json`` and ``bench effects --json``.

    Raises
    ------
    FileNotFoundError
        If a file or folder is missing, or a simulation is not finished.
    ValueError
        If a file has other content, no simulation is named, or the page lacks one pair of marks for a part. The page
        is then unchanged.
    """
    if not simulations:
        raise NothingToDo("no simulation is named; name folders that `morphofold simulate` wrote.")
    run_rows = [whole_run(folder) for folder in simulations]
    speed_rows = read_rows(speed, "speed", "elements", "threads", "median", "best", "steps")
    effect_rows = read_rows(effects, "effects", "ms", "share")
    long_table = partial(table_with_tsv, page)
    part_texts = {
        "elements": elements_part(speed_rows, long_table),
        "effects": effects_part(effect_rows, long_table),
        "runs": _runs(run_rows, long_table),
    }
    update_page(page, part_texts)


def whole_run(run_folder: Path) -> Row:
    """Time and size of a finished simulation, from its ``health.json`` and ``log.jsonl``.

    Returns
    -------
    dict
        ``scene``, ``level`` (or the edge instead), ``portion``; ``kind`` and number of ``elements``, ``steps``,
        wall ``seconds``, ``threads``; ``millions`` of element-steps per wall second, including set-up and writing;
        ``shares`` of the wall seconds by phase, with ``rest`` for time outside of phases; ``last_contact``, the share
        of contact in the time of all phases from the last stage but one to the last; ``memory`` [GiB]; ``healthy``.
        Values that a run does not have or did not record are None: for example, a radial run has no elements.

    Raises
    ------
    FileNotFoundError
        If it is not the folder of a finished simulation.
    ValueError
        If the content of a file in it is wrong.
    """
    health_file = existing_file(run_folder / "health.json", "health")
    with decoding(health_file, *DECODING_TEXTS):
        scene = load_scene(existing_file(run_folder / "scene.toml", "scene"))
        health = Simulation(run_folder, scene).health
        seconds, n_elements, phases = float(health["seconds"]), health.get("elements"), dict(health["seconds_by_phase"])
        if not 0 < seconds < math.inf:
            raise DamagedFile(f"a run of {seconds:g} s has no speed")
        phase_shares = {phase: phase_seconds / seconds for phase, phase_seconds in phases.items()}
        phase_shares["other"] = 1 - sum(phase_shares.values())
        row = {
            "scene": scene.name,
            "level": scene.accuracy.level if scene.accuracy.edge is None else f"edge {scene.accuracy.edge:g} mm",
            "portion": getattr(scene.geometry, "portion", None),
            "kind": None if n_elements is None else "tets" if scene.geometry.shape == "mesh" else "bricks",
            "elements": n_elements,
            "steps": health["steps"] if n_elements else None,
            "seconds": seconds,
            "threads": health.get("threads"),
            "millions": n_elements * health["steps"] / seconds / 1e6 if n_elements else None,
            "shares": phase_shares,
            "memory": health.get("peak_memory_GiB"),
            "healthy": health["healthy"],
        }
        stage_steps = [stage["step"] for stage in health["stages"]]
        has_contact = "contact" in health["effects"]
    log_file = existing_file(run_folder / "log.jsonl", "log")
    with decoding(log_file, *DECODING_TEXTS):
        log_rows = [json.loads(log_line) for log_line in log_file.read_text("utf-8").splitlines()]
        row["last_contact"] = _last_contact(log_rows, stage_steps) if has_contact else None
    return row


def _last_contact(log_rows: Sequence[Row], stage_steps: Sequence[int]) -> float | None:
    """Share of contact in the seconds of all phases since the last stage but one (since the start if there is one)."""
    start_seconds: Mapping[str, float] = {}
    if len(stage_steps) > 1:
        start_seconds = next(
            (row["seconds"] for row in log_rows if row["step"] >= stage_steps[-2]), log_rows[-1]["seconds"]
        )
    phase_seconds = {phase: secs - start_seconds.get(phase, 0.0) for phase, secs in log_rows[-1]["seconds"].items()}
    total_seconds = sum(phase_seconds.values())
    return sum(phase_seconds.get(phase, 0.0) for phase in CONTACT_PHASES) / total_seconds if total_seconds > 0 else None


def read_rows(path: Path, command: str, *number_columns: str) -> list[Row]:
    """Rows that ``bench`` printed as JSON, each with these numbers."""
    advice = f"Write it again: python3 run.py bench {command} --json > {path.name}"
    try:
        rows: list[Row] = json.loads(existing_file(path).read_text("utf-8"))
        is_valid = len(rows) > 0 and all(math.isfinite(row[column]) for row in rows for column in number_columns)
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise WrongFile(f"{path}: {type(error).__name__}: {error}. {advice}") from None
    if not is_valid:
        raise WrongFile(f"{path}: holds no rows, or a number that is not finite. {advice}")
    return rows


# parts ------------------------------------------------------------------------------------------------------


def elements_part(rows: Sequence[Row], long_table: LongTable = whole_table) -> list[str]:
    """Measured speeds, then quoted speeds in a separate table; a page shows the largest bodies, bench prints all."""
    heads = ["element", "elements", "threads", "kernel, median", "kernel, best", "whole steps", "per thread"]
    formats = {
        "element": "",
        "elements": "{:,}",
        "threads": "{}",
        **dict.fromkeys(("median", "best", "steps", "each"), "{:.1f}"),
    }
    largest = {row["element"]: f"{row['elements']:,}" for row in sorted(rows, key=lambda row: row["elements"])}
    speed_cells = cells(({**row, "each": row["steps"] / row["threads"]} for row in rows), formats)
    peer_heads = ["design", "threads", "ms per step", "million tet-steps per second", "how it was timed"]
    return [
        "Million element-steps per second, measured here. A tet is part of a patch of six:",
        long_table("elements", heads, speed_cells, lambda row_cells: largest[row_cells[0]] == row_cells[1]),
        f"The designs of two peers, quoted and not measured here: {PEERS_SOURCE}.",
        long_table("quoted", peer_heads, PEER_SPEEDS, lambda peer: peer[1] == "1" and peer[-1].startswith("wall")),
    ]


def effects_part(rows: Sequence[Row], long_table: LongTable = whole_table) -> list[str]:
    """What each effect adds to a step; a page shows what adds most, bench prints all."""
    table_rows = [[row["effect"], number(row["ms"], "{:.3f}"), _percent(row["share"])] for row in rows]
    shown = {row["effect"] for row in rows if row["share"] >= LEAST_SHOWN_SHARE}
    heads = ["effect", "ms per step", "of a step without effects"]
    return [long_table("effects", heads, table_rows, lambda row_cells: row_cells[0] in shown)]


def _runs(run_rows: Sequence[Row], long_table: LongTable) -> list[str]:
    heads = (
        "scene | level | portion | elements | steps | threads | wall time, s | million element-steps per second | "
        "peak memory, GiB"
    )
    table_rows = []
    for row in run_rows:
        size_text = f"{row['elements']:,} {row['kind']}" if row["elements"] else "–"
        formats = {"steps": "{:,}", "threads": "{}", "seconds": "{:.1f}", "millions": "{:.2f}", "memory": "{:.2f}"}
        (number_cells,) = cells([row], formats)
        table_rows.append([row["scene"], row["level"], row["portion"] or "–", size_text, *number_cells])
    phases = list(dict.fromkeys(phase for row in run_rows for phase in row["shares"] if phase != "other"))
    share_rows = [
        [
            row["scene"],
            row["level"],
            *(_percent(row["shares"].get(phase)) for phase in (*phases, "other")),
            _percent(row["last_contact"]),
        ]
        for row in run_rows
    ]
    largest = {row["kind"]: row for row in sorted(run_rows, key=lambda row: row["elements"] or 0)}
    shown = [[row["scene"], row["level"]] for row in largest.values()]
    share_heads = ["scene", "level", *phases, "other", "contact at the end"]
    return [
        table(heads, table_rows),
        "Shares of the wall time; other is set-up, and checking and writing of stages. Contact at the end is its "
        "share, with mirror images, of the steps after the last stage but one:",
        long_table("shares", share_heads, share_rows, lambda row_cells: row_cells[:2] in shown),
        _say_health(run_rows),
    ]


def _percent(fraction: float | None) -> str:
    return number(None if fraction is None else 100 * fraction, "{:.1f} %")


def _say_health(rows: Sequence[Row]) -> str:
    sick = [f"{row['scene']} ({row['level']})" for row in rows if not row["healthy"]]
    return f"{len(rows) - len(sick)} of {len(rows)} runs are healthy" + (f"; not: {', '.join(sick)}." if sick else ".")


if __name__ == "__main__":
    cyclopts.run(write_page)
