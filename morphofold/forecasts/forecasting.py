"""Cost and errors of a run before it begins: a scene in, a ``Forecast`` out.

Some steps of the scene, or of a part of its body, are timed on this machine and scaled to the whole run.
"""

import math
import timeit
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from numba import set_num_threads

from morphofold.forecasts import sizes as sizing
from morphofold.forecasts.cost_record import COSTS, TABLE, Errors, Expected, called, errors_of_run, headline, largest
from morphofold.number_texts import percent, span
from morphofold.progress_callbacks import logged
from morphofold.shapes import icosphere
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import STEPS_PER_MEASUREMENT, Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.equilibrium.wrinkle_onset import first_wrinkles
from morphofold.sim.radial_run import ICOSPHERE_LEVEL, RadialRun
from morphofold.sim.scene import LEVELS, Scene
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.sphere_theory.smooth_sphere import smooth_state
from morphofold.sim.stage_checks import BOUNDS, check_surface
from morphofold.simulation import freesurfer_maps
from morphofold.surface import Cortex
from morphofold.threads import using_threads
from morphofold.timing import working_seconds

#: phases of a run that the solver's clock does not have: checks, maps and files of its stages, and building its body
STAGES_PHASE, SETTING_UP_PHASE = "stages", "set-up"
LEAST_TIME_RATIO = 0.1  # least time of the range, over the expected time
#: most bricks (as a scene counts them) of a body that is built and timed; larger bodies are scaled
MOST_TIMED_BRICKS = 330_000
TIMING_SECONDS = 0.8  # time for which steps are taken
LEAST_BLOCKS, MOST_BLOCKS = 3, 60  # of steps, at least and at most
GROWTH_PER_BLOCK = 1e-6  # growth in each block
BUSY_MACHINE_RATIO = 1.5  # slower over fastest block: beyond it a machine is called busy
PORTIONS = ("full", "half", "quarter", "octant")


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """Forecast of a run.

    Attributes
    ----------
    scene, shape, setting : str
        Its name and shape, and its accuracy in words: ``"standard"``, or the levels between which its edge lies.
    edge_mm, edge_over_T : float or None
        Largest surface edge [mm], and over the thickness of the (thinnest) cortex; None in one dimension.
    cells_per_wave : float or None
        Length of the first wrinkles by theory over that edge; None if theory has none.
    elements_through_cortex : int or None
        None in one dimension, and for a mesh from a file.
    elements, nodes, steps, stages : int
    fewest_steps, most_steps : int
    seconds, fastest, slowest : float
        Wall time without compiling, and its plausible range [s].
    seconds_by_phase : mapping
        As in health.json, with ``"set-up"`` and ``"stages"``.
    memory_GiB : float
        Maximum of the whole process.
    threads : int
    errors : mapping
        Quantity to its ``Expected`` relative error; empty in one dimension, and for a scene that was not studied.
    not_studied : tuple of str
        Properties of the scene that were not studied (:func:`morphofold.forecasts.cost_record.not_studied`).
    how : mapping
        How each of these was obtained, in words.
    doubts : tuple of str
        Why the forecast may be wrong, one sentence each.
    """

    scene: str
    shape: str
    setting: str
    edge_mm: float | None = None
    edge_over_T: float | None = None
    cells_per_wave: float | None = None
    elements_through_cortex: int | None = None
    elements: int = 0
    nodes: int = 0
    steps: int = 0
    fewest_steps: int = 0
    most_steps: int = 0
    stages: int
    seconds: float
    fastest: float
    slowest: float
    seconds_by_phase: Mapping[str, float]
    memory_GiB: float
    threads: int
    errors: Mapping[str, Expected]
    not_studied: tuple[str, ...] = ()
    how: Mapping[str, str]
    doubts: tuple[str, ...] = ()

    def __repr__(self) -> str:
        size_text = f"{self.elements:,} elements, {self.steps:,} steps"
        price_text = f"{span(self.seconds)}, {self.memory_GiB:.2g} GiB on {self.threads} threads"
        return f"Forecast({self.scene!r}, {self.setting}: {size_text}, {price_text})"

    @property
    def headline(self) -> tuple[str, Expected] | None:
        """The quantity of ``HEADLINE_QUANTITIES`` with the largest error, and that error."""
        return headline(self.errors) if self.errors else None

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)


