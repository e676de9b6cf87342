"""``morphofold reproduce``: figures of the paper, and their index."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from morphofold.cli.options import FIGURES, NOT_IN_ALL, Answer, Reproduce
from morphofold.errors import OptionsClash, UnknownName
from morphofold.studies.paper.reproduction import GROWN, reproduce
from morphofold.studies.runs import Runs


def run(args: Reproduce) -> Answer:
    every = [name for name in FIGURES if name not in NOT_IN_ALL] if "all" in args.figures else []
    figures = list(dict.fromkeys([*every, *(name for name in args.figures if name != "all")]))
    for name in figures:
        if name not in FIGURES:
            raise UnknownName(f"{name!r} is not a figure that can be reproduced; there are {', '.join(FIGURES)}.")
    if args.subject and GROWN not in figures:
        raise OptionsClash(f"--subject is for {GROWN}, which is not drawn. Name it, or leave --subject out.")
    runs = Runs(args.out, draft=args.draft, threads=args.threads, quiet=args.quiet)
    drawn, cached = reproduce(figures, args.out, runs, args.subject)
    return Answer(args.out / "summary.json", _lines(drawn, cached, args.out))


def _lines(drawn: Mapping[str, Any], cached: Iterable[str], out: Path) -> Iterator[str]:
    for name, figure in drawn.items():
        yield f"{name}: {FIGURES[name]}"
        for entry in figure.get("simulations", ()):
            yield from (f"{name}: warning: {entry['scene']}: {warning}" for warning in entry["warnings"])
    yield from (f"{name}: kept from an earlier run" for name in cached)
    yield f"-> {out / 'report.html'}"
