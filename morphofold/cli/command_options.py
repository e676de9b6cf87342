"""The options of all commands: a class for each command, from which its parser, ``--help`` and docs are made.

Fields before ``KW_ONLY`` are arguments, those after it options, and the text below a field is its help. This module is
imported by every command, ``--help`` too, and imports nothing heavy; the work of a command is the function ``run`` of
the module with its name, or the one that ``work`` names.
"""

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from cyclopts import Group, Parameter, Token

from morphofold.errors import BadUsage, NotReadable, OptionsClash, OutOfRange

MEASURING_GROUP = Parameter(group=Group("Measuring", sort_key=1))
WORKER_GROUP = Parameter(group=Group("Workers", sort_key=2))
RUNNING_GROUP = Parameter(group=Group("Output and running", sort_key=3))
HIDE_DEFAULT = Parameter(show_default=False)  # a default that the help says, or none
HEMISPHERE_SPELLINGS = {"lh": "lh l left", "rh": "rh r right", "both": "both"}


def _hemisphere(_: Any, tokens: tuple[Token, ...]) -> str:
    """FreeSurfer's spelling of a hemisphere, from any spelling."""
    spelling = tokens[0].value
    for hemi, spellings in HEMISPHERE_SPELLINGS.items():
        if spelling.lower() in spellings.split():
            return hemi
    raise BadUsage(f"--hemi: {spelling!r} is not a hemisphere. Pass lh, rh or both.")


def _one_hemisphere(_: Any, tokens: tuple[Token, ...]) -> str:
    if (hemi := _hemisphere(_, tokens)) == "both":
        raise BadUsage("--hemi: both can't be done at once. Run it once for lh and once for rh, in two folders.")
    return hemi


def sides(hemi: str | None) -> tuple[str, ...]:
    """The hemispheres that an option names; none if it was not given."""
    return ("lh", "rh") if hemi == "both" else (hemi,) if hemi else ()


def within(least: float, largest: float) -> Parameter:
    """Limits of a number, or of each number of a list; NaN is outside."""

    def check(_: Any, value: Any) -> None:
        for number in value if isinstance(value, list | tuple) else [] if value is None else [value]:
            if not least <= number <= largest:
                raise OutOfRange(f"must lie between {least:.10g} and {largest:.10g}, got {number:g}.")

    return Parameter(validator=check)