def table_of(forecast: Forecast) -> str:
    """A forecast as a short table for the terminal."""
    cells = {"setting": forecast.setting}
    if forecast.edge_over_T is not None:
        wave_text = f", {forecast.cells_per_wave:.0f} cells per wave" if forecast.cells_per_wave else ""
        cells["setting"] += f", edge {forecast.edge_mm:.3g} mm ({forecast.edge_over_T:.2f} T{wave_text})"
        if forecast.elements_through_cortex:
            cells["setting"] += f", {forecast.elements_through_cortex} elements through the cortex"
        cells["elements"], cells["nodes"] = f"{forecast.elements:,}", f"{forecast.nodes:,}"
        cells["steps"] = f"{forecast.steps:,}  ({forecast.fewest_steps:,} to {forecast.most_steps:,})"
    cells["memory"] = f"{forecast.memory_GiB:.2g} GiB"
    times = f"{span(forecast.seconds)}  ({span(forecast.fastest)} to {span(forecast.slowest)})"
    cells["time"] = f"{times} with {forecast.threads} thread{'s' if forecast.threads > 1 else ''}"
    cells[""] = largest(forecast.seconds_by_phase, forecast.seconds, 4)
    for name, e in forecast.errors.items():
        other_text = f", other settings {percent(e.other)}" if e.other else ""
        cells[f"error of {called(name)}"] = f"{percent(e.error)}  ({percent(e.low)} to {percent(e.high)}){other_text}"
    width = max(map(len, cells))
    lines = [f"{forecast.scene}: forecast", *(f"  {label:{width}}  {value}" for label, value in cells.items())]
    return "\n".join([*lines, *(f"{quantity}: {text}" for quantity, text in forecast.how.items()), *forecast.doubts])


def forecast(source: str | Path | Scene, threads: int | None = None, *, settings: Iterable[str] = ()) -> Forecast:
    """Forecast of a run: its size, time on this machine, memory and errors. Takes a few seconds, writes nothing.

    Parameters
    ----------
    source : str, Path or Scene
        A built-in scene's name, a TOML file, or a scene.
    threads : int, optional
        Threads of the run; by default all cores.
    settings : iterable of str
        Changes of the scene, such as ``"growth.final=1.8"``.

    Returns
    -------
    Forecast

    Raises
    ------
    ValueError, FileNotFoundError
        If the scene cannot be read, or its body cannot be built.
    """
    scene = load_scene(source, settings)
    if scene.geometry.shape == "radial":
        return _radial_forecast(scene, threads)
    return forecast_from(scene, calibrate(scene, threads))


def _radial_forecast(scene: Scene, threads: int | None) -> Forecast:
    """Forecast of a run in one dimension: its final stage is solved, in milliseconds."""
    no_folder: Any = None

    def solve() -> None:
        smooth_state.cache_clear()
        run.grow_to(scene.growth.final)

    with using_threads(threads) as threads:
        run = RadialRun(scene, no_folder, logged, lambda: False)
        solving_seconds = len(scene.stages) * least_seconds(solve)
        slowness = slowness_of_stages()
    vertices, costs = 10 * 4**ICOSPHERE_LEVEL + 2, COSTS["stage"]
    writing_seconds = slowness * len(scene.stages) * (costs["per_vertex"] + costs["write_per_vertex"]) * vertices
    seconds = solving_seconds + writing_seconds
    return Forecast(
        scene=scene.name,
        shape="radial",
        setting="one dimension",
        stages=len(scene.stages),
        seconds=seconds,
        fastest=0.5 * seconds,
        slowest=2 * seconds,
        seconds_by_phase={"radial": solving_seconds, STAGES_PHASE: writing_seconds, SETTING_UP_PHASE: 0.0},
        memory_GiB=sizing.memory_of_run(scene, sizing.Sizes(0, 0, vertices, 0.0)),
        threads=threads,
        errors={},
        how={
            "time": "the final stage was solved",
            "memory": "measured in other runs",
            "errors": "equilibria to about a part in 1e8; there is no mesh",
        },
    )


