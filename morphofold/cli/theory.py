"""Theory of the growing bilayer sphere, without a simulation: radius, stress, creases and wrinkles.

Without options each prints what the paper draws (Razavi et al. 2015, Figs. 3 and 4). bifurcation prints what the paper
leaves out: the growth at which the smooth sphere first wrinkles. The help names the options that take ranges. Lengths
are in mm, but only their ratios matter.
"""

from __future__ import annotations

import argparse
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from morphofold.cli import Parser, add_options, add_questions, add_settings, add_shared
from morphofold.cli.streams import print_json
from morphofold.errors import DoesNotApply, NotReadable, OptionsClash, OutOfRange, TooLarge

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXAMPLES = (
    "morphofold theory radius",
    "morphofold theory stress --plot stress.png",
    "morphofold theory critical",
    "morphofold theory bifurcation --thickness 1:3:5 --mu-ratio 1 2 4 --law isotropic",
)
GROWTH_LAWS = ("isotropic", "tangential")
#: values in one FROM:TO:COUNT
MOST_RANGE_VALUES = 10_000
#: most rows of one answer, and most curves of one kind that can be distinguished in a figure
MOST_ROWS, MOST_CURVES = 200_000, 10
#: number of states of a body that typically remain to be checked
STATES_STILL_TO_CHECK = 6

QUESTION_SUMMARIES = {
    "radius": "outer radius of the smooth grown sphere, Eqs. (9) to (11); Fig. 3(a)",
    "stress": "radial and tangential stress through core and cortex; Fig. 3(b)",
    "critical": "growth at which creases can form, Eqs. (12) and (13), and Biot's limit; Fig. 4",
    "bifurcation": "growth at which the smooth sphere first wrinkles, and its wrinkles; with the crease criterion",
}
BIFURCATION_HELP = """
The cortex grows by the stretch g (a ratio of lengths, 1 is none): in all directions if isotropic, along the surface
alone if tangential. Wrinkles are waves all over the sphere, spherical harmonics of degree l: about l around it, each
2 pi C / sqrt(l (l + 1)) long. A crease is a sharp fold of the surface alone; it can form once lambda_r/lambda_theta of
the smooth surface is 2.4, the paper's criterion. The mu ratio is the cortex's shear modulus over the core's. The
defaults are the paper's sphere: C = 50, A/C = 0.5, T = 1, 2 and 3, incompressible. With --body it prints the growth at
which the meshed body of a scene loses its stability, from the exact stiffness of that mesh. If the scene is a sphere or
a part of one, theory is printed too. The effects of the scene are left out.
"""


class Number(NamedTuple):
    """An option that takes numbers: beyond ``least`` and ``largest`` lengths overflow or results lose their digits."""

    metavar: str
    words: str
    least: float
    largest: float
    default_words: str = "{}"


class Question(NamedTuple):
    """A question: its options with their defaults, as a list if an option takes several numbers."""

    numbers: Mapping[str, str | list[str]]
    law: str
    drawn: str = "it"
    words: Mapping[str, str] = {}  # help of options that mean something else here


