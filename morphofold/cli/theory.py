"""What can be known of the growing bilayer sphere without simulating it: radius, stress, creases and wrinkles.

Without options each prints what the paper draws (Razavi et al. 2015, Figs. 3 and 4), and bifurcation what it leaves
out: the growth at which the smooth sphere first wrinkles. Options that take ranges say so. Lengths are in mm, but
only their ratios matter.
"""

from __future__ import annotations

import argparse
import math
import textwrap
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from morphofold.cli import add_shared

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LAWS = ("isotropic", "tangential")
#: values in one FROM:TO:COUNT
MOST = 10_000
#: rows of one answer, and curves of one kind that can be told apart in a figure
MOST_ROWS, MOST_CURVES = 200_000, 10
#: relative difference of the two routes to g_crit up to which --check is content
AGREE = 1e-6
RANGES = "numbers or FROM:TO:COUNT"
#: option that takes numbers -> the least and the largest; beyond them lengths overflow or answers lose their digits
LIMITS = {
    "thickness": (1e-6, 1e6), "radius": (1e-6, 1e6), "ratio": (1 + 1e-6, 1e3), "hole_ratio": (0.0, 1 - 1e-6),
    "growth": (1e-3, 1e3), "core_growth": (1e-3, 1e3), "mu_ratio": (1e-4, 1e4), "kappa_ratio": (1.0, math.inf),
    "points": (2, MOST),
}  # fmt: skip

WORDS = {
    "radius": "outer radius of the smooth grown sphere, Eqs. (9) to (11); Fig. 3(a)",
    "stress": "radial and tangential stress through core and cortex; Fig. 3(b)",
    "critical": "growth at which creases can form, Eqs. (12) and (13), and Biot's limit; Fig. 4",
    "bifurcation": "growth at which the smooth sphere first wrinkles, and how; beside the crease criterion",
}
BIFURCATION = """
The cortex grows by the stretch g (a ratio of lengths, 1 is none): in all directions if isotropic, along the surface
alone if tangential. Wrinkles are waves all over the sphere, spherical harmonics of degree l: about l around it, each
2 pi C / sqrt(l (l + 1)) long. A crease is a sharp fold of the surface alone; it can form once lambda_r/lambda_theta of
the smooth surface is 2.4, the paper's criterion. The mu ratio is the cortex's shear modulus over the core's. The
defaults are the paper's sphere: C = 50, A/C = 0.5, T = 1, 2 and 3, incompressible. With --body it is the growth at
which the elements of a scene lose their stability, by the exact stiffness of that very mesh, beside the theory if the
scene is a sphere or a part of one; its effects are left out.
"""
#: options of the sphere of bifurcation -> their words if not given; a --body has its own
SPHERE = {
    "thickness": ["1", "2", "3"], "radius": "50", "hole_ratio": "0.5", "mu_ratio": ["1", "2", "4"],
    "kappa_ratio": "inf", "law": "both",
}  # fmt: skip
#: states of a body that are typically still to be looked at
STILL_TO_LOOK_AT = 6


class Column(NamedTuple):
    """A column of a printed table: key of the rows, heading, format of numbers."""

    key: str
    heading: str
    form: str = ""


class Answer(NamedTuple):
    """What a question comes to: words above the table, its columns, all rows, and the figure to draw, if any."""

    title: str
    columns: Sequence[Column]
    rows: list[dict[str, Any]]
    draw: Callable[[], Figure] | None = None


LAW, THICKNESS, MU = Column("law", "law"), Column("thickness_mm", "T [mm]", "g"), Column("mu_ratio", "mu ratio", "g")
DEGREE, REASON = Column("degree", "l", "d"), Column("reason", "note")