class Calibration(NamedTuple):
    """Result of the timing.

    Attributes
    ----------
    scene : Scene
        The scene that was built: the scene itself, a smaller part of it, or a coarser one.
    sizes : Sizes
    layers : Layers
        Only bodies of bricks, which may be scaled, have them.
    crossing, steps_per_unit : float
        Steps in which a wave crosses the cortex, and steps in which growth rises by 1 at full pace; both over
        :func:`morphofold.forecasts.sizes.relative_crossing`.
    phases : mapping
        Seconds per step by phase.
    fastest, slowest : float
        Time of the fastest block of steps, and of the slower quarter, over the time in ``phases``.
    setting_up : float
        Seconds to build the body.
    slowness : float
        Time of the checks and maps of a sphere, over the time on the machine of the table.
    threads : int
    """

    scene: Scene
    sizes: sizing.Sizes
    layers: sizing.Layers
    crossing: float
    steps_per_unit: float
    phases: Mapping[str, float]
    fastest: float
    slowest: float
    setting_up: float
    slowness: float
    threads: int


def forecast_from(scene: Scene, timing: Calibration) -> Forecast:
    """Forecast of ``scene`` from a timing of itself, or scaled from another accuracy or portion of it."""
    sizes = timing.sizes if scene == timing.scene else sizing.sizes_by_rule(scene, timing.layers)
    relative_crossing = sizing.relative_crossing(scene, sizes.edge)
    steps = sizing.steps_of(scene, timing.crossing * relative_crossing, timing.steps_per_unit * relative_crossing)
    phase_seconds = _seconds_by_phase(scene, sizes, steps, timing)
    seconds, n_steps = sum(phase_seconds.values()), max(steps.expected, 1)
    fewer_share, further_share = (steps.expected - steps.fewest) / n_steps, (steps.most - steps.expected) / n_steps
    time_spread, edge_over_T = COSTS["spread"]["time"], sizes.edge / scene.thinnest
    expected_errors, wavelength_over_T = errors_of_run(scene, edge_over_T), first_wrinkles(scene).wavelength_over_T
    cells_per_wave = wavelength_over_T / edge_over_T if wavelength_over_T > 0 else None
    return Forecast(
        scene=scene.name,
        shape=scene.geometry.shape,
        setting=_accuracy_words(scene, edge_over_T),
        edge_mm=sizes.edge,
        edge_over_T=edge_over_T,
        cells_per_wave=cells_per_wave,
        elements_through_cortex=None if scene.geometry.shape == "mesh" else scene.elements_through_cortex,
        elements=sizes.elements,
        nodes=sizes.nodes,
        steps=steps.expected,
        fewest_steps=steps.fewest,
        most_steps=steps.most,
        stages=len(scene.stages),
        seconds=seconds,
        fastest=seconds * max(LEAST_TIME_RATIO, 1 - math.hypot(time_spread, fewer_share, 1 - timing.fastest)),
        slowest=seconds * (1 + math.hypot(time_spread, further_share, timing.slowest - 1)),
        seconds_by_phase=phase_seconds,
        memory_GiB=sizing.memory_of_run(scene, sizes),
        threads=timing.threads,
        errors=expected_errors.errors,
        not_studied=expected_errors.not_studied,
        how=_sources_of_forecast(scene, timing, expected_errors),
        doubts=(
            *expected_errors.doubts,
            *_doubts_of_mesh(scene, edge_over_T, cells_per_wave),
            *_doubts_of_time(scene, timing),
        ),
    )