NUMERIC_OPTIONS = {
    "thickness": Number("MM", "thickness of the cortex, T = C - B", 1e-6, 1e6),
    "radius": Number("MM", "outer radius C", 1e-6, 1e6),
    "ratio": Number("C/B", "outer radius / interface radius", 1 + 1e-6, 1e3),
    "hole_ratio": Number("A/C", "radius of the fixed hole over C", 0.0, 1 - 1e-6),
    "growth": Number("G", "growth of the cortex", 1e-3, 1e3),
    "core_growth": Number("G", "growth of the core", 1e-3, 1e3, "{}, none"),
    "mu_ratio": Number("M", "shear modulus, cortex over core", 1e-4, 1e4),
    "kappa_ratio": Number("K", "bulk over shear modulus", 1.0, math.inf, "{}, incompressible"),
    "points": Number("N", "points per layer", 2, MOST_RANGE_VALUES),
}
SPHERE_DEFAULTS: dict[str, str | list[str]] = {"thickness": ["1", "2", "3"], "radius": "50", "hole_ratio": "0.5"}
QUESTIONS = {
    "radius": Question(
        {**SPHERE_DEFAULTS, "thickness": "2", "growth": ["1:2:11"], "core_growth": "1"},
        "isotropic",
        words={"thickness": "thickness of the cortex, T = C - B"},
    ),
    "stress": Question(
        {**SPHERE_DEFAULTS, "growth": "2", "mu_ratio": "1", "points": "11", "core_growth": "1"},
        "isotropic",
        "the tangential stress through the cortex",
    ),
    "critical": Question(
        {"ratio": ["1.02:1.3:15"], **SPHERE_DEFAULTS, "thickness": [], "core_growth": "1"},
        "both",
        words={"thickness": "of the cortex, instead of --ratio", "radius": "outer radius C, needs --thickness"},
    ),
    "bifurcation": Question(
        {**SPHERE_DEFAULTS, "mu_ratio": ["1", "2", "4"], "kappa_ratio": "inf"},
        "both",
        "critical growth by thickness (by degree with --curve)",
    ),
}
#: key of a column -> its heading, and the format of its numbers
TABLE_COLUMNS = {
    "law": ("law", ""),
    "thickness_mm": ("T [mm]", "g"),
    "mu_ratio": ("mu ratio", "g"),
    "layer": ("layer", ""),
    "growth": ("g", ".4f"),
    "c_over_B": ("c/B", ".6f"),
    "c_over_C": ("c/C", ".6f"),
    "position": ("position", ".3f"),
    "R_mm": ("R [mm]", ".3f"),
    "r_mm": ("r [mm]", ".3f"),
    "sigma_r_over_mu_core": ("sigma_r/mu_core", ".6g"),
    "sigma_theta_over_mu_core": ("sigma_theta/mu_core", ".6g"),
    "sigma_theta_over_mu_cortex": ("sigma_theta/mu_cortex", ".6g"),
    "C_over_B": ("C/B", ".4f"),
    "T_over_C": ("T/C", ".4f"),
    "g_biot": ("g Biot", ".4f"),
    "g_crit": ("g_crit", ".5f"),
    "degree": ("l", "d"),
    "wavelength_mm": ("wavelength [mm]", ".2f"),
    "wavelength_over_T": ("over T", ".3f"),
    "wavelength_deformed_over_T": ("grown, over T", ".3f"),
    "creasing_amplitude_over_T": ("a/T to crease", ".3f"),
    "g_crease": ("g crease", ".5f"),
    "first": ("first", ""),
    "g_theory": ("by theory", ".5f"),
    "degree_theory": ("its l", "d"),
    "difference_percent": ("difference [%]", "+.2f"),
    "elements": ("elements", ",d"),
    "edge_over_T": ("edge/T", ".2f"),
    "seconds": ("seconds", ".1f"),
    "reason": ("note", ""),
}


class Answer(NamedTuple):
    """The answer to a question: title of the table, keys of its columns, all rows, and the figure to draw, if any.

    ``changed`` are the columns whose heading or format differs from TABLE_COLUMNS.
    """

    title: str
    columns: str
    rows: list[dict[str, Any]]
    draw: Callable[[], Figure] | None = None
    changed: Mapping[str, tuple[str, str]] = {}


def add_args(parser: Parser) -> None:
    for what, sub in add_questions(parser, QUESTION_SUMMARIES, {"bifurcation": BIFURCATION_HELP}).items():
        question = QUESTIONS[what]
        size = sub.add_mutually_exclusive_group() if what == "critical" else sub
        for name, default in question.numbers.items():
            number, several = NUMERIC_OPTIONS[name], isinstance(default, list)
            shown = " ".join(default) if several else default
            (size if name in ("ratio", "thickness") else sub).add_argument(
                _option_of_name(name),
                nargs="+" if several else None,
                metavar=number.metavar,
                help=question.words.get(name, number.words)
                + ("; numbers or FROM:TO:COUNT" if several else "")
                + (f" (default: {number.default_words.format(shown)})" if shown else ""),
            )
        if what == "bifurcation":
            _add_bifurcation_options(sub)
        sub.add_argument(
            "--law", choices=[*GROWTH_LAWS, "both"], help=f"growth of the cortex (default: {question.law})"
        )
        drawn = f"also draw {question.drawn}: .png, .svg or .pdf"
        add_options(sub, ("--json", None, "print as JSON"), ("--plot", "FILE", drawn))
        add_shared(sub, default=argparse.SUPPRESS)  # so that they work before and after WHAT