def _whole(_: Any, tokens: tuple[Token, ...]) -> int:
    """A whole number; cyclopts alone would round 2.5 in silence."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise BadUsage(f"{tokens[0].keyword}: {tokens[0].value!r} is not a whole number.") from None


Whole = Annotated[int, Parameter(converter=_whole)]
MaybeWhole = Annotated[int | None, Parameter(converter=_whole)]
OUT = Parameter(alias="-o")
Out = Annotated[Path, OUT, RUNNING_GROUP]
OutOrName = Annotated[Path | None, OUT, RUNNING_GROUP]
Sides = Literal["lh", "rh", "both"]
Hemispheres = Annotated[Sides | None, Parameter(converter=_hemisphere)]
BothHemispheres = Annotated[Sides, Parameter(converter=_hemisphere)]
Texts = Annotated[Sequence[str], HIDE_DEFAULT]
Length = Annotated[float | None, MEASURING_GROUP, within(1e-9, 1e9)]
Layout = Annotated[Literal["plain", "bids"], RUNNING_GROUP]
Switch = Annotated[bool, HIDE_DEFAULT]
Flag = Annotated[Switch, RUNNING_GROUP]


class Answer(NamedTuple):
    """What a command prints: ``json`` (a file, or content; not None) with --json, else the lines; and its
    exit code."""

    json: Any
    lines: Iterable[str]
    code: int = 0


@dataclass(kw_only=True)
class Options:
    """Options of every command."""

    #: "--a needs --b --c" (one of them), "--a excludes --b --c" (all of them); an argument is written in capitals
    rules: ClassVar[tuple[str, ...]] = ()
    on_interrupt = ""  # added to what is printed after Ctrl-C
    work = ""  # MODULE:FUNCTION of morphofold.cli; by default the function ``run`` of the command's module

    quiet: Annotated[Switch, Parameter(alias="-q"), RUNNING_GROUP] = False
    """Show no progress."""
    debug: Flag = False
    """Show the traceback of an error."""

    def check_rules(self, given_names: Collection[str]) -> None:
        """Raise ``OptionsClash`` if options break a rule; ``given_names`` are those in the command line."""

        def is_passed(option: str) -> bool:
            name, _, value = option.strip("-").lower().replace("-", "_").partition("=")
            return name in given_names and getattr(self, name) not in (False, ()) and value in ("", getattr(self, name))

        for option, relation, *other_options in (rule.split() for rule in self.rules if is_passed(rule.split()[0])):
            passed_options = [other for other in other_options if is_passed(other)]
            label = option.replace("=", " ")
            if relation == "excludes" and passed_options:
                raise OptionsClash(f"{label} can't be used with {', '.join(passed_options)}. Leave it out, or these.")
            if relation == "needs" and not passed_options:
                raise OptionsClash(f"{label} needs {' or '.join(other_options)}. Pass it, or leave out {label}.")


@dataclass(kw_only=True)
class Threaded(Options):
    """Options of commands that work in this process."""

    threads: Annotated[MaybeWhole, RUNNING_GROUP] = None
    """Threads (default: all cores)."""


@dataclass(kw_only=True)
class Printing(Options):
    """Options of commands that print results."""

    json: Flag = False
    """Print the results as JSON: what the command writes to summary.json, or its table."""


@dataclass(kw_only=True)
class Parcellation:
    """Which hemispheres, and which parcellation."""

    hemi: Hemispheres = None
    """Left, right or both (default: the hemispheres that are there)."""
    annot: str | None = None
    """Parcellation, label/?h.NAME.annot, such as aparc.a2009s (default: aparc, if it exists); a file with --white or
    --surface."""
    annot_from: str | None = None
    """Without that file, carry the parcellation over from a template by ?h.sphere.reg: fsaverage5, a subject in
    SUBJECTS_DIR, fsaverage of templateflow (in TEMPLATEFLOW_HOME), or the folder of another."""
    exclude: str | None = None
    """Label or map of what is left out of the cortex, such as a tumour; {subject}, {hemi} (lh) and {side} (L) in its
    name are filled in, and what has no such file is measured whole."""


@dataclass(kw_only=True)
class Measuring:
    """Options of measuring a surface."""

    curvature_scale: Length = None
    """Radius of the neighbourhoods for curvature [mm] (default: 3, more on coarse meshes; in a group, one for all)."""
    gyral_width: Length = None
    """Crown width [mm], to which the lengths of the gyral graph are proportional; set it to compare hinges of several
    meshes (default: from each surface; in a group, their median)."""
    thickness_cap: Length = None
    """Upper bound of cortical thickness [mm]; FreeSurfer's is 5 (default: none)."""
    accuracy: Annotated[Literal["draft", "standard", "fine"], MEASURING_GROUP] = "standard"
    """Mesh for thicknesses and gyral graph. draft: meshes of more than 50,000 vertices are thinned; fine: meshes of
    less than 40,000 are split; standard: the mesh as it is."""
    no_repair: Annotated[Switch, MEASURING_GROUP] = False
    """Refuse surfaces with flipped triangles, pinched edges, torn seams and similar defects (default: they are repaired
    first, and the repairs are reported)."""


@dataclass(kw_only=True)
class OnWorkers(Printing):
    """Options of commands that run many tasks on several workers."""

    on_interrupt = " Run it again to go on."
    rules: ClassVar[tuple[str, ...]] = ("--scheduler excludes --workers --memory",)
    workers: Annotated[MaybeWhole, WORKER_GROUP, within(1, math.inf)] = None
    """Processes (default: as many as cores and memory allow)."""
    threads: Annotated[Whole, WORKER_GROUP, within(1, math.inf)] = 1
    """Threads of each worker."""
    memory: Annotated[float | None, WORKER_GROUP, within(1e-6, 1e6)] = None
    """Memory of a worker [GiB]; one that takes more is stopped and starts again (default: its share of the machine)."""
    scheduler: Annotated[str | None, WORKER_GROUP] = None
    """Address of a running Dask cluster, such as tcp://host:8786."""


@dataclass(kw_only=True)
class ManyTasks(Measuring, OnWorkers):
    """Options of commands that measure many bodies on several workers."""

    no_report: Flag = False
    """No page for each subject or run; the page of them all is written."""


@dataclass(kw_only=True)
class ManySubjects(Parcellation, ManyTasks):
    """Options of cohort and bids."""

    layout: Layout = "plain"
    """Layout of the subjects; bids: the folder is a BIDS dataset."""
    participants: Path | None = None
    """Table with a row for each participant_id, whose columns (age, sex) the tables of the group repeat (default:
    participants.tsv of the input, if it exists)."""