def _seconds_by_phase(scene: Scene, sizes: sizing.Sizes, steps: sizing.Steps, timing: Calibration) -> dict[str, float]:
    """Seconds of the run by phase: time of a step times steps, active contact, and work outside of steps."""
    n_mean = float(sizes.elements)
    if not scene.not_nested:
        n_mean = steps.fine * n_mean + (1 - steps.fine) * sizing.coarse_elements(scene, sizes)
    size_ratio, n_steps = sizes.elements / timing.sizes.elements, steps.expected * n_mean / timing.sizes.elements
    phase_seconds = {name: step_seconds * n_steps for name, step_seconds in timing.phases.items()}
    if "grow" in phase_seconds:
        phase_seconds["grow"] *= steps.growing
    if "contact" in phase_seconds:
        phase_seconds["contact"] += steps.touching * sum(phase_seconds.values())
    stage_costs = COSTS["stage"]
    surface_seconds = stage_costs["checks"] + stage_costs["folded"] * stage_costs["per_vertex"] * sizes.vertices
    writing_seconds = stage_costs["write_per_vertex"] * sizes.vertices
    writing_seconds += stage_costs["write_per_element"] * sizes.elements if scene.output.volume else 0.0
    phase_seconds[STAGES_PHASE] = len(scene.stages) * timing.slowness * (surface_seconds + writing_seconds)
    phase_seconds[SETTING_UP_PHASE] = timing.setting_up * size_ratio + timing.slowness * stage_costs["starting"]
    return phase_seconds


def _doubts_of_mesh(scene: Scene, edge_over_T: float, cells_per_wave: float | None) -> list[str]:
    """Whether folds on this mesh would not be healthy; none for tetrahedra and for smooth bodies, as in a run."""
    if scene.geometry.shape == "mesh" or not scene.growth.final > first_wrinkles(scene).growth:
        return []
    sizes = {"cell_over_T": edge_over_T, "cell_over_wave": 1 / cells_per_wave if cells_per_wave else 0.0}
    return [
        f"{name} is {size:.2g}: with more than {BOUNDS[name][0]:g} folds are not healthy. Refine the mesh."
        for name, size in sizes.items()
        if size > BOUNDS[name][0]
    ]


def _doubts_of_time(scene: Scene, timing: Calibration) -> list[str]:
    ratio = timing.slowest / timing.fastest
    mass_text = "With real masses the step shrinks as elements are squeezed; by how much was seen in one run only."
    count_text = "Counting the unstable modes of the stages takes further time and memory (output.stability)."
    busy_text = f"Some steps just took up to {ratio:.1f} times as long as others: this machine has other work to do."
    doubts = {mass_text: scene.real_time, count_text: scene.output.stability, busy_text: ratio > BUSY_MACHINE_RATIO}
    return [doubt for doubt, applies in doubts.items() if applies]


def _sources_of_forecast(scene: Scene, timing: Calibration, run_errors: Errors) -> dict[str, str]:
    size_source = "the body was built and counted"
    if scene != timing.scene:
        portion_word = getattr(timing.scene.geometry, "portion", "")
        portion_word = f"{portion_word} " if portion_word != getattr(scene.geometry, "portion", "") else ""
        size_source = f"counted by rule; a {portion_word}body of {timing.sizes.elements:,} elements was built and timed"
    threads_text = "one thread" if timing.threads == 1 else f"{timing.threads} threads"
    errors_source = f"a table of errors against edges: {TABLE['errors']['subject']}"
    return {
        "elements": size_source,
        "steps": "the pace of growth, and how long runs with such growth and stiffness waited for equilibrium",
        "time": f"steps timed here with {threads_text}, and the checks and maps of a sphere",
        "memory": "bytes per element and vertex, measured in other runs",
        "errors": run_errors.how if run_errors.not_studied else errors_source,
    }


