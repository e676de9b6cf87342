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
from morphofold.io.atomic_folders import alone
from morphofold.io.json_files import write_json
from morphofold.studies.index_schemas import keep_figures
from morphofold.studies.paper import REPRODUCTIONS
from morphofold.studies.paper.paper_report import write_paper_report
from morphofold.studies.runs import Runs

GROWN_FIGURE = "fig8-grown"


def run(args: Reproduce) -> Answer:
    """The command."""
    all_figures = [figure for figure in FIGURES if figure not in NOT_IN_ALL] if "all" in args.figures else []
    figures = list(dict.fromkeys([*all_figures, *(figure for figure in args.figures if figure != "all")]))
    for figure in figures:
        if figure not in FIGURES:
            raise UnknownName(f"{figure!r} is not a figure that can be reproduced; there are {', '.join(FIGURES)}.")
    if args.subject and GROWN_FIGURE not in figures:
        raise OptionsClash(f"--subject is for {GROWN_FIGURE}, which is not drawn. Name it, or leave --subject out.")
    runs = Runs(args.out, draft=args.draft, threads=args.threads, quiet=args.quiet)
    entry_by_figure, kept_entries = reproduce(figures, args.out, runs, args.subject)
    return Answer(args.out / "summary.json", _lines(entry_by_figure, kept_entries, args.out))


def _lines(entry_by_figure: Mapping[str, Any], kept_figures: Iterable[str], out: Path) -> Iterator[str]:
    for figure_name, entry in entry_by_figure.items():
        yield f"{figure_name}: {FIGURES[figure_name]}"
        for run_entry in entry.get("simulations", ()):
            yield from (f"{figure_name}: warning: {run_entry['scene']}: {warning}" for warning in run_entry["warnings"])
    yield from (f"{figure_name}: kept from an earlier run" for figure_name in kept_figures)
    yield f"-> {out / 'report.html'}"


def reproduce(
    figures: Sequence[str], out: Path, runs: Runs, subjects: Sequence[Path] = ()
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Draw ``figures``, keys of ``REPRODUCTIONS``, into the folder ``out``; others of an earlier run there are kept.

    ``subjects`` are FreeSurfer subjects for fig8-grown. Returns the entries of the index of the figures that were
    drawn, and of those kept.
    """
    real_path = Path(os.path.realpath(out))
    refuse_foreign(out)
    # the lock is beside the folder, which is replaced: figures that another run drew meanwhile would be lost
    with alone(real_path.parent, f".{real_path.name}.lock"), atomic_folder(out) as folder:
        kept_entries = keep_figures(out, folder, REPRODUCTIONS, figures)
        entry_by_figure = {figure_name: _draw(figure_name, folder, runs, subjects) for figure_name in figures}
        figure_index = {
            "morphofold": __version__,
            "paper": "Razavi et al. 2015, Phys. Rev. E 92, 032701",
            "lengths": "mm; the paper gives none, and only ratios matter",
            "figures": {**kept_entries, **entry_by_figure},
        }
        write_json(folder / "summary.json", figure_index)
        write_paper_report(folder, figure_index)
    return entry_by_figure, kept_entries


def _draw(figure: str, folder: Path, runs: Runs, subjects: Sequence[Path]) -> dict[str, Any]:
    """Draw a figure; return its entry of the index, with the seconds without growing."""
    start_time, grown_before = time.perf_counter(), runs.seconds_growing
    subject_options = {"subjects": [str(path) for path in subjects]} if figure == GROWN_FIGURE and subjects else {}
    entry = REPRODUCTIONS[figure](folder, runs, **subject_options)
    seconds = time.perf_counter() - start_time - (runs.seconds_growing - grown_before)
    digest_by_file = {file: sha256_of(folder / file) for file in entry["files"]}
    return {"morphofold": __version__, "seconds": round(seconds, 2), **entry, "sha256": digest_by_file}