@dataclass
class Demo(Threaded):
    """Grow a cortex, measure it and a real one, write the comparison.

    The complete work once: a folded cortex is grown, it and two real hemispheres are measured and compared. With
    --subjects, makes a folder of subjects for trying cohort, stats and overlap.

    For example:

    - `morphofold demo -o demo`
    """

    on_interrupt = " Run it again to go on."
    rules = ("--subjects excludes --scene", "--seed needs --subjects")
    _: KW_ONLY
    out: Out = Path("demo")
    """Folder to write."""
    scene: str | None = None
    """Scene to grow (default: demo)."""
    subjects: MaybeWhole = None
    """Write this number of made subjects instead, whose left cortex thins with age, for trying cohort and stats."""
    seed: MaybeWhole = None
    """Of the made subjects (default: 0)."""


@dataclass
class Simulate(Printing, Threaded):
    """Grow a scene into folds.

    Its stages are written as FreeSurfer-shaped subjects. If a run is not healthy, this is printed and recorded in
    health.json. The exit code is still 0, because its files can be looked at. --json prints health.json with the result
    of --estimate, or the forecast of --dry-run.

    For example:

    - `morphofold simulate fig5 -o fig5`
    - `morphofold simulate fig5 -o fig5 --resume`
    """

    on_interrupt = " Run it again with --resume to go on."
    rules = (
        "--restart-from excludes --dry-run --budget --error --estimate",
        "--resume excludes --dry-run --budget --error",
    )
    scene: str
    """A built-in scene (see morphofold scenes) or a TOML file."""
    _: KW_ONLY
    out: OutOrName = None
    """Folder to write (default: the scene's name)."""
    set: Texts = ()
    """Change one value of the scene, TABLE.KEY=VALUE, e.g. growth.final=1.8; may be repeated."""
    resume: Switch = False
    """Continue from the checkpoint in the folder; a finished run is left as it is."""
    restart_from: Path | None = None
    """Begin at the last stage or the checkpoint of another run with the same mesh (its folder), or at a stage
    (RUN/stages/g1.50); material, growth, effects and stages may differ."""
    dry_run: Switch = False
    """Print what the run would take: elements, steps, memory, time, errors; write nothing. Its steps are timed for a
    second or two."""
    budget: str | None = None
    """Choose the finest mesh whose run is expected to fit this time: 90s, 5min, 2h or 1d."""
    error: str | None = None
    """Choose the coarsest mesh whose expected error (of gyrification index and wavelength) is no larger: a percentage
    such as 5%, or a fraction such as 0.05."""
    estimate: Switch = False
    """Afterwards carry each stage to a coarser mesh, in a fifth of the time or more, and correct its gyrification index
    for the mesh."""


@dataclass
class Analyze(Parcellation, Measuring, Printing, Threaded):
    """Measure a subject of FreeSurfer or another program, a simulation, a pair of files, or one surface.

    Curvature, thickness, gyral thickness, gyrification and regions of one cortex, with a page to look at. Exit code 1:
    only one of two hemispheres could be measured; summary.json and the page give the reason. In the BIDS layout --json
    prints the provenance file.

    For example:

    - `morphofold analyze subjects/bert -o bert`
    - `morphofold analyze --white lh.white.surf.gii --pial lh.pial.surf.gii --hemi lh -o mine`
    - `morphofold analyze --surface ferret.stl --hemi lh -o ferret`
    """

    rules = (
        "--subject excludes INPUT --white --pial --surface",
        "INPUT excludes --white --pial --surface",
        "--surface excludes --white --pial --thickness",
        "--subjects-dir needs --subject",
        "--white needs --pial",
        "--pial needs --white",
        "--annot-from needs INPUT --subject --sphere",
        "--thickness needs --white",
        "--mask needs --white --surface",
        "--sphere needs --white --surface",
        "--layout=bids needs --out",
        "--layout=bids excludes --mgh --cifti --wide",
        "--into-subject excludes --only",
        "--into-subject needs INPUT --subject",
        "--stages needs INPUT --subject",
        "--stages excludes --hemi --annot --annot-from --exclude --json --mgh --cifti --wide --into-subject --only",
        "--layout=bids excludes --stages",
    )
    input: str | None = None
    """Folder of a subject of FreeSurfer, fMRIPrep, HCP, dHCP, CAT12 or CIVET, of a simulation or of an analysis."""
    _: KW_ONLY
    subject: Annotated[str | None, Parameter(alias="-s")] = None
    """Subject by its name in --subjects-dir, instead of INPUT."""
    subjects_dir: Annotated[str | None, Parameter(alias="--sd")] = None
    """Folder that holds the subject (default: the variable SUBJECTS_DIR)."""
    white: Path | None = None
    """White surface, with --pial instead of INPUT."""
    pial: Path | None = None
    """Pial surface, with --white instead of INPUT."""
    surface: Path | None = None
    """One surface alone, instead of INPUT: measures that need no second one, such as curvature, crests and hinges."""
    thickness: Path | None = None
    """Cortical thickness of the pair: a map [mm]."""
    mask: Path | None = None
    """Where the cortex of these files is: a label, or a map that is positive there."""
    sphere: Path | None = None
    """Their sphere that is registered to fsaverage; it shows where the cortex is if --mask is not given."""
    name: str | None = None
    """Name in the tables and on the page (default: INPUT's name)."""
    stages: Switch = False
    """Measure every stage of a simulation, each into its own folder, for compare --growth; no pages. Stages that an
    earlier run measured from the same files are kept."""
    only: Annotated[str | None, MEASURING_GROUP] = None
    """Scalars, maps and tables to measure, in the time that these need, such as gyral_thickness,n_hinges (default:
    all)."""
    no_report: Flag = False
    """Tables and maps only, no page or pictures."""
    mgh: Flag = False
    """Also write maps as MGH (FreeSurfer's own format and GIFTI are always written); plain layout."""
    cifti: Flag = False
    """Also write maps and regions of both hemispheres as CIFTI (.dscalar.nii, .pscalar.nii); plain layout."""
    wide: Flag = False
    """Also write regions_wide.tsv: one row, a column per region and measure; plain layout."""
    layout: Layout = "plain"
    """bids: the folder is a BIDS derivatives dataset; sub-NAME is added to it, or replaced in it."""
    out: OutOrName = None
    """Folder to write (default: NAME-analysis here)."""
    into_subject: Flag = False
    """Also write surf/?h.gyral_thickness, surf/?h.pial_lgi and stats/?h.aparc.gyral.stats into the FreeSurfer subject;
    files that morphofold did not write are kept."""