def _add_bifurcation_options(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        ("--curve", None, "critical growth of each degree, not only the least"),
        ("--body", "SCENE", "a built-in scene or a TOML file, instead of the options above"),
    )
    add_settings(parser, "with --body: change one value of the scene; may be repeated")


def run(args: argparse.Namespace) -> int:
    from morphofold import __version__
    from morphofold.io.files import check_place
    from morphofold.io.folders import refuse_overlap
    from morphofold.report.plots.line_plots import check_format

    body = vars(args).get("body") is not None
    if args.what == "bifurcation":
        _refuse_sphere_or_settings(args)
    plot = None if args.plot is None else Path(args.plot)
    if plot is not None:  # refuses before anything is computed
        check_format(plot)
        check_place(plot)
        refuse_overlap(plot)
    if not body:
        _parse_numeric_options(args)
        _refuse_large_answers(args)
    answer = (
        _answer_of_body(args)
        if body
        else _answer_of_bifurcation(args)
        if args.what == "bifurcation"
        else _answer_of_smooth_sphere(args)
    )
    if plot is not None and answer.draw is not None:
        _write_plot(answer.draw(), plot)
    if args.json:
        left_out = ("command", "what", "run", "json", "plot", "quiet", "debug")
        asked = {key: value for key, value in vars(args).items() if key not in left_out and value not in (None, [])}
        if asked.get("kappa_ratio") == math.inf:
            asked["kappa_ratio"] = "inf"  # JSON has no infinity
        content = {"morphofold": __version__, "theory": args.what, "parameters": asked, "rows": answer.rows}
        print_json(content)
    else:
        print(answer.title)
        print(_aligned_table(answer))
        if plot is not None:
            print(f"-> {plot}")
    return 0


def _answer_of_smooth_sphere(args: argparse.Namespace) -> Answer:
    """Answer for radius, stress or creases of the smooth sphere."""
    from morphofold.report.plots import theory_plots
    from morphofold.sim import theory_tables

    laws, core = _growth_laws(args.law), {"g_core": args.core_growth, "A_over_C": args.hole_ratio}
    if args.what == "radius":
        sphere = (args.growth, args.thickness, args.radius, laws)
        return Answer(
            f"Outer radius c of the smooth grown sphere, T = {args.thickness:g} mm, C = {args.radius:g} mm, "
            f"B = {args.radius - args.thickness:g} mm; Eqs. (9) to (11)",
            "law growth c_over_B c_over_C",
            theory_tables.radius_rows(*sphere, **core),
            partial(theory_plots.radius_figure, *sphere, **core),
        )
    if args.what == "critical":
        ratios = _radius_ratios(args)
        return Answer(
            "Growth at which the outer surface can crease, lambda_r/lambda_theta = 2.4 (Eq. 12 isotropic, Eq. 13 "
            "tangential),\nand at which it is unstable to waves of vanishing length (Biot, 3.383)",
            "law C_over_B T_over_C g_crease g_biot reason",
            theory_tables.critical_rows(ratios, laws, **core),
            partial(theory_plots.critical_figure, ratios, laws, **core),
            {"g_crease": ("g crease", ".4f")},
        )
    if args.points != int(args.points):
        raise OutOfRange(f"--points must be a whole number, got {args.points:g}.")
    args.points = int(args.points)
    sphere, options = (args.growth, args.thickness, args.radius, laws), {"mu_ratio": args.mu_ratio, **core}
    return Answer(
        f"Cauchy stress at growth g = {args.growth:g}, C = {args.radius:g} mm, mu_cortex/mu_core = {args.mu_ratio:g}; "
        "tension is positive.\nUnits: the core's shear modulus mu_core; last column the cortex's own, as in Fig. 3(b). "
        "Position: 0 inside, 1 outside.",
        "law thickness_mm layer position R_mm r_mm sigma_r_over_mu_core sigma_theta_over_mu_core "
        "sigma_theta_over_mu_cortex",
        theory_tables.stress_rows(*sphere, points=args.points, **options),
        partial(theory_plots.stress_figure, *sphere, **options),
    )


def _radius_ratios(args: argparse.Namespace) -> list[float]:
    """C/B, as given or from --thickness and --radius."""
    from morphofold.sim.theory_tables import outer_ratio

    if args.thickness is not None:
        args.ratio = [outer_ratio(T, args.radius) for T in args.thickness]
    elif args.radius is not None:
        raise OptionsClash("--radius needs --thickness, which is missing: give --thickness, or --ratio alone.")
    return args.ratio


