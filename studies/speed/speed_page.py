"""The generated parts of docs/speed.md: speed of elements and effects on this machine, and times of whole runs.

``python -m morphofold.studies.speed.speed_page PAGE --speed FILE --effects FILE SIMULATION...`` writes them after the
marks ``<!-- elements -->``, ``<!-- effects -->`` and ``<!-- runs -->`` of the Markdown page PAGE, up to the end marks.
The files hold the output of ``python3 run.py bench speed --json`` and of ``bench effects --json``; a SIMULATION is a
folder that ``morphofold simulate`` finished. Text outside of the marks is written by hand.
"""

import argparse
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from morphofold.errors import DamagedFile, NothingToDo, WrongFile
from morphofold.sim.output.folder import Simulation
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.markdown import Row, cells, number, renewed, table, write_texts
from morphofold.studies.speed.solver_speed import PEERS, PEERS_SOURCE

#: columns of text and of positive numbers that a row must have, as the command writes them
SPEED = ("element",), ("elements", "threads", "median", "best", "steps")
EFFECTS = ("effect",), ()
CONTACT = (
    "contact",
    "symmetry",
)  # phases: contact of the surface with itself, and with its mirror image across symmetry planes


def write_page(page: Path, speed: Path, effects: Path, simulations: Sequence[Path]) -> None:
    """Update the marked parts of ``page``.

    Parameters
    ----------
    page : Path
    speed, effects : Path
        Output of ``bench speed --json`` and ``bench effects --json``.
    simulations : sequence of Path
        Folders of finished simulations, in the order of their rows.

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
    text = _text(page, "Create the page with its marks.")
    rows = [whole_run(folder) for folder in simulations]
    parts = {
        "elements": _elements(read_rows(speed, "speed", *SPEED)),
        "effects": _effects(read_rows(effects, "effects", *EFFECTS), effects),
        "runs": _runs(rows),
    }
    write_texts({page: renewed(page, text, parts)})


def whole_run(folder: Path) -> Row:
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
    cure = "Name the folder of a finished simulation."
    file = folder / "health.json"
    _text(folder / "scene.toml", cure)  # raises the right error if the file is missing
    with _understood(file):
        _text(file, cure)
        scene = load_scene(folder / "scene.toml")
        record = Simulation(folder, scene).health
        seconds, elements, phases = float(record["seconds"]), record.get("elements"), dict(record["seconds_by_phase"])
        if not 0 < seconds < math.inf:
            raise DamagedFile(f"{file}: a run of {seconds:g} s has no speed. {cure}")
        shares = {phase: spent / seconds for phase, spent in phases.items()}
        shares["other"] = 1 - sum(shares.values())
        row = {
            "scene": scene.name,
            "level": scene.accuracy.level if scene.accuracy.edge is None else f"edge {scene.accuracy.edge:g} mm",
            "portion": getattr(scene.geometry, "portion", None),
            "kind": None if elements is None else "tets" if scene.geometry.shape == "mesh" else "bricks",
            "elements": elements,
            "steps": record["steps"] if elements else None,
            "seconds": seconds,
            "threads": record.get("threads"),
            "millions": elements * record["steps"] / seconds / 1e6 if elements else None,
            "shares": shares,
            "memory": record.get("peak_memory_GiB"),
            "healthy": record["healthy"],
        }
        steps = [stage["step"] for stage in record["stages"]]
        called = "contact" in record["effects"]
    log = folder / "log.jsonl"
    with _understood(log):
        lines = [json.loads(line) for line in _text(log, cure).splitlines()]
        row["last_contact"] = _last_contact(lines, steps) if called else None
    return row


def _last_contact(lines: Sequence[Row], steps: Sequence[int]) -> float | None:
    """Share of contact in the seconds of all phases since the last stage but one (since the start if there is one)."""
    begin: Mapping[str, float] = {}
    if len(steps) > 1:
        begin = next((line["seconds"] for line in lines if line["step"] >= steps[-2]), lines[-1]["seconds"])
    spent = {phase: s - begin.get(phase, 0.0) for phase, s in lines[-1]["seconds"].items()}
    total = sum(spent.values())
    return sum(spent.get(phase, 0.0) for phase in CONTACT) / total if total > 0 else None


@contextmanager
def _understood(path: Path) -> Iterator[None]:
    """Context in which errors in the content of a file name this file."""
    try:
        yield
    except (KeyError, TypeError, AttributeError, IndexError, json.JSONDecodeError) as error:
        raise DamagedFile(
            f"{path}: is not as `morphofold simulate` writes it ({type(error).__name__}: {error}). Simulate again."
        ) from error


def _text(path: Path, cure: str) -> str:
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file. {cure}")
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise DamagedFile(f"{path}: is not text ({error}). {cure}") from None


def read_rows(path: Path, command: str, words: Sequence[str], positive: Sequence[str]) -> list[Row]:
    """Rows that ``bench`` printed as JSON, checked against the command."""
    cure = f"Write it again: python3 run.py bench {command} --json > {path.name}"
    try:
        rows = json.loads(_text(path, cure))
    except json.JSONDecodeError as error:
        raise DamagedFile(f"{path}: is not JSON ({error}). {cure}") from None
    if not isinstance(rows, list) or not rows:
        raise WrongFile(f"{path}: holds no rows. {cure}")
    for k, row in enumerate(rows):
        for name, good in (*((w, _is_word) for w in words), *((p, _is_positive) for p in positive)):
            if not isinstance(row, dict) or not good(row.get(name)):
                got = row.get(name) if isinstance(row, dict) else row
                raise WrongFile(f"{path}: row {k} of {len(rows)} has no valid {name!r}, but {got!r}. {cure}")
    return rows


def _is_word(value: object) -> bool:
    return isinstance(value, str) and value != ""


def _is_positive(value: object) -> bool:
    return _is_number(value) and value > 0  # type: ignore[operator]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


# parts ------------------------------------------------------------------------------------------------------


def _elements(rows: Sequence[Row]) -> list[str]:
    """Measured speeds, then quoted speeds in a separate table."""
    heads = ["element", "elements", "threads", "kernel, median", "kernel, best", "whole steps", "per thread"]
    columns = {
        "element": "",
        "elements": "{:,}",
        "threads": "{}",
        **dict.fromkeys(("median", "best", "steps", "each"), "{:.1f}"),
    }
    quoted = ["design", "threads", "ms per step", "million tet-steps per second", "how it was timed"]
    peers = [[p.design, p.threads, p.ms, p.millions, p.timed] for p in PEERS]
    return [
        "Million element-steps per second, measured here. A brick has 8 Gauss points, a tet is part of a patch of six:",
        table(heads, cells(({**row, "each": row["steps"] / row["threads"]} for row in rows), columns)),
        f"The designs of two peers, quoted and not measured here: {PEERS_SOURCE}.",
        table(quoted, peers),
    ]


def _effects(rows: Sequence[Row], path: Path) -> list[str]:
    for k, row in enumerate(rows):
        if not (_is_number(row.get("ms")) and _is_number(row.get("share"))):
            raise WrongFile(
                f"{path}: row {k} of {len(rows)} has no numbers 'ms' and 'share'. Write it again: python3 run.py bench "
                f"effects --json > {path.name}"
            )
    lines = [[row["effect"], number(row["ms"], "{:.3f}"), _percent(row["share"])] for row in rows]
    return [table(["effect", "ms per step", "of a step without effects"], lines)]


def _runs(rows: Sequence[Row]) -> list[str]:
    heads = [
        "scene",
        "level",
        "portion",
        "elements",
        "steps",
        "threads",
        "wall time, s",
        "million element-steps per second",
        "per thread",
        "contact in the last stage",
        "peak memory, GiB",
    ]
    lines = []
    for row in rows:
        per_thread = row["millions"] / row["threads"] if row["millions"] and row["threads"] else None
        lines.append(
            [
                row["scene"],
                row["level"],
                row["portion"] or "–",
                f"{row['elements']:,} {row['kind']}" if row["elements"] else "–",
                number(row["steps"], "{:,}"),
                number(row["threads"], "{}"),
                number(row["seconds"], "{:.1f}"),
                number(row["millions"], "{:.2f}"),
                number(per_thread, "{:.2f}"),
                _percent(row["last_contact"]),
                number(row["memory"], "{:.2f}"),
            ]
        )
    phases = list(dict.fromkeys(phase for row in rows for phase in row["shares"] if phase != "other"))
    shares = [
        [row["scene"], row["level"], *(_percent(row["shares"].get(phase)) for phase in (*phases, "other"))]
        for row in rows
    ]
    return [
        table(heads, lines),
        "The share of contact is that of the time of all steps after the last stage but one, including mirror images.",
        "Shares of the wall time; the rest is set-up, and checking and writing of stages:",
        table(["scene", "level", *phases, "other"], shares),
        _say_health(rows),
    ]


def _percent(share: float | None) -> str:
    return number(None if share is None else 100 * share, "{:.1f} %")


def _say_health(rows: Sequence[Row]) -> str:
    ill = [f"{row['scene']} ({row['level']})" for row in rows if not row["healthy"]]
    return f"{len(rows) - len(ill)} of {len(rows)} runs are healthy" + (f"; not: {', '.join(ill)}." if ill else ".")


def main(argv: Sequence[str] | None = None) -> int:
    """Write the page; 0 done, 2 bad input."""
    parser = argparse.ArgumentParser(prog="python -m morphofold.studies.speed.speed_page", description=__doc__)
    parser.add_argument("page", type=Path, metavar="PAGE")
    parser.add_argument("--speed", type=Path, metavar="FILE", required=True)
    parser.add_argument("--effects", type=Path, metavar="FILE", required=True)
    parser.add_argument("simulations", type=Path, metavar="SIMULATION", nargs="+")
    args = parser.parse_args(argv)
    try:
        write_page(args.page, args.speed, args.effects, args.simulations)
    except (ValueError, OSError) as error:
        print(f"speed_page: {error}", file=sys.stderr)
        return 2
    print(f"{args.page}: {len(args.simulations)} runs")
    return 0


if __name__ == "__main__":
    sys.exit(main())