@dataclass
class Compare(Printing):
    """Put analyses side by side.

    One page with the same colours, bins and axes for all. --json prints comparison.json.

    For example:

    - `morphofold compare model=fig5-analysis MRI=average -o both`
    """

    analyses: list[str]
    """NAME=DIR: a name, and a folder that analyze wrote (in the BIDS layout DATASET/sub-NAME)."""
    _: KW_ONLY
    out: Out = Path("comparison")
    """Folder to write."""
    group: Texts = ()
    """GROUP=NAME,NAME: pool the hinges of these analyses, and compare them with other groups; once per group."""
    growth: Texts = ()
    """NAME=DIR: a folder that analyze --stages wrote; draw its numbers over growth; once per body."""
    colour: Texts = ()
    """NAME=RRGGBB: colour of an analysis or a group, as 0072b2; once per colour (default: one per group)."""
    spins: Whole = 500
    """Rotations of the sphere that test a cortex against the folds of the person it grew from, if both are compared."""


@dataclass
class Unfold(Printing):
    """Unfold a cortex to a smooth surface with the same vertices.

    By heat flow on its sphere: the body that it would have grown from, and where its area comes from.

    For example:

    - `morphofold unfold $SUBJECTS_DIR/bert -o bert-unfolded`
    """

    input: Path
    """Folder of a subject of FreeSurfer or another program, or a file with a closed surface."""
    _: KW_ONLY
    hemi: Hemispheres = None
    """Left, right or both (default: the hemispheres of INPUT)."""
    level: float = 0.03
    """Time of the heat flow on the unit sphere, 0.005 to 0.3; 0.02 keeps hints of the largest sulci, 0.08 only the
    shape of the hemisphere."""
    radius: float | None = None
    """Scale the smooth surface to the area of a sphere of this radius [mm] (default: as is)."""
    surface: str | None = None
    """Folded surface, surf/?h.NAME (default: white)."""
    sphere: str | None = None
    """Its sphere, surf/?h.NAME, or a file if INPUT is one (default: sphere; where there is none, one is made, which
    takes two minutes for 150,000 vertices)."""
    out: OutOrName = None
    """Folder to write (default: NAME-unfolded here)."""


@dataclass
class Cohort(ManySubjects):
    """Measure many subjects on several workers, and write tables and a page of the group.

    All subjects are measured with the same curvature scale and the same crown width. Run it again to measure subjects
    that are missing or have changed. Exit code 1: some subjects have no measures; failures.tsv gives the reasons.
    --json prints how many subjects have results, which failed, and why.

    For example:

    - `morphofold cohort $SUBJECTS_DIR -o study`
    - `morphofold cohort $SUBJECTS_DIR -o study --space fsaverage5 --smooth 10`
    """

    work = "cohort_and_bids:run"
    rules = (*ManyTasks.rules, "--smooth needs --space")
    subjects_dir: Path
    """Folder that holds the subjects."""
    _: KW_ONLY
    subjects: Path | None = None
    """Text file with one subject per line (default: all in SUBJECTS-DIR)."""
    out: Out = Path("cohort")
    """Folder to write."""
    space: str | None = None
    """Bring maps over to a template by registered spheres: fsaverage5, a subject in SUBJECTS_DIR, fsLR or fsaverage of
    templateflow (in TEMPLATEFLOW_HOME), or the folder of another."""
    smooth: float | None = None
    """With --space: smooth them on it, full width at half maximum [mm]."""