def _answer_of_bifurcation(args: argparse.Namespace) -> Answer:
    from morphofold.cli.progress import progress
    from morphofold.report.plots import theory_plots
    from morphofold.sim import theory_tables

    laws = _growth_laws(args.law)
    short = len(laws) * len(args.mu_ratio) * len(args.thickness) <= 18
    with progress("bifurcation", args.quiet or short) as show:
        cases = theory_tables.bifurcation_cases(
            args.thickness,
            args.radius,
            args.mu_ratio,
            laws,
            kappa_ratio=args.kappa_ratio,
            A_over_C=args.hole_ratio,
            progress=show,
        )
    if args.curve:
        title = "Growth at which spherical harmonics of degree l first grow on the smooth sphere"
        rows = [row for case in cases for row in case.curve_rows()]
        draw = partial(theory_plots.bifurcation_curves, cases)
        return Answer(title, "law thickness_mm mu_ratio degree g_crit reason", rows, draw)
    return Answer(
        f"Growth g_crit at which the smooth sphere first wrinkles, C = {args.radius:g} mm, kappa/mu = "
        f"{args.kappa_ratio:g}; g crease: lambda_r/lambda_theta = 2.4.\n"
        "Wavelength on the ungrown sphere (grown: on the grown one). a: amplitude at which the troughs of these\n"
        "wrinkles crease (an estimate). T is the ungrown thickness throughout.",
        "law thickness_mm mu_ratio g_crit degree wavelength_mm wavelength_over_T wavelength_deformed_over_T "
        "creasing_amplitude_over_T g_crease first reason",
        [case.row() for case in cases],
        partial(theory_plots.crease_or_wrinkle, cases),
    )


def _refuse_sphere_or_settings(args: argparse.Namespace) -> None:
    """Raise for options of the sphere with a body, and for settings without one."""
    if args.body is None:
        if args.settings:
            raise OptionsClash("--set changes a scene, but there is none: name it with --body.")
        return
    wrong = [
        _option_of_name(name)
        for name in (*QUESTIONS["bifurcation"].numbers, "law", "curve", "plot")
        if getattr(args, name) not in (None, False)
    ]
    if wrong:
        raise OptionsClash(
            f"--body takes all values from its scene and gives one row: leave out {', '.join(wrong)}; change the scene "
            "with --set, such as --set material.mu_ratio=2."
        )


def _answer_of_body(args: argparse.Namespace) -> Answer:
    from morphofold.cli.progress import progress
    from morphofold.sim import theory_tables
    from morphofold.sim.scene.files import load_scene

    scene = load_scene(args.body, args.settings)
    if scene.geometry.shape == "radial":
        raise DoesNotApply(f"{scene.name}: a radial scene has no mesh. Leave out --body: its theory needs none.")
    looks: list[float] = []
    with progress(scene.name, args.quiet) as show:

        def look(g: float, eigenvalue: float) -> None:
            looks.append(g)
            state = "stable" if eigenvalue > 0 else "unstable"
            show(len(looks) / (len(looks) + STATES_STILL_TO_CHECK), f"{state} at g = {g:.5f}")

        row = theory_tables.body_row(scene, look)
    title = (
        f"Growth g_crit at which the meshed body of {scene.name} loses its stability: {row['law']} growth,\n"
        f"T = {row['thickness_mm']:g} mm, mu ratio {row['mu_ratio']:g}, kappa/mu = {row['kappa_ratio']:g}; left out: "
        f"{', '.join(row['left_out']) or 'nothing'}.\nWavelength and longest edge are those of the ungrown surface."
    )
    columns = (
        "g_crit degree wavelength_mm wavelength_over_T g_theory degree_theory difference_percent elements edge_over_T "
        "seconds reason"
    )
    return Answer(title, columns, [row], changed={"degree": ("l", ".1f"), "wavelength_mm": ("wave [mm]", ".2f")})


def _growth_laws(law: str) -> tuple[str, ...]:
    return GROWTH_LAWS if law == "both" else (law,)