def add_args(parser: argparse.ArgumentParser) -> None:
    questions = parser.add_subparsers(dest="what", metavar="WHAT", required=True)

    def question(name: str, more: str = "") -> argparse.ArgumentParser:
        words = f"{WORDS[name][0].upper()}{WORDS[name][1:]}. {more}"
        return questions.add_parser(name, help=WORDS[name], description=words, formatter_class=parser.formatter_class)

    radius = question("radius")
    radius.add_argument("--thickness", default="2", metavar="MM", help="cortex, T = C - B (default: 2)")
    _add_sphere(radius)
    radius.add_argument("--growth", nargs="+", default=["1:2:11"], metavar="G",
                        help=f"of the cortex; {RANGES} (default: 1:2:11)")  # fmt: skip
    _add_core_growth(radius)
    _add_common(radius, "isotropic")

    stress = question("stress")
    _add_thicknesses(stress)
    _add_sphere(stress)
    stress.add_argument("--growth", default="2", metavar="G", help="of the cortex (default: 2)")
    stress.add_argument("--mu-ratio", default="1", metavar="M", help="shear modulus, cortex over core (default: 1)")
    stress.add_argument("--points", default="11", metavar="N", help="per layer (default: 11)")
    _add_core_growth(stress)
    _add_common(stress, "isotropic", "the tangential stress through the cortex")

    critical = question("critical")
    size = critical.add_mutually_exclusive_group()
    size.add_argument("--ratio", nargs="+", metavar="C/B",
                      help=f"outer radius / interface radius; {RANGES} (default: 1.02:1.3:15)")  # fmt: skip
    size.add_argument("--thickness", nargs="+", metavar="MM", help=f"of the cortex, instead of --ratio; {RANGES}")
    _add_sphere(critical, radius=None)
    _add_core_growth(critical)
    _add_common(critical, "both")

    bifurcation = question("bifurcation", BIFURCATION)
    _add_thicknesses(bifurcation)
    _add_sphere(bifurcation)
    bifurcation.add_argument("--mu-ratio", nargs="+", metavar="M",
                             help=f"shear modulus, cortex over core; {RANGES} (default: 1 2 4)")  # fmt: skip
    bifurcation.add_argument("--kappa-ratio", metavar="K",
                             help="bulk over shear modulus (default: inf, incompressible)")  # fmt: skip
    bifurcation.add_argument("--check", action="store_true", help="find each g_crit again, by finite elements")
    bifurcation.add_argument("--curve", action="store_true", help="critical growth by degree, not the least alone")
    bifurcation.add_argument("--body", metavar="SCENE",
                             help="a built-in scene or a TOML file, instead of the options above")  # fmt: skip
    bifurcation.add_argument("--set", dest="settings", metavar="TABLE.KEY=VALUE", action="append",
                             help="with --body: change one value of the scene; may be repeated")  # fmt: skip
    _add_common(bifurcation, "both", "critical growth by thickness (by degree with --curve)")
    bifurcation.set_defaults(**dict.fromkeys(SPHERE))       # to tell what is asked for from what is left as it is


def _add_thicknesses(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--thickness", nargs="+", default=["1", "2", "3"], metavar="MM",
                        help=f"of the cortex, T = C - B; {RANGES} (default: 1 2 3)")  # fmt: skip


def _add_sphere(parser: argparse.ArgumentParser, radius: str | None = "50") -> None:
    where = "" if radius else ", with --thickness"
    parser.add_argument("--radius", default=radius, metavar="MM", help=f"outer radius C{where} (default: 50)")
    parser.add_argument("--hole-ratio", default="0.5", metavar="A/C",
                        help="radius of the fixed hole over C (default: 0.5)")  # fmt: skip