@dataclass
class OfStudy(Printing, Threaded):
    """Options of commands that compare the subjects of a study on a template."""

    work = "stats_and_overlap:run"
    study: Path
    """Folder that cohort --space wrote."""
    _: KW_ONLY
    space: str | None = None
    """Folder in STUDY/spaces (default: the only one)."""
    seed: Whole = 0
    """Of the random rotations or permutations."""
    no_report: Flag = False
    """Tables and maps only, no page or pictures."""


@dataclass
class Overlap(OfStudy):
    """Where subjects have hinges and crests, and how many they share, against chance.

    Maps are those that cohort --space wrote. Chance is what random rotations of each subject on the sphere give.

    For example:

    - `morphofold overlap study -o shared`
    """

    _: KW_ONLY
    radius: float | None = None
    """A hinge is shared if the other subject has one within this distance [mm] (default: half the crown width)."""
    density: float = 10.0
    """Smoothing of the densities [mm]."""
    hemi: BothHemispheres = "both"
    """Hemispheres."""
    rotations: Whole = 1000
    """Random rotations of each subject."""
    out: Out = Path("overlap")
    """Folder to write."""


@dataclass
class Stats(OfStudy):
    """Test a model of age, sex and so on at every vertex of a cohort's maps on a template.

    The model is linear. P values are corrected for the whole cortex by permutations: of single vertices, of clusters,
    and by threshold-free cluster enhancement.

    For example:

    - `morphofold stats study --model "gyral_thickness ~ age + sex" --contrast age -o age`
    """

    rules = ("--whole-blocks needs --blocks", "--asymmetry excludes --hemi")
    _: KW_ONLY
    model: str
    """Map and regressors, columns of the participants: 'gyral_thickness ~ age + sex'; '~ 1' is the mean."""
    contrast: Annotated[str, Parameter(allow_leading_hyphen=True)]
    """What is tested: a regressor (age), weights of columns ('group[T.b] - group[T.c]'), or 1, the intercept."""
    participants: Path | None = None
    """Table with a row for each participant_id (default: STUDY/participants.tsv, else that of cohort)."""
    blocks: str | None = None
    """Exchange subjects only within equal values of a column: site, family (default: person, if names show it)."""
    whole_blocks: Switch = False
    """Exchange blocks as wholes, for regressors that are the same within a block."""
    variance_groups: str | None = None
    """Column of groups that may differ in residual variance: Welch's t, and changes of sign."""
    hemi: BothHemispheres = "both"
    """Hemispheres."""
    asymmetry: Literal["difference", "index"] | None = None
    """Test left - right, or 2 (left - right) / (left + right), on a symmetric template."""
    permutations: Whole = 1000
    """Permutations of the subjects."""
    out: Out = Path("stats")
    """Folder to write."""


@dataclass
class Bids(ManySubjects):
    """The same as cohort for a BIDS dataset, called like a BIDS-App.

    `participant` measures reconstructed subjects of the dataset, `group` writes tables and a page of all results. The
    same as cohort --layout bids, in two steps.

    For example:

    - `morphofold bids data data/derivatives/morphofold participant --participant-label 01 02`
    - `morphofold bids data data/derivatives/morphofold group`
    """

    work = "cohort_and_bids:bids"
    bids_dir: Path
    """Dataset."""
    output_dir: Path
    """Derivatives dataset to write."""
    level: Literal["participant", "group"]
    """Step to run: participant or group."""
    _: KW_ONLY
    participant_label: Annotated[Texts, Parameter(consume_multiple=(1, None))] = ()
    """Participants, without sub- (default: all)."""
    session_label: Annotated[Texts, Parameter(consume_multiple=(1, None))] = ()
    """Sessions of them, without ses- (default: all)."""
    work_dir: Annotated[Path | None, Parameter(alias="-w")] = None
    """Accepted as by other BIDS-Apps; there are no intermediate files."""
    skip_bids_validation: Switch = False
    """Accepted as by other BIDS-Apps; the dataset is not validated in any case."""
    fs_subjects_dir: Path | None = None
    """Folder of the reconstructed subjects (default: derivatives/freesurfer or sourcedata/freesurfer in BIDS-DIR,
    BIDS-DIR itself, or the first folder with subjects in its derivatives or sourcedata)."""
    layout: Layout = field(default="bids", init=False)


