"""What can be known of the growing bilayer sphere without simulating it: radius, stress, creases and wrinkles.

Without options each prints what the paper draws (Razavi et al. 2015, Figs. 3 and 4), and bifurcation what it leaves
out: the exact growth at which the smooth sphere first wrinkles. Numbers may be ranges FROM:TO:COUNT. Lengths are in mm,
but only their ratios matter.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LAWS = ("isotropic", "tangential")
#: values in one FROM:TO:COUNT, and points through a layer
MOST = 10_000
#: above every number that has a meaning here; far larger ones overflow
LARGEST = 1e6

WORDS = {
    "radius": "outer radius of the smooth grown sphere, Eqs. (9) to (11); Fig. 3(a)",
    "stress": "radial and tangential stress through core and cortex; Fig. 3(b)",
    "critical": "growth at which creases can form, Eqs. (12) and (13), and Biot's limit; Fig. 4",
    "bifurcation": "growth at which the smooth sphere first wrinkles, and how; beside the crease criterion",
}


class Column(NamedTuple):
    """A column of a printed table: key of the rows, heading, format of numbers."""

    key: str
    heading: str
    form: str = ""


class Answer(NamedTuple):
    """What a question comes to: words above the table, its columns, all rows, and the figure to draw if asked."""

    title: str
    columns: Sequence[Column]
    rows: list[dict[str, Any]]
    draw: Callable[[], Figure]


LAW, THICKNESS, MU = Column("law", "law"), Column("thickness_mm", "T [mm]", "g"), Column("mu_ratio", "mu ratio", "g")
REASON = Column("reason", "")


def add_args(parser: argparse.ArgumentParser) -> None:
    questions = parser.add_subparsers(dest="what", metavar="WHAT", required=True)

    def question(name: str) -> argparse.ArgumentParser:
        words = f"{WORDS[name][0].upper()}{WORDS[name][1:]}."
        return questions.add_parser(name, help=WORDS[name], description=words, formatter_class=parser.formatter_class)

    radius = question("radius")
    radius.add_argument("--thickness", type=float, default=2.0, metavar="MM", help="cortex, T = C - B (default: 2)")
    _add_sphere(radius)
    radius.add_argument("--growth", nargs="+", default=["1:2:11"], metavar="G", help="of the cortex (default: 1:2:11)")
    _add_core_growth(radius)
    _add_common(radius, "isotropic")

    stress = question("stress")
    _add_thicknesses(stress)
    _add_sphere(stress)
    stress.add_argument("--growth", type=float, default=2.0, metavar="G", help="of the cortex (default: 2)")
    stress.add_argument("--mu-ratio", type=float, default=1.0, metavar="M", help="cortex over core (default: 1)")
    stress.add_argument("--points", type=int, default=11, metavar="N", help="per layer (default: 11)")
    _add_core_growth(stress)
    _add_common(stress, "isotropic")

    critical = question("critical")
    size = critical.add_mutually_exclusive_group()
    size.add_argument("--ratio", nargs="+", metavar="C/B", help="outer radius over the interface's (1.02:1.3:15)")
    size.add_argument("--thickness", nargs="+", metavar="MM", help="of the cortex, instead of --ratio")
    _add_sphere(critical)
    _add_core_growth(critical)
    _add_common(critical, "both")

    bifurcation = question("bifurcation")
    _add_thicknesses(bifurcation)
    _add_sphere(bifurcation)
    bifurcation.add_argument("--mu-ratio", nargs="+", default=["1", "2", "4"], metavar="M",
                             help="shear modulus, cortex over core (default: 1 2 4)")  # fmt: skip
    bifurcation.add_argument("--kappa-ratio", type=float, default=float("inf"), metavar="K",
                             help="bulk over shear modulus (default: inf, incompressible)")  # fmt: skip
    bifurcation.add_argument("--check", action="store_true", help="find each g_crit again, by finite elements")
    bifurcation.add_argument("--curve", action="store_true", help="critical growth by degree, not the least alone")
    _add_common(bifurcation, "both")


def _add_thicknesses(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--thickness", nargs="+", default=["1", "2", "3"], metavar="MM",
                        help="of the cortex, T = C - B (default: 1 2 3)")  # fmt: skip


def _add_sphere(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--radius", type=float, default=50.0, metavar="MM", help="outer radius C (default: 50)")
    parser.add_argument("--hole-ratio", type=float, default=0.5, metavar="A/C",
                        help="radius of the fixed hole over C (default: 0.5)")  # fmt: skip


def _add_core_growth(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--core-growth", type=float, default=1.0, metavar="G", help="of the core (default: 1, none)")


def _add_common(parser: argparse.ArgumentParser, law: str) -> None:
    parser.add_argument("--law", choices=[*LAWS, "both"], default=law, help=f"growth of the cortex (default: {law})")
    parser.add_argument("--json", action="store_true", help="print as JSON")
    parser.add_argument("--plot", metavar="FILE", help="draw it too: .png, .svg or .pdf")
    # the command's own; without a default, so that they count on either side of WHAT
    shared: Any = {"action": "store_true", "default": argparse.SUPPRESS}
    parser.add_argument("-q", "--quiet", help="no progress", **shared)
    parser.add_argument("--debug", help="show the traceback of an error", **shared)


def run(args: argparse.Namespace) -> int:
    from morphofold import __version__
    from morphofold.io import atomic_file
    from morphofold.report import paper
    from morphofold.results import strict_json

    plot = None if args.plot is None else _writable(Path(args.plot), paper.check_format)
    for option in ("growth", "mu_ratio", "radius", "core_growth"):
        if isinstance(value := getattr(args, option, None), float):
            _within(value, f"--{option.replace('_', '-')}")
    answer = {"radius": _radius, "stress": _stress, "critical": _critical, "bifurcation": _bifurcation}[args.what](args)
    if plot is not None:
        with atomic_file(plot) as temporary:
            paper.save(answer.draw(), temporary)
    if args.json:
        left_out = ("command", "what", "run", "json", "plot", "quiet", "debug")
        asked = {key: value for key, value in vars(args).items() if key not in left_out}
        if asked.get("kappa_ratio") == float("inf"):
            asked["kappa_ratio"] = "inf"                    # JSON has no infinity
        content = {"morphofold": __version__, "theory": args.what, "parameters": asked, "rows": answer.rows}
        print(strict_json(content), end="")
        return 0
    print(answer.title)
    print(_table(answer.columns, answer.rows))
    if plot is not None:
        print(f"-> {plot}")
    return 0


def _radius(args: argparse.Namespace) -> Answer:
    from morphofold.report import paper, theory_tables

    args.growth = _numbers(args.growth, "--growth")
    sphere = (args.thickness, args.radius, _laws(args.law))
    options = {"g_core": args.core_growth, "A_over_C": args.hole_ratio}
    rows = theory_tables.radius_rows(args.growth, *sphere, **options)
    title = (
        f"Outer radius c of the smooth grown sphere, T = {args.thickness:g} mm, C = {args.radius:g} mm, "
        f"B = {args.radius - args.thickness:g} mm; Eqs. (9) to (11)"
    )
    columns = (LAW, Column("growth", "g", ".4f"), Column("c_over_B", "c/B", ".6f"), Column("c_over_C", "c/C", ".6f"))
    ends = (min(args.growth), max(args.growth))
    return Answer(title, columns, rows, lambda: paper.radius_figure(ends, *sphere, **options))


def _stress(args: argparse.Namespace) -> Answer:
    from morphofold.report import paper, theory_tables

    args.thickness = _numbers(args.thickness, "--thickness")
    if not 2 <= args.points <= MOST:
        raise ValueError(f"--points must be from 2 to {MOST:,}, got {args.points:,}.")
    sphere = (args.growth, args.thickness, args.radius, _laws(args.law))
    options = {"mu_ratio": args.mu_ratio, "g_core": args.core_growth, "A_over_C": args.hole_ratio}
    rows = theory_tables.stress_rows(*sphere, points=args.points, **options)
    title = (
        f"Cauchy stress at growth g = {args.growth:g}, C = {args.radius:g} mm, mu_cortex/mu_core = {args.mu_ratio:g}; "
        "tension is positive.\nUnits: the core's shear modulus mu_core; last column the cortex's own, as in Fig. 3(b). "
        "Position: 0 inside, 1 outside."
    )
    columns = (
        LAW, THICKNESS, Column("layer", "layer"), Column("position", "position", ".3f"),
        Column("R_mm", "R [mm]", ".3f"), Column("r_mm", "r [mm]", ".3f"),
        Column("sigma_r_over_mu_core", "sigma_r/mu_core", ".6g"),
        Column("sigma_theta_over_mu_core", "sigma_theta/mu_core", ".6g"),
        Column("sigma_theta_over_mu_cortex", "sigma_theta/mu_cortex", ".6g"),
    )  # fmt: skip
    return Answer(title, columns, rows, lambda: paper.stress_figure(*sphere, **options))


def _critical(args: argparse.Namespace) -> Answer:
    from morphofold.report import paper, theory_tables

    if args.thickness is not None:
        args.thickness = _numbers(args.thickness, "--thickness")
        args.ratio = [theory_tables.outer_ratio(T, args.radius) for T in args.thickness]
    else:
        args.ratio = _numbers(args.ratio or ["1.02:1.3:15"], "--ratio", above=1.0)
    laws = _laws(args.law)
    options = {"g_core": args.core_growth, "A_over_C": args.hole_ratio}
    rows = theory_tables.critical_rows(args.ratio, laws, **options)
    title = (
        "Growth at which the outer surface can crease, lambda_r/lambda_theta = 2.4 (Eq. 12 isotropic, Eq. 13 "
        "tangential),\nand at which it is unstable to waves of vanishing length (Biot, 3.383)"
    )
    columns = (
        LAW, Column("C_over_B", "C/B", ".4f"), Column("T_over_C", "T/C", ".4f"),
        Column("g_crease", "g crease", ".4f"), Column("g_biot", "g Biot", ".4f"), REASON,
    )  # fmt: skip
    ends = (min(1.0, *args.ratio), max(1.3, *args.ratio))
    return Answer(title, columns, rows, lambda: paper.critical_figure(ends, laws, **options))


def _bifurcation(args: argparse.Namespace) -> Answer:
    from morphofold.cli.progress import progress
    from morphofold.report import paper, theory_tables

    args.thickness = _numbers(args.thickness, "--thickness")
    args.mu_ratio = _numbers(args.mu_ratio, "--mu-ratio")
    laws = _laws(args.law)
    short = len(laws) * len(args.mu_ratio) * len(args.thickness) <= 18 and not args.check
    with progress("bifurcation", args.quiet or short) as tell:
        cases = theory_tables.bifurcation_cases(
            args.thickness, args.radius, args.mu_ratio, laws,
            kappa_ratio=args.kappa_ratio, A_over_C=args.hole_ratio, check=args.check, progress=tell,
        )  # fmt: skip
    named = (LAW, THICKNESS, Column("T_over_C", "T/C", ".4f"), MU)
    if args.curve:
        title = "Growth at which spherical harmonics of degree l first grow on the smooth sphere"
        columns: tuple[Column, ...] = (*named, Column("degree", "l", ".0f"), Column("g_crit", "g_crit", ".5f"), REASON)
        rows = [row for case in cases for row in case.curve_rows()]
        return Answer(title, columns, rows, lambda: paper.bifurcation_curves(cases))
    finite = "" if args.kappa_ratio == float("inf") else ", incompressible"
    title = (
        f"Growth g_crit at which the smooth sphere first wrinkles, C = {args.radius:g} mm, kappa/mu = "
        f"{args.kappa_ratio:g}; g crease: Eqs. (12) and (13){finite}.\n"
        "Over the undeformed T: wavelength on the undeformed and on the grown sphere, and the amplitude at which the\n"
        "troughs of these wrinkles crease (creasing, an estimate)."
    )
    elements = (Column("g_elements", "by elements", ".9f"),) if args.check else ()
    columns = (
        *named, Column("g_crit", "g_crit", ".9f" if args.check else ".5f"), *elements, Column("degree", "l", ".0f"),
        Column("wavelength_over_T", "wavelength/T", ".3f"), Column("wavelength_deformed_over_T", "grown", ".3f"),
        Column("creasing_amplitude_over_T", "creasing", ".3f"), Column("g_crease", "g crease", ".5f"),
        Column("first", "first"), REASON,
    )  # fmt: skip
    return Answer(title, columns, [case.row() for case in cases], lambda: paper.crease_or_wrinkle(cases))


def _laws(law: str) -> tuple[str, ...]:
    return LAWS if law == "both" else (law,)


def _numbers(words: Sequence[str], option: str, above: float = 0.0) -> list[float]:
    """Numbers and ranges FROM:TO:COUNT, all above a bound, in the order given, each once."""
    numbers: list[float] = []
    for word in words:
        try:
            ends = word.split(":")
            if len(ends) == 1:
                numbers.append(float(word))
                continue
            low, high, count = float(ends[0]), float(ends[1]), int(ends[2])
            if len(ends) > 3 or not 2 <= count <= MOST:
                raise ValueError
        except (ValueError, IndexError):
            raise ValueError(
                f"{option}: {word!r} is neither a number nor FROM:TO:COUNT with a COUNT from 2 to {MOST:,}, "
                "such as 1:2:11."
            ) from None
        step = (high - low) / (count - 1)
        numbers += [float(f"{low + i * step:.12g}") for i in range(count)]      # 1.2, not 1.2000000000000002
    return [_within(number, option, above) for number in dict.fromkeys(numbers)]


def _within(number: float, option: str, above: float = 0.0) -> float:
    if not above < number <= LARGEST:
        raise ValueError(f"{option} must be above {above:g} and at most {LARGEST:g}, got {number:g}.")
    return number


def _writable(path: Path, check_format: Callable[[Path], str]) -> Path:
    """The path, once it is clear that a figure can go there: known before anything is computed."""
    check_format(path)
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder; name a file to write.")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path.parent}: no such folder to write {path.name} into. Make it first.")
    return path


def _table(columns: Sequence[Column], rows: list[dict[str, Any]]) -> str:
    """Aligned text: words to the left, numbers to the right, a dash for what isn't there."""
    cells = [[_cell(row.get(column.key), column) for column in columns] for row in rows]
    widths = [max(map(len, column)) for column in zip([c.heading for c in columns], *cells)]
    lines = [[c.heading for c in columns], *cells]
    return "\n".join(
        "  ".join(f"{cell:{'>' if c.form else '<'}{width}}" for c, cell, width in zip(columns, line, widths)).rstrip()
        for line in lines
    )


def _cell(value: Any, column: Column) -> str:
    if value is None:
        return "" if column is REASON else "–"
    if not column.form:
        return str(value)
    return format(value, column.form) if value == value and abs(value) != float("inf") else "–"
