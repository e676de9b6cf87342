"""Draw figures of the paper anew (Razavi et al. 2015), each with the table of its points, and an index of them all."""

from __future__ import annotations

import argparse
import json
import os
import shutil
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from morphofold.cli.progress import Tell
    from morphofold.sim.run import Simulation

#: figure -> what it shows; report/paper.py draws them
FIGURES = {
    "fig3": "outer radius against growth, tangential stress through the cortex (theory and finite elements)",
    "fig4": "growth at which creases can form (theory)",
    "fig5": "a sphere folding, six stages (simulation)",
    "fig6": "thin, normal and thick cortex, three stages (simulations)",
    "fig7": "shear moduli 1, 2 and 4 to 1, three stages (simulations)",
}
SIMULATIONS = "simulations"


def add_args(parser: argparse.ArgumentParser) -> None:
    shown = "; ".join(f"{name}: {words}" for name, words in FIGURES.items())
    parser.add_argument("figures", metavar="FIGURE", nargs="+", help=shown)
    parser.add_argument(
        "-o", "--out", metavar="DIR", default="reproduce",
        help="folder to write; what an earlier run drew or grew there stays (default: reproduce)",
    )  # fmt: skip
    parser.add_argument("--draft", action="store_true", help="simulate coarsely, about four times faster")
    parser.add_argument("--threads", type=int, metavar="N", help="threads (default: all cores)")
    parser.add_argument("--json", action="store_true", help="print summary.json")


def run(args: argparse.Namespace) -> int:
    figures = list(dict.fromkeys(args.figures))
    for name in figures:
        if name not in FIGURES:
            raise ValueError(f"{name!r} is no figure that can be drawn anew; there are {', '.join(FIGURES)}.")
    if not args.out:
        raise ValueError("-o: no folder is named; give one to write, such as -o reproduce.")
    from morphofold import __version__
    from morphofold.io import atomic_folder
    from morphofold.report.paper import REPRODUCTIONS
    from morphofold.results import strict_json

    out = Path(args.out)
    runs = _Runs(out, draft=args.draft, threads=args.threads, quiet=args.quiet)
    args.on_interrupt = " Run it again to go on from the checkpoint."
    with atomic_folder(out) as folder:
        kept = _keep(out, folder, figures)
        drawn = {name: {"morphofold": __version__, **REPRODUCTIONS[name](folder, runs)} for name in figures}
        index = {
            "morphofold": __version__,
            "paper": "Razavi et al. 2015, Phys. Rev. E 92, 032701",
            "lengths": "mm; the paper gives none, and only ratios matter",
            "figures": {**kept, **drawn},
        }
        (folder / "summary.json").write_text(strict_json(index), encoding="utf-8")
        if (out / SIMULATIONS).is_dir():
            shutil.copytree(out / SIMULATIONS, folder / SIMULATIONS, copy_function=_link)
    if args.json:
        print((out / "summary.json").read_text(encoding="utf-8"), end="")
        return 0
    for name in figures:
        print(f"{name}: {FIGURES[name]}")
        for entry in drawn[name].get("simulations", ()):
            for warning in entry["warnings"]:
                print(f"{name}: warning: {entry['scene']}: {warning}")
    for name in kept:
        print(f"{name}: kept from an earlier run")
    print(f"-> {out / 'summary.json'}")
    return 0


class _Runs:
    """Grows the scenes that figures ask for in ``out``/simulations/NAME, each once, going on from checkpoints.

    They lie in ``out`` itself and not in the folder that replaces it, so that an interrupt loses none. Drafts have
    names of their own.
    """

    def __init__(self, out: Path, *, draft: bool, threads: int | None, quiet: bool):
        self._out, self._draft, self._threads, self._quiet = out, draft, threads, quiet

    def grow(self, name: str, scene: str, settings: Sequence[str]) -> Simulation:
        from morphofold.io import atomic_folder
        from morphofold.simulation import simulate

        if not self._out.is_dir() or not any(self._out.iterdir()):
            with atomic_folder(self._out):                              # marks it as ours
                pass
        if self._draft:
            name, settings = f"{name}-draft", [*settings, "accuracy.level=draft"]
        with self.telling(name) as tell:
            return simulate(
                scene, self._out / SIMULATIONS / name, settings=settings, resume=True, threads=self._threads,
                progress=tell,
            )  # fmt: skip

    def telling(self, words: str) -> AbstractContextManager[Tell]:
        from morphofold.cli.progress import progress

        return progress(words, self._quiet)


def _keep(out: Path, folder: Path, figures: list[str]) -> dict[str, Any]:
    """Copy what an earlier run wrote into ``out`` and isn't drawn again; its entries of the index."""
    try:
        index = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except ValueError as error:
        raise ValueError(f"{out / 'summary.json'}: is no index of figures ({error}). Delete it.") from None
    kept = {}
    for name, entry in index.get("figures", {}).items():
        if name in FIGURES and name not in figures and all((out / file).is_file() for file in entry["files"]):
            for file in entry["files"]:
                shutil.copy2(out / file, folder / file)
            kept[name] = entry
    return kept


def _link(source: str, target: str) -> None:
    """A second name of a file where the file system has such, else a copy: simulations are large."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