@dataclass
class Sweep(ManyTasks):
    """Grow a scene with many values and seeds, and draw phase diagrams with the lines of theory.

    Every run is measured and written into tables. Run it again to do the runs that are missing or have changed. Exit
    code 1: some runs have no measures; runs.tsv gives the reasons. --json prints how many runs have results, which
    failed, and why.

    For example:

    - `morphofold sweep demo --vary cortex_thickness=2,3,4 --vary mu_ratio=1,2,4 --seeds 3 --dry-run`
    - `morphofold sweep demo --vary cortex_thickness=2,3,4 --vary mu_ratio=1,2,4 --seeds 3 -o phases`
    """

    scene: str
    """A built-in scene (see morphofold scenes) or a TOML file."""
    _: KW_ONLY
    vary: Texts = ()
    """KEY=VALUE,...: a key of the scene and its values, e.g. mu_ratio=1,2,4 or growth.final=1.6,1.8; may be
    repeated."""
    seeds: Annotated[MaybeWhole, within(1, math.inf)] = None
    """Seeds 0 to this number less 1 at every point (default: the scene's)."""
    set: Texts = ()
    """Change one value of the scene for all runs, TABLE.KEY=VALUE, e.g. accuracy.level=draft; may be repeated."""
    out: Out = Path("sweep")
    """Folder to write."""
    dry_run: Switch = False
    """Print the number of runs, and what the largest would take; write nothing."""


def _comma_separated(_: Any, tokens: tuple[Token, ...]) -> tuple[float, ...]:
    """Numbers with commas between them, each once, ascending."""
    try:
        return tuple(sorted({float(part) for part in tokens[0].value.split(",")}))
    except ValueError:
        raise BadUsage(
            f"{tokens[0].keyword}: {tokens[0].value!r} must be numbers with commas between them, such as 0.1,0.3."
        ) from None


COMMA_SEPARATED = Parameter(converter=_comma_separated, n_tokens=1)


@dataclass
class Infer(OnWorkers):
    """Which growth, different from place to place, makes a body fold like a person.

    Unfolds the person, makes growth maps from the heights of the person's folds, and grows the body with them, from
    several imperfections, beside its controls: even growth, maps turned away from the person, and the body before
    growth. The map would do; it is not how the person grew. Run it again to go on.

    For example:

    - `morphofold infer subjects/bert -o bert-inferred`
    - `morphofold infer subjects/bert --hemi rh --heterogeneity 0.1,0.15,0.2,0.3 --seeds 3 -o bert-rh`
    """

    subject: Path
    """Folder of a FreeSurfer subject with surf/?h.white, ?h.pial and ?h.sphere."""
    _: KW_ONLY
    hemi: Annotated[Literal["lh", "rh"], Parameter(converter=_one_hemisphere)] = "lh"
    """Hemisphere."""
    heterogeneity: Annotated[tuple[float, ...], COMMA_SEPARATED, HIDE_DEFAULT, within(0.02, 0.3)] = (0.1, 0.2, 0.3)
    """Standard deviations of the growth g - 1 from place to place, over its mean, with commas between them (default:
    0.1,0.2,0.3)."""
    seeds: Annotated[Whole, within(2, 100)] = 2
    """Imperfections from which each body is grown."""
    rotations: Annotated[Whole, within(1, 100)] = 2
    """Maps that are turned away from the person, at the largest heterogeneity, as controls."""
    thin_crowns: Annotated[float, within(0, 0.2)] = 0.0
    """Also vary the thickness, by this standard deviation, thinner where a gyrus is to be. It is against anatomy:
    crowns of people are thicker."""
    spins: Annotated[Whole, within(20, 1_000_000)] = 500
    """Random rotations of the person's sphere for p-values."""
    out: Out = Path("inferred")
    """Folder to write."""


MOST_RANGE_VALUES = 10_000  # in one FROM:TO:COUNT


def range_values(texts: Sequence[str], option: str = "") -> list[float]:
    """Numbers and ranges FROM:TO:COUNT in the order given, each once."""
    numbers: list[float] = []
    for text in texts:
        start_text, *end_texts = text.split(":")
        try:
            start = float(start_text)
            end, n_values = (float(end_texts[0]), int(end_texts[1])) if end_texts else (start, 2)
            if len(end_texts) > 2 or not 2 <= n_values <= MOST_RANGE_VALUES:
                raise NotReadable
        except (ValueError, IndexError):
            raise NotReadable(
                f"{option}: {text!r} is neither a number nor FROM:TO:COUNT with a COUNT from 2 to "
                f"{MOST_RANGE_VALUES:,}, such as 1:2:11."
            ) from None
        step = (end - start) / (n_values - 1)  # 1.2, not 1.2000000000000002
        numbers += [float(f"{start + i * step:.12g}") for i in range(n_values)] if end_texts else [start]
    return list(dict.fromkeys(numbers))