def _add_core_growth(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--core-growth", default="1", metavar="G", help="of the core (default: 1, none)")


def _add_common(parser: argparse.ArgumentParser, law: str, drawn: str = "it") -> None:
    parser.add_argument("--law", choices=[*LAWS, "both"], default=law, help=f"growth of the cortex (default: {law})")
    parser.add_argument("--json", action="store_true", help="print as JSON")
    parser.add_argument("--plot", metavar="FILE", help=f"also draw {drawn}: .png, .svg or .pdf")
    add_shared(parser, default=argparse.SUPPRESS)           # so that they count on either side of WHAT


def run(args: argparse.Namespace) -> int:
    from morphofold import __version__
    from morphofold.io.files import check_place
    from morphofold.provenance import strict_json
    from morphofold.report.plots.line_plots import check_format

    if args.what == "bifurcation":
        _sphere_or_body(args)
    plot = None if args.plot is None else Path(args.plot)
    if plot is not None:                                    # refused before anything is computed
        check_format(plot)
        check_place(plot)
    _read_numbers(args)
    _refuse_too_much(args)
    answer = {"radius": _radius, "stress": _stress, "critical": _critical, "bifurcation": _bifurcation}[args.what](args)
    if plot is not None and answer.draw is not None:
        _write_plot(answer.draw(), plot)
    if args.json:
        left_out = ("command", "what", "run", "json", "plot", "quiet", "debug")
        asked = {key: value for key, value in vars(args).items() if key not in left_out and value is not None}
        if asked.get("kappa_ratio") == math.inf:
            asked["kappa_ratio"] = "inf"                    # JSON has no infinity
        content = {"morphofold": __version__, "theory": args.what, "parameters": asked, "rows": answer.rows}
        print(strict_json(content), end="")
    else:
        print(answer.title)
        print(_table(answer.columns, answer.rows))
        if plot is not None:
            print(f"-> {plot}")
    _warn_of_differences(answer.rows)
    return 0


def _radius(args: argparse.Namespace) -> Answer:
    from morphofold.report.plots import theory_plots
    from morphofold.sim import theory_tables

    sphere = (args.thickness, args.radius, _laws(args.law))
    options = {"g_core": args.core_growth, "A_over_C": args.hole_ratio}
    rows = theory_tables.radius_rows(args.growth, *sphere, **options)
    title = (
        f"Outer radius c of the smooth grown sphere, T = {args.thickness:g} mm, C = {args.radius:g} mm, "
        f"B = {args.radius - args.thickness:g} mm; Eqs. (9) to (11)"
    )
    columns = (LAW, Column("growth", "g", ".4f"), Column("c_over_B", "c/B", ".6f"), Column("c_over_C", "c/C", ".6f"))
    return Answer(title, columns, rows, lambda: theory_plots.radius_figure(args.growth, *sphere, **options))


def _stress(args: argparse.Namespace) -> Answer:
    from morphofold.report.plots import theory_plots
    from morphofold.sim import theory_tables

    if args.points != int(args.points):
        raise ValueError(f"--points must be a whole number, got {args.points:g}.")
    args.points = int(args.points)
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
    return Answer(title, columns, rows, lambda: theory_plots.stress_figure(*sphere, **options))


def _critical(args: argparse.Namespace) -> Answer:
    from morphofold.report.plots import theory_plots
    from morphofold.sim import theory_tables

    if args.thickness is not None:
        args.radius = args.radius or 50.0
        args.ratio = [theory_tables.outer_ratio(T, args.radius) for T in args.thickness]
    elif args.radius is not None:
        raise ValueError("--radius makes a --thickness a ratio, and there is none: give --thickness, or --ratio alone.")
    else:
        args.ratio = args.ratio or _numbers(["1.02:1.3:15"], "--ratio", *LIMITS["ratio"])
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
    return Answer(title, columns, rows, lambda: theory_plots.critical_figure(args.ratio, laws, **options))


def _bifurcation(args: argparse.Namespace) -> Answer:
    from morphofold.cli.progress import progress
    from morphofold.report.plots import theory_plots
    from morphofold.sim import theory_tables

    if args.body is not None:
        return _body(args)
    if args.check and args.curve:
        raise ValueError("--check finds the least growth again, not the curve: leave out --check or --curve.")
    laws = _laws(args.law)
    short = len(laws) * len(args.mu_ratio) * len(args.thickness) <= 18 and not args.check
    with progress("bifurcation", args.quiet or short) as tell:
        cases = theory_tables.bifurcation_cases(
            args.thickness, args.radius, args.mu_ratio, laws,
            kappa_ratio=args.kappa_ratio, A_over_C=args.hole_ratio, check=args.check, progress=tell,
        )  # fmt: skip
    if args.curve:
        title = "Growth at which spherical harmonics of degree l first grow on the smooth sphere"
        columns: tuple[Column, ...] = (LAW, THICKNESS, MU, DEGREE, Column("g_crit", "g_crit", ".5f"), REASON)
        rows = [row for case in cases for row in case.curve_rows()]
        return Answer(title, columns, rows, lambda: theory_plots.bifurcation_curves(cases))
    title = (
        f"Growth g_crit at which the smooth sphere first wrinkles, C = {args.radius:g} mm, kappa/mu = "
        f"{args.kappa_ratio:g}; g crease: lambda_r/lambda_theta = 2.4.\n"
        "Wavelength on the ungrown sphere (grown: on the grown one). a: amplitude at which the troughs of these\n"
        "wrinkles crease (an estimate). T is the ungrown thickness throughout."
    )
    if args.check:
        found: tuple[Column, ...] = (
            Column("g_crit", "g_crit", ".9f"), Column("g_elements", "by elements", ".9f"),
            Column("difference", "difference", ".1e"), DEGREE,
        )  # fmt: skip
    else:
        found = (
            Column("g_crit", "g_crit", ".5f"), DEGREE, Column("wavelength_mm", "wavelength [mm]", ".2f"),
            Column("wavelength_over_T", "over T", ".3f"),
            Column("wavelength_deformed_over_T", "grown, over T", ".3f"),
            Column("creasing_amplitude_over_T", "a/T to crease", ".3f"),
        )  # fmt: skip
    columns = (LAW, THICKNESS, MU, *found, Column("g_crease", "g crease", ".5f"), Column("first", "first"), REASON)
    return Answer(title, columns, [case.row() for case in cases], lambda: theory_plots.crease_or_wrinkle(cases))


def _sphere_or_body(args: argparse.Namespace) -> None:
    """Give the sphere its defaults, or refuse the options that are not for a body."""
    if args.body is None:
        if args.settings is not None:
            raise ValueError("--set changes a scene, and there is none: name it with --body.")
        for name, words in SPHERE.items():
            if getattr(args, name) is None:
                setattr(args, name, words)
        return
    wrong = [f"--{name.replace('_', '-')}" for name in (*SPHERE, "check", "curve", "plot")
             if getattr(args, name) not in (None, False)]  # fmt: skip
    if wrong:
        raise ValueError(f"--body takes all from its scene and gives one row: leave out {', '.join(wrong)}; change the "
                         "scene by --set, such as --set material.mu_ratio=2.")  # fmt: skip


def _body(args: argparse.Namespace) -> Answer:
    from morphofold.cli.progress import progress
    from morphofold.sim import theory_tables
    from morphofold.sim.scene.files import load_scene

    scene = load_scene(args.body, args.settings or ())
    if scene.geometry.shape == "radial":
        raise ValueError(f"{scene.name}: a radial scene has no mesh; its theory is what comes without --body.")
    looks: list[float] = []
    with progress(scene.name, args.quiet) as tell:

        def look(g: float, eigenvalue: float) -> None:
            looks.append(g)
            state = "stable" if eigenvalue > 0 else "unstable"
            tell(len(looks) / (len(looks) + STILL_TO_LOOK_AT), f"{state} at g = {g:.5f}")

        row = theory_tables.body_row(scene, look)
    title = (
        f"Growth g_crit at which the body of {scene.name} loses its stability, as it is meshed: {row['law']} growth,\n"
        f"T = {row['thickness_mm']:g} mm, mu ratio {row['mu_ratio']:g}, kappa/mu = {row['kappa_ratio']:g}; left out: "
        f"{', '.join(row['left_out']) or 'nothing'}.\nWavelength on the ungrown surface; edge: the longest of it."
    )
    columns = (
        Column("g_crit", "g_crit", ".5f"), Column("degree", "l", ".1f"),
        Column("wavelength_mm", "wave [mm]", ".2f"), Column("wavelength_over_T", "over T", ".3f"),
        Column("g_theory", "by theory", ".5f"), Column("degree_theory", "its l", "d"),
        Column("difference_percent", "difference [%]", "+.2f"), Column("elements", "elements", ",d"),
        Column("edge_over_T", "edge/T", ".2f"), Column("seconds", "seconds", ".1f"), REASON,
    )  # fmt: skip
    return Answer(title, columns, [row])


def _laws(law: str) -> tuple[str, ...]:
    return LAWS if law == "both" else (law,)


def _read_numbers(args: argparse.Namespace) -> None:
    """Put numbers in the place of words: a list of them where an option takes several, one where it takes one."""
    for name, limits in LIMITS.items():
        words, option = getattr(args, name, None), f"--{name.replace('_', '-')}"
        if isinstance(words, str):
            numbers = _numbers([words], option, *limits)
            if len(numbers) > 1:
                raise ValueError(f"{option} takes one number, got the range {words!r}.")
            setattr(args, name, numbers[0])
        elif words is not None:
            setattr(args, name, _numbers(words, option, *limits))


def _numbers(words: Sequence[str], option: str, least: float, largest: float) -> list[float]:
    """Numbers and ranges FROM:TO:COUNT, all within limits, in the order given, each once."""
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
    for number in numbers:
        if not least <= number <= largest:
            raise ValueError(f"{option} must lie between {least:.10g} and {largest:.10g}, got {number:g}.")
    return list(dict.fromkeys(numbers))


def _refuse_too_much(args: argparse.Namespace) -> None:
    """Raise before anything is computed if the answer or its figure would be beyond reading."""
    if vars(args).get("body") is not None:
        return
    several = {name: len(value) for name, value in vars(args).items() if isinstance(value, list)}
    rows = math.prod(several.values()) * len(_laws(args.law)) * int(2 * getattr(args, "points", 0.5))   # two layers
    if rows > MOST_ROWS:
        raise ValueError(f"this asks for {rows:,} rows, and {MOST_ROWS:,} are the most: give fewer numbers at once.")
    curves = {"stress": ["thickness"], "bifurcation": ["mu_ratio", *(["thickness"] if vars(args).get("curve") else [])]}
    for name in curves.get(args.what, []) if args.plot is not None else []:
        if several[name] > MOST_CURVES:
            option = f"--{name.replace('_', '-')}"
            raise ValueError(f"--plot draws at most {MOST_CURVES} numbers of {option}, got {several[name]}.")


def _warn_of_differences(rows: list[dict[str, Any]]) -> None:
    checked = [row["difference"] for row in rows if "difference" in row and isinstance(row["degree"], int)]
    apart = sum(not abs(difference) <= AGREE for difference in checked)
    if apart:
        warnings.warn(f"--check: {apart} of {len(checked)} growths differ by more than {AGREE:g} between the two "
                      "routes, or were found by one alone; see difference.", stacklevel=2)  # fmt: skip


def _write_plot(figure: Figure, plot: Path) -> None:
    from morphofold.io import atomic_file
    from morphofold.report.plots import line_plots

    try:
        with atomic_file(plot) as temporary:
            line_plots.save(figure, temporary)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(plot)) from error    # not of the temporary file beside it


def _table(columns: Sequence[Column], rows: list[dict[str, Any]]) -> str:
    """Aligned text: words to the left, numbers to the right, a dash for what isn't there; reasons in footnotes."""
    reasons = list(dict.fromkeys(row[REASON.key] for row in rows if row.get(REASON.key)))
    notes = {reason: f"[{number}]" for number, reason in enumerate(reasons, 1)}
    shown = [column for column in columns if column is not REASON or notes]
    cells = [[_cell(row.get(column.key), column, notes) for column in shown] for row in rows]
    widths = [max(map(len, column)) for column in zip([c.heading for c in shown], *cells)]
    lines = [[c.heading for c in shown], *cells]
    table = [
        "  ".join(f"{cell:{'>' if c.form else '<'}{width}}" for c, cell, width in zip(shown, line, widths)).rstrip()
        for line in lines
    ]
    footnotes = (textwrap.fill(f"{note} {reason}", 120, subsequent_indent="    ") for reason, note in notes.items())
    return "\n".join([*table, *footnotes])


def _cell(value: Any, column: Column, notes: dict[str, str]) -> str:
    if column is REASON:
        return notes.get(value, "")
    if value is None or value != value:
        return "–"
    return "∞" if value == "inf" else format(value, column.form)