def _option_of_name(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _parse_numeric_options(args: argparse.Namespace) -> None:
    """Replace the text of each option, or its default, by numbers: a list if an option takes several."""
    question = QUESTIONS[args.what]
    args.law = args.law or question.law
    meant = dict(question.numbers)
    if args.what == "critical":  # a ratio, or a thickness and a radius
        meant["radius" if args.thickness is None else "ratio"] = ""
    for name, default in meant.items():
        given, option = getattr(args, name) or default, _option_of_name(name)
        if not given:
            continue
        words = [given] if isinstance(given, str) else given
        numbers = _parsed_numbers(words, option, NUMERIC_OPTIONS[name].least, NUMERIC_OPTIONS[name].largest)
        if isinstance(given, str) and len(numbers) > 1:
            raise NotReadable(f"{option} takes one number, got the range {given!r}.")
        setattr(args, name, numbers[0] if isinstance(given, str) else numbers)


def _parsed_numbers(words: Sequence[str], option: str, least: float, largest: float) -> list[float]:
    """Read numbers and ranges FROM:TO:COUNT, all within limits, in the order given, each once."""
    numbers: list[float] = []
    for word in words:
        try:
            ends = word.split(":")
            if len(ends) == 1:
                numbers.append(float(word))
                continue
            low, high, count = float(ends[0]), float(ends[1]), int(ends[2])
            if len(ends) > 3 or not 2 <= count <= MOST_RANGE_VALUES:
                raise NotReadable
        except (ValueError, IndexError):
            raise NotReadable(
                f"{option}: {word!r} is neither a number nor FROM:TO:COUNT with a COUNT from 2 to "
                f"{MOST_RANGE_VALUES:,}, such as 1:2:11."
            ) from None
        step = (high - low) / (count - 1)
        numbers += [float(f"{low + i * step:.12g}") for i in range(count)]  # 1.2, not 1.2000000000000002
    for number in numbers:
        if not least <= number <= largest:
            raise OutOfRange(f"{option} must lie between {least:.10g} and {largest:.10g}, got {number:g}.")
    return list(dict.fromkeys(numbers))


def _refuse_large_answers(args: argparse.Namespace) -> None:
    """Raise before anything is computed if the answer or its figure would be too large to read."""
    numbers = {name: getattr(args, name) for name in QUESTIONS[args.what].numbers}
    several = {name: len(value) for name, value in numbers.items() if isinstance(value, list)}
    rows = (
        math.prod(several.values()) * len(_growth_laws(args.law)) * int(2 * getattr(args, "points", 0.5))
    )  # two layers
    if rows > MOST_ROWS:
        raise TooLarge(f"this asks for {rows:,} rows, at most {MOST_ROWS:,} are allowed: give fewer numbers at once.")
    curves = {"stress": ["thickness"], "bifurcation": ["mu_ratio", *(["thickness"] if vars(args).get("curve") else [])]}
    for name in curves.get(args.what, []) if args.plot is not None else []:
        if several[name] > MOST_CURVES:
            raise TooLarge(
                f"--plot draws at most {MOST_CURVES} numbers of {_option_of_name(name)}, got {several[name]}."
            )


def _write_plot(figure: Figure, plot: Path) -> None:
    from morphofold.io import atomic_file
    from morphofold.report.plots import line_plots

    try:
        with atomic_file(plot) as temporary:
            line_plots.save(figure, temporary)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(plot)) from error  # not of the temporary file beside it


def _aligned_table(answer: Answer) -> str:
    """Aligned text: words to the left, numbers to the right, a dash for a missing value; reasons in footnotes."""
    reasons = list(dict.fromkeys(row["reason"] for row in answer.rows if row.get("reason")))
    notes = {reason: f"[{number}]" for number, reason in enumerate(reasons, 1)}
    columns = []
    for key in answer.columns.split():
        heading, form = {**TABLE_COLUMNS, **answer.changed}[key]
        if key != "reason" or notes:
            values = [row.get(key) for row in answer.rows]
            cells = [heading, *(notes.get(v, "") if key == "reason" else _formatted_cell(v, form) for v in values)]
            width = max(map(len, cells))
            columns.append([cell.rjust(width) if form else cell.ljust(width) for cell in cells])
    lines = ["  ".join(cells).rstrip() for cells in zip(*columns)]
    footnotes = (textwrap.fill(f"{note} {reason}", 120, subsequent_indent="    ") for reason, note in notes.items())
    return "\n".join([*lines, *footnotes])


def _formatted_cell(value: Any, form: str) -> str:
    if value is None or value != value:
        return "–"
    return "∞" if value == "inf" else format(value, form)