SEVERAL_NUMBERS = Parameter(
    consume_multiple=(1, None),
    converter=lambda _, tokens: range_values([token.value for token in tokens], tokens[0].keyword or ""),
    json_list=False,
)
# lengths beyond these limits overflow, or results lose their digits
SPHERE_LENGTH, GROWTH, RATIO = within(1e-6, 1e6), within(1e-3, 1e3), within(1e-4, 1e4)
SphereLength = Annotated[float, SPHERE_LENGTH]
Lengths = Annotated[Sequence[float], SEVERAL_NUMBERS, SPHERE_LENGTH]
Growth = Annotated[float, GROWTH]
Growths = Annotated[Sequence[float], SEVERAL_NUMBERS, GROWTH, Parameter(show_default="1:2:11")]
RadiusRatios = Annotated[Sequence[float], SEVERAL_NUMBERS, within(1 + 1e-6, 1e3), HIDE_DEFAULT]
GrowthLaw = Literal["isotropic", "tangential", "both"]


@dataclass
class Theory(Printing):
    """Radius, stress, creases and wrinkles of the growing sphere, without a simulation.

    Without options each prints what the paper draws (Razavi et al. 2015, Figs. 3 and 4). bifurcation prints what the
    paper leaves out: the growth at which the smooth sphere first wrinkles. The help names the options that take ranges.
    Lengths are in mm, but only their ratios matter.

    For example:

    - `morphofold theory radius`
    - `morphofold theory stress --plot stress.png`
    - `morphofold theory critical`
    - `morphofold theory bifurcation --thickness 1:3:5 --mu-ratio 1 2 4 --law isotropic`
    """

    work = "theory:run"
    _: KW_ONLY
    hole_ratio: Annotated[float, within(0.0, 1 - 1e-6)] = 0.5
    """A/C: radius of the fixed hole over C."""
    law: GrowthLaw = "isotropic"
    """Growth of the cortex."""
    plot: Annotated[Path | None, RUNNING_GROUP] = None
    """Also draw it: .png, .svg or .pdf."""

    @property
    def laws(self) -> tuple[str, ...]:
        return ("isotropic", "tangential") if self.law == "both" else (self.law,)


@dataclass
class Radius(Theory):
    """Outer radius of the smooth grown sphere, Eqs. (9) to (11); Fig. 3(a).

    For example:

    - `morphofold theory radius`
    """

    _: KW_ONLY
    thickness: SphereLength = 2.0
    """Thickness of the cortex, T = C - B [mm]."""
    radius: SphereLength = 50.0
    """Outer radius C [mm]."""
    growth: Growths = field(default_factory=lambda: range_values(["1:2:11"]))
    """Growth of the cortex; numbers or FROM:TO:COUNT."""
    core_growth: Growth = 1.0
    """Growth of the core; 1 is none."""

    @property
    def interface_radius(self) -> float:
        return self.radius - self.thickness


@dataclass
class Stress(Theory):
    """Radial and tangential stress through core and cortex; Fig. 3(b).

    For example:

    - `morphofold theory stress --plot stress.png`
    """

    _: KW_ONLY
    thickness: Lengths = field(default_factory=lambda: [1.0, 2.0, 3.0])
    """Thickness of the cortex, T = C - B [mm]; numbers or FROM:TO:COUNT."""
    radius: SphereLength = 50.0
    """Outer radius C [mm]."""
    growth: Growth = 2.0
    """Growth of the cortex."""
    mu_ratio: Annotated[float, RATIO] = 1.0
    """Shear modulus, cortex over core."""
    points: Annotated[Whole, within(2, 10_000)] = 11
    """Points per layer."""
    core_growth: Growth = 1.0
    """Growth of the core; 1 is none."""


@dataclass
class Critical(Theory):
    """Growth at which creases can form, Eqs. (12) and (13), and Biot's limit; Fig. 4.

    For example:

    - `morphofold theory critical`
    """

    rules = ("--ratio excludes --thickness", "--radius needs --thickness")
    _: KW_ONLY
    law: GrowthLaw = "both"
    """Growth of the cortex."""
    ratio: RadiusRatios = ()
    """C/B: outer radius / interface radius; numbers or FROM:TO:COUNT (default: 1.02:1.3:15)."""
    thickness: Annotated[Lengths, HIDE_DEFAULT] = ()
    """Of the cortex [mm], instead of --ratio; numbers or FROM:TO:COUNT."""
    radius: Annotated[float | None, SPHERE_LENGTH] = None
    """Outer radius C [mm], with --thickness (default: 50)."""
    core_growth: Growth = 1.0
    """Growth of the core; 1 is none."""


