"""``morphofold compare``: read analyses, compare them, write the page."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from morphofold.cli.command_options import Answer, Compare
from morphofold.cli.terminal_output import progress
from morphofold.comparison import Comparison, compare
from morphofold.digests_and_json import printable
from morphofold.errors import NamedTwice, NotReadable
from morphofold.io import refuse_foreign
from morphofold.progress_callbacks import part_of
from morphofold.report.pages.cortex_pages import VERDICT_WORDS
from morphofold.results import read_analysis, read_stages

PRINTED_MEASURES = "gyrification_index", "mean_cortical_thickness_mm", "median_gyral_thickness_mm"


def run(args: Compare) -> Answer:
    folders = _by_name("", args.analyses, "NAME=DIR, for example model=fig5-analysis")
    groups = _by_name("--group ", args.group, "GROUP=NAME,NAME, for example model=thin,thick")
    colours = _by_name("--colour ", args.colour, "NAME=RRGGBB, for example model=0072b2")
    growth_folders = _by_name("--growth ", args.growth, "NAME=DIR, for example fig5=fig5-growth")
    refuse_foreign(args.out, [*folders.values(), *growth_folders.values()])  # refuses before minutes of work
    with progress("compare", args.quiet) as on_progress:
        measures = {}
        for i, (name, folder) in enumerate(folders.items()):
            on_progress(0.15 * i / len(folders), f"reading {name}")
            measures[name] = read_analysis(folder)
        stages = {name: read_stages(folder) for name, folder in growth_folders.items()}
        on_progress(0.15, "comparing")
        comparison = compare(
            measures,
            groups={name: printable(group_text).split(",") for name, group_text in groups.items()} or None,
            growth=stages,
            colours={name: "#" + colour.removeprefix("#") for name, colour in colours.items()},
            spins=args.spins,
        )
        page = comparison.report(args.out, progress=part_of(on_progress, 0.25, 0.75))
        on_progress(1.0, "done")
    return Answer(page.with_name("comparison.json"), _lines(comparison, page))


def _lines(comparison: Comparison, page: Path) -> Iterator[str]:
    for row in comparison.table:
        if row["measure"] in PRINTED_MEASURES:
            values = ", ".join(f"{n} {'n/a' if row[n] is None else f'{row[n]:.2f}'}" for n in comparison.names)
            yield f"{row['measure']}: {values}"
    for person in comparison.people:
        folds = person.agreements[0]
        yield (
            f"heights of folds of {person.grown} and {person.person} correlate by {folds.tested.value:.3f}, before "
            f"growth {folds.tested.control:.3f}, with deepened sulci {folds.deepened.control:.3f}: "
            f"{VERDICT_WORDS.get(person.verdict, person.verdict)}"
        )
    yield f"-> {page}"


def _by_name(option_prefix: str, item_texts: Sequence[str], expected_form: str) -> dict[str, str]:
    """Values of items NAME=VALUE by their names, each of which is given once."""
    value_of_name: dict[str, str] = {}
    for item in item_texts:
        name, _, value = item.partition("=")
        if not name or not value or (option_prefix == "--group " and not all(value.split(","))):
            raise NotReadable(f"{option_prefix}{item!r} must have the form {expected_form}.")
        if printable(name) in value_of_name:
            raise NamedTwice(f"{option_prefix}{item!r}: the name {name!r} is given twice; give it once.")
        value_of_name[printable(name)] = value
    return value_of_name