def _accuracy_words(scene: Scene, edge_over_T: float) -> str:
    """The accuracy of a scene in words: its level, or the levels between which its edge lies, coarser first."""
    if scene.geometry.shape == "mesh":
        return "the mesh of the file"
    if scene.accuracy.edge is None:
        return scene.accuracy.level
    edges_on_one_mesh = {name: level_edge for name, level_edge in LEVELS.items() if name != "fine"}
    coarse_names = [name for name, level_edge in edges_on_one_mesh.items() if level_edge >= edge_over_T]
    finer_names = [name for name, level_edge in edges_on_one_mesh.items() if level_edge <= edge_over_T]
    if not coarse_names or not finer_names:
        return f"finer than {coarse_names[-1]}" if coarse_names else f"coarser than {finer_names[0]}"
    return finer_names[0] if coarse_names[-1] == finer_names[0] else f"between {coarse_names[-1]} and {finer_names[0]}"


# timing ------------------------------------------------------------------------------------------------------------


def calibrate(scene: Scene, threads: int | None = None) -> Calibration:
    """Build the scene's body, or a smaller one like it, and time a few steps and a stage.

    Raises
    ------
    ValueError
        If the body cannot be built, or the number of threads is invalid.
    """
    with using_threads(threads):
        test_scene = reduced(scene)
        start_time = working_seconds()
        effects = build_effects(test_scene)
        body = build_body(test_scene, effects)
        run = Dynamics.of(test_scene, body, effects)
        setting_up = working_seconds() - start_time
        timings, slowness = _time_steps(run), slowness_of_stages()
    sizes, layers = sizing.sizes_of(body.bilayer), sizing.layers_of(body.bilayer)
    relative_crossing = sizing.relative_crossing(test_scene, sizes.edge)
    crossing, steps_per_unit = body.crossing / relative_crossing, 1 / run.rate / relative_crossing
    return Calibration(test_scene, sizes, layers, crossing, steps_per_unit, *timings, setting_up, slowness, run.threads)


def reduced(scene: Scene) -> Scene:
    """The scene, or a smaller part of its body, or else a coarser scene, with at most ``MOST_TIMED_BRICKS`` bricks."""
    while scene.bricks > MOST_TIMED_BRICKS:
        portion = getattr(scene.geometry, "portion", None)
        if portion in PORTIONS[:-1]:
            setting = f"geometry.portion={PORTIONS[PORTIONS.index(portion) + 1]}"
        else:
            setting = f"accuracy.edge={1.1 * scene.edge:.6g}"
        scene = load_scene(scene, [setting])
    return scene


def _time_steps(run: Dynamics) -> tuple[dict[str, float], float, float]:
    """Seconds per step by phase, and the times of the fastest block of steps and of the slower quarter over them.

    Seconds are those of the block than which a third are faster, because other work of the machine in that second will
    not last for the whole run.
    """

    def block() -> dict[str, float]:
        run.seconds.clear()
        run.grow_to(run.state.growth + GROWTH_PER_BLOCK)
        return {name: seconds / STEPS_PER_MEASUREMENT for name, seconds in run.seconds.items()}

    block()  # loads kernels, fills caches
    start_time, blocks = working_seconds(), [block()]
    while len(blocks) < LEAST_BLOCKS or (working_seconds() - start_time < TIMING_SECONDS and len(blocks) < MOST_BLOCKS):
        blocks.append(block())
    blocks.sort(key=lambda phases: sum(phases.values()))
    totals = [sum(phases.values()) for phases in blocks]
    typical_index, slower_index = len(blocks) // 3, 3 * len(blocks) // 4
    return blocks[typical_index], totals[0] / totals[typical_index], totals[slower_index] / totals[typical_index]


def slowness_of_stages() -> float:
    """Time of the checks and maps of a small cortex here, over the time on the machine of the table.

    One thread is used: if the machine has other work, two threads wait for each other, and times vary.
    """
    verts, faces = icosphere(4)
    cortex = Cortex.from_arrays(46 * verts, 50 * verts, faces, origin="simulation")
    set_num_threads(1)
    seconds = least_seconds(lambda: (check_surface(cortex.pial), freesurfer_maps(cortex)))
    return seconds / COSTS["stage"]["sphere"]


def least_seconds(work: Callable[[], object]) -> float:
    """Time of work, the least of three times, without compiling [s]."""
    return min(timeit.repeat(work, timer=working_seconds, repeat=3, number=1))