@dataclass
class Bifurcation(Theory):
    """Growth at which the smooth sphere first wrinkles, and its wrinkles; with the crease criterion.

    The cortex grows by the stretch g (a ratio of lengths, 1 is none): in all directions if isotropic, along the surface
    alone if tangential. Wrinkles are waves all over the sphere, spherical harmonics of degree l: about l around it,
    each 2 pi C / sqrt(l (l + 1)) long. A crease is a sharp fold of the surface alone; it can form once
    lambda_r/lambda_theta of the smooth surface is 2.4, the paper's criterion. The mu ratio is the cortex's shear
    modulus over the core's. The defaults are the paper's sphere: C = 50, A/C = 0.5, T = 1, 2 and 3, incompressible.
    With --body it prints the growth at which the meshed body of a scene loses its stability, from the exact stiffness
    of that mesh. If the scene is a sphere or a part of one, theory is printed too. The effects of the scene are left
    out.

    For example:

    - `morphofold theory bifurcation --thickness 1:3:5 --mu-ratio 1 2 4 --law isotropic`
    """

    rules = (
        "--set needs --body",
        "--body excludes --thickness --radius --hole-ratio --mu-ratio --kappa-ratio --law --curve --plot",
    )
    _: KW_ONLY
    law: GrowthLaw = "both"
    """Growth of the cortex."""
    thickness: Lengths = field(default_factory=lambda: [1.0, 2.0, 3.0])
    """Thickness of the cortex, T = C - B [mm]; numbers or FROM:TO:COUNT."""
    radius: SphereLength = 50.0
    """Outer radius C [mm]."""
    mu_ratio: Annotated[Sequence[float], SEVERAL_NUMBERS, RATIO] = field(default_factory=lambda: [1.0, 2.0, 4.0])
    """Shear modulus, cortex over core; numbers or FROM:TO:COUNT."""
    kappa_ratio: Annotated[float, within(1.0, math.inf)] = math.inf
    """Bulk over shear modulus; inf is incompressible."""
    curve: Switch = False
    """Critical growth of each degree, not only the least."""
    body: str | None = None
    """A built-in scene or a TOML file, instead of the options above."""
    set: Texts = ()
    """With --body: change one value of the scene, TABLE.KEY=VALUE; may be repeated."""


#: figure -> what it shows
FIGURES = {
    "fig3": "outer radius against growth, tangential stress through the cortex (theory and finite elements)",
    "fig4": "growth at which creases can form (theory)",
    "fig5": "a sphere folding, six stages (simulation)",
    "fig6": "thin, normal and thick cortex, three stages (simulations)",
    "fig7": "shear moduli 1, 2 and 4 to 1, three stages (simulations)",
    "fig8": "gyral against cortical thickness of brains and models (MRI, simulations)",
    "fig9": "three-hinge patterns of models and of a person (MRI, simulations)",
    "fig8-grown": "Fig. 8 by experiment: hemispheres with an even cortex and with their own thickness (20 simulations)",
}
NOT_IN_ALL = ("fig8-grown",)  # it takes an hour
FIGURES_HELP = "; ".join([*map(": ".join, FIGURES.items()), f"or all, which leaves out {', '.join(NOT_IN_ALL)}."])


@dataclass
class Reproduce(Printing, Threaded):
    """Reproduce figures of the paper (Razavi et al. 2015), each with the table of its points, and an index of them all.

    For example:

    - `morphofold reproduce fig3 fig4 -o theory`
    - `morphofold reproduce all -o reproduce --draft`
    """

    on_interrupt = " Run it again to go on."
    figures: Annotated[list[str], Parameter(help=FIGURES_HELP)]
    _: KW_ONLY
    out: Out = Path("reproduce")
    """Folder to write; figures and simulations of an earlier run there are kept."""
    draft: Switch = False
    """Octants on coarser meshes, tables of the growths that are drawn: three minutes on two cores."""
    subject: Annotated[Sequence[Path], HIDE_DEFAULT] = ()
    """A FreeSurfer subject whose hemispheres are grown for fig8-grown instead of fsaverage5's; may be repeated."""


@dataclass
class Scenes(Printing):
    """List the built-in scenes and the effects that each uses, or print one as TOML with all its values.

    For example:

    - `morphofold scenes`
    - `morphofold scenes fig5`
    """

    scene: str | None = None
    """Print this one: a built-in scene or a TOML file."""
