"""``morphofold reproduce``: draw figures of the paper into a folder, with their index and their page."""

import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from morphofold import __version__
from morphofold.cli.command_options import FIGURES, NOT_IN_ALL, Answer, Reproduce
from morphofold.digests_and_json import sha256_of
from morphofold.errors import OptionsClash, UnknownName
from morphofold.io import atomic_folder, refuse_foreign
from morphofold.io.json_files import write_json
from morphofold.io.result_folders import alone
from morphofold.studies.index_schemas import keep_figures
from morphofold.studies.paper import REPRODUCTIONS
from morphofold.studies.paper.paper_report import write_paper_report
from morphofold.studies.runs import Runs

GROWN = "fig8-grown"


def run(args: Reproduce) -> Answer:
    """The command."""
    all_figures = [name for name in FIGURES if name not in NOT_IN_ALL] if "all" in args.figures else []
    figures = list(dict.fromkeys([*all_figures, *(name for name in args.figures if name != "all")]))
    for name in figures:
        if name not in FIGURES:
            raise UnknownName(f"{name!r} is not a figure that can be reproduced; there are {', '.join(FIGURES)}.")
    if args.subject and GROWN not in figures:
        raise OptionsClash(f"--subject is for {GROWN}, which is not drawn. Name it, or leave --subject out.")
    runs = Runs(args.out, draft=args.draft, threads=args.threads, quiet=args.quiet)
    entries, cached = reproduce(figures, args.out, runs, args.subject)
    return Answer(args.out / "summary.json", _lines(entries, cached, args.out))


def _lines(entries: Mapping[str, Any], cached: Iterable[str], out: Path) -> Iterator[str]:
    for name, figure in entries.items():
        yield f"{name}: {FIGURES[name]}"
        for entry in figure.get("simulations", ()):
            yield from (f"{name}: warning: {entry['scene']}: {warning}" for warning in entry["warnings"])
    yield from (f"{name}: kept from an earlier run" for name in cached)
    yield f"-> {out / 'report.html'}"


def reproduce(
    figures: Sequence[str], out: Path, runs: Runs, subjects: Sequence[Path] = ()
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Draw ``figures``, keys of ``REPRODUCTIONS``, into the folder ``out``; others of an earlier run there are kept.

    ``subjects`` are FreeSurfer subjects for fig8-grown. Returns the entries of the index of the figures that were
    drawn, and of those kept.
    """
    path = Path(os.path.realpath(out))
    refuse_foreign(out)
    # the lock is beside the folder, which is replaced: figures that another run drew meanwhile would be lost
    with alone(path.parent, f".{path.name}.lock"), atomic_folder(out) as folder:
        cached = keep_figures(out, folder, REPRODUCTIONS, figures)
        entries = {name: _draw(name, folder, runs, subjects) for name in figures}
        index = {
            "morphofold": __version__,
            "paper": "Razavi et al. 2015, Phys. Rev. E 92, 032701",
            "lengths": "mm; the paper gives none, and only ratios matter",
            "figures": {**cached, **entries},
        }
        write_json(folder / "summary.json", index)
        write_paper_report(folder, index)
    return entries, cached


def _draw(name: str, folder: Path, runs: Runs, subjects: Sequence[Path]) -> dict[str, Any]:
    """Draw a figure; return its entry of the index, with the seconds without growing."""
    start_time, growing_before = time.perf_counter(), runs.seconds_growing
    subject_options = {"subjects": [str(path) for path in subjects]} if name == GROWN and subjects else {}
    entry = REPRODUCTIONS[name](folder, runs, **subject_options)
    seconds = time.perf_counter() - start_time - (runs.seconds_growing - growing_before)
    digests = {file: sha256_of(folder / file) for file in entry["files"]}
    return {"morphofold": __version__, "seconds": round(seconds, 2), **entry, "sha256": digests}
