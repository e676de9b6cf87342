"""The study of accuracy: its cases are done one by one and kept, so that an interrupted study can continue."""

import hashlib
import os
import platform
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from morphofold import __version__
from morphofold.digests_and_json import strict_json
from morphofold.errors import DamagedFile
from morphofold.io.json_files import Number, Record, read_json, write_json
from morphofold.progress_callbacks import Progress, part_of
from morphofold.studies.accuracy.error_points import RERUN_ADVICE, Case, Point
from morphofold.studies.accuracy.solver_settings import FINEST_SETTING, MESH_AND_PACE, NESTED, Setting, axes

HALVES = ("measuring", "solver")
TIME_SHARES = {"measuring": 1.0, "solver": 3.0}  # approximate shares of the time of the whole study
PEER_NAMES = ("libigl", "pyvista", "trimesh", "lapy")  # packages that are used if installed
#: modules of this package that no case runs
READER_MODULES = ("accuracy_page", "accuracy_plots", "accuracy_report", "accuracy_study", "accuracy_tables", "fronts")
FOLD_AXES = ("contact", NESTED)  # they differ once there are folds
COMPARE_SHARE = 0.03  # share of the time of the solver half that distances between surfaces take


def circumstances() -> dict[str, Any]:
    """Everything that errors and times depend on: the machine, the threads in use, versions, and the studied code."""
    import numba

    return {
        "morphofold": __version__,
        "code": _digest_of_code(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": numba.get_num_threads(),
        "system": platform.system(),
        "python": platform.python_version(),
        **{name: _version_if_installed(name) for name in ("numpy", "scipy", "numba", "scikit-fem", *PEER_NAMES)},
    }


def _version_if_installed(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _digest_of_code() -> str:
    """Digest of the packages that cases run, and of top-level modules; modules that only read points are left out."""
    import morphofold.analysis
    import morphofold.io
    import morphofold.shapes
    import morphofold.sim
    import morphofold.studies.accuracy

    library = Path(str(morphofold.__file__)).parent
    files = [
        *library.glob("*.py"),
        *(library / name for name in ("forecasts/richardson.py", "studies/onset.py", "studies/speed/solver_speed.py")),
    ]
    for package in (morphofold.analysis, morphofold.io, morphofold.shapes, morphofold.sim):
        files += Path(str(package.__file__)).parent.rglob("*.py")
    study_folder = Path(str(morphofold.studies.accuracy.__file__)).parent
    files += (file for file in study_folder.rglob("*.py") if file.stem not in READER_MODULES)
    digest = hashlib.sha256()
    for file in sorted(files, key=lambda file: file.as_posix()):
        digest.update(f"{file.parent.name}/{file.name}\n".encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def _processor() -> str:
    """Model of the processor, as the system names it."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


class _Points(Record):
    """A finished case."""

    points: list[dict[str, str | Number | None]]


class Cases:
    """Finished cases, in one folder for each set of circumstances: times under other circumstances don't count."""

    def __init__(self, folder: Path, environment: dict[str, Any]):
        self.folder = folder / hashlib.sha256(strict_json(environment).encode()).hexdigest()[:12]
        self.folder.mkdir(parents=True, exist_ok=True)

    def points(self, case: Case) -> list[Point]:
        """The points of a case, which is done now unless it was done before."""
        file = self.folder / f"{case.name}.json"
        if not file.exists():
            rows = [point.as_row() for point in case.compute()]
            write_json(file, {"points": rows})
        rows = read_json(file, _Points, RERUN_ADVICE)["points"]
        try:
            return [Point.from_row(row) for row in rows]
        except ValueError as error:
            raise DamagedFile(f"{file}: {error}. {RERUN_ADVICE}") from None


def all_points(halves: Sequence[str], cases: Cases, show: Progress) -> list[Point]:
    """All points of the study, in the order of its cases."""
    run_by_half = {"measuring": _measuring, "solver": _solver}
    points: list[Point] = []
    share_done, total_share = 0.0, sum(TIME_SHARES[half] for half in halves)
    for half in HALVES:
        if half in halves:
            points += run_by_half[half](cases, part_of(show, share_done / total_share, TIME_SHARES[half] / total_share))
            share_done += TIME_SHARES[half]
    return points


def _measuring(cases: Cases, show: Progress) -> Iterator[Point]:
    all_cases = measuring_cases()
    for case_index, case in enumerate(all_cases):
        show(case_index / len(all_cases), case.name)
        yield from cases.points(case)


def measuring_cases() -> list[Case]:
    """All cases of the analysis half of the study."""
    from morphofold.studies.accuracy import known_fold_errors, measuring_errors, measuring_person

    return [*measuring_errors.cases(), *known_fold_errors.cases(), *measuring_person.cases()]


def _solver(cases: Cases, show: Progress) -> Iterator[Point]:
    from morphofold.studies.accuracy.assembly import CELL_COUNTS, assembly_points
    from morphofold.studies.accuracy.errors_from_theory import (
        INCOMPRESSIBLE,
        onset_points,
        smooth_points,
        theory_points,
    )
    from morphofold.studies.accuracy.folds_by_mesh import fold_points, pairs, simulated_folds

    yield from cases.points(Case("theory", theory_points))
    for n_cells in CELL_COUNTS:
        show(0.0, f"forces, {n_cells} cells")
        yield from cases.points(Case(f"forces-{n_cells}", partial(assembly_points, n_cells)))
    settings = [setting for settings_on_axis in axes().values() for setting in settings_on_axis]
    folding_settings = [setting for setting in settings if setting.axis != MESH_AND_PACE]
    names_to_fold = {setting.name for setting in (*folding_settings, FINEST_SETTING)}
    smooth_names = {setting.name for setting in settings if setting.axis not in FOLD_AXES}
    settings_by_name = {setting.name: setting for setting in (*settings, FINEST_SETTING)}
    costs = {name: _cost(setting) for name, setting in settings_by_name.items()}
    cost_done, total_cost = 0.0, sum(costs.values())
    folds_by_name = {}
    run_points: dict[str, list[Point]] = {}
    for name, setting in sorted(settings_by_name.items(), key=lambda name_setting: costs[name_setting[0]]):
        show_part = lambda share, text: show((1 - COMPARE_SHARE) * (cost_done + share * costs[name]) / total_cost, text)  # noqa: B023
        if name in smooth_names:
            show_part(0.0, f"{setting.label}, smooth")
            run_points[name] = cases.points(Case(f"smooth-{name}", partial(smooth_points, setting)))
            run_points[name] += cases.points(Case(f"onset-{name}", partial(onset_points, setting)))
        if name in names_to_fold:
            folds_by_name[name] = simulated_folds(setting, cases.folder / f"folds-{name}.npz", show_part)
        cost_done += costs[name]
    for setting in (setting for setting in settings if setting.axis not in FOLD_AXES):
        yield from _of(
            setting, [p for p in run_points[setting.name] if p.against != INCOMPRESSIBLE or setting.axis == "kappa"]
        )
    setting_pairs = pairs(folding_settings)
    for pair_index, (setting, reference, against) in enumerate(setting_pairs):
        show(1 - COMPARE_SHARE * (1 - pair_index / len(setting_pairs)), "comparing folds")
        compute = partial(fold_points, setting, folds_by_name[setting.name], folds_by_name[reference.name], against)
        yield from _of(setting, cases.points(Case(f"folds-{setting.name}-against-{reference.name}", compute)))


def _of(setting: Setting, points: Iterable[Point]) -> Iterator[Point]:
    """Points of a run that belongs to several axes, as points of this axis."""
    return (replace(point, axis=setting.axis, setting=setting.label, value=setting.value) for point in points)


def _cost(setting: Setting) -> float:
    """Approximate time of a setting, in any unit: elements times steps."""
    return setting.edge**-3 * (setting.through + 8) * (setting.kappa_ratio / 50) ** 0.5 / setting.rate
