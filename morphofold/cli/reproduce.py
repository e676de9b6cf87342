"""``morphofold reproduce``: figures of the paper, and their index."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from morphofold import __version__
from morphofold.cli.options import FIGURES, NOT_IN_ALL, Answer, Reproduce
from morphofold.cli.runs import Runs
from morphofold.errors import OptionsClash
from morphofold.io import atomic_folder, refuse_foreign
from morphofold.io.folders import alone
from morphofold.provenance import sha256_of, strict_json
from morphofold.studies.indexes import keep_figures
from morphofold.studies.paper import REPRODUCTIONS
from morphofold.studies.paper.report import write_paper_report

GROWN = "fig8-grown"


def run(args: Reproduce) -> Answer:
    figures = _figure_names(args)
    out, place = args.out, Path(os.path.realpath(args.out))
    runs = Runs(out, draft=args.draft, threads=args.threads, quiet=args.quiet)
    args.on_interrupt = " Run it again to go on."
    refuse_foreign(out)
    # the lock is beside the folder, which is replaced: figures that another run drew meanwhile would be lost
    with alone(place.parent, f".{place.name}.lock"), atomic_folder(out) as folder:
        cached = keep_figures(out, folder, FIGURES, figures)
        drawn = {name: _draw(name, folder, runs, args.subject) for name in figures}
        index = {
            "morphofold": __version__,
            "paper": "Razavi et al. 2015, Phys. Rev. E 92, 032701",
            "lengths": "mm; the paper gives none, and only ratios matter",
            "figures": {**cached, **drawn},
        }
        (folder / "summary.json").write_text(strict_json(index), encoding="utf-8")
        write_paper_report(folder, index)
    return Answer(out / "summary.json", list(_lines(drawn, list(cached), out)))


def _figure_names(args: Reproduce) -> list[str]:
    every = [name for name in FIGURES if name not in NOT_IN_ALL] if "all" in args.figures else []
    figures = list(dict.fromkeys([*every, *(name for name in args.figures if name != "all")]))
    if args.subject and GROWN not in figures:
        raise OptionsClash(f"--subject is for {GROWN}, which is not drawn. Name it, or leave --subject out.")
    return figures


def _draw(name: str, folder: Path, runs: Runs, subjects: Sequence[Path]) -> dict[str, Any]:
    """Draw a figure; return its entry of the index, with the seconds without growing."""
    begun, growing = time.perf_counter(), runs.seconds_growing
    own = {"subjects": [str(path) for path in subjects]} if name == GROWN and subjects else {}
    entry = REPRODUCTIONS[name](folder, runs, **own)
    seconds = time.perf_counter() - begun - (runs.seconds_growing - growing)
    digests = {file: sha256_of(folder / file) for file in entry["files"]}
    return {"morphofold": __version__, "seconds": round(seconds, 2), **entry, "sha256": digests}


def _lines(drawn: Mapping[str, Any], cached: Sequence[str], out: Path) -> Iterator[str]:
    for name, figure in drawn.items():
        yield f"{name}: {FIGURES[name]}"
        for entry in figure.get("simulations", ()):
            yield from (f"{name}: warning: {entry['scene']}: {warning}" for warning in entry["warnings"])
    yield from (f"{name}: kept from an earlier run" for name in cached)
    yield f"-> {out / 'report.html'}"
