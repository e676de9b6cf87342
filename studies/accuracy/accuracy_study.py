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
from morphofold.studies.accuracy.error_points import ANEW, Case, Point
from morphofold.studies.accuracy.solver_settings import FINEST, PACED, Setting, axes

HALVES = ("measuring", "solver")
SHARES = {"measuring": 1.0, "solver": 3.0}  # approximate shares of the time of the whole study
PEERS = ("libigl", "pyvista", "trimesh", "lapy")  # packages that are used if installed
#: modules of this package that no case runs
READERS = ("accuracy_page", "accuracy_plots", "accuracy_report", "accuracy_study", "accuracy_tables", "fronts")
COMPARING = 0.03  # share of the time of the solver half that distances between surfaces take


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
        **{package: _version_if_installed(package) for package in ("numpy", "scipy", "numba", "scikit-fem", *PEERS)},
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

    package_root = Path(str(morphofold.__file__)).parent
    files = [
        *package_root.glob("*.py"),
        *(
            package_root / name
            for name in ("forecasts/richardson.py", "studies/onset.py", "studies/speed/solver_speed.py")
        ),
    ]
    for package in (morphofold.analysis, morphofold.io, morphofold.shapes, morphofold.sim):
        files += Path(str(package.__file__)).parent.rglob("*.py")
    study_folder = Path(str(morphofold.studies.accuracy.__file__)).parent
    files += (file for file in study_folder.rglob("*.py") if file.stem not in READERS)
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

    def __init__(self, folder: Path, made: dict[str, Any]):
        self.folder = folder / hashlib.sha256(strict_json(made).encode()).hexdigest()[:12]
        self.folder.mkdir(parents=True, exist_ok=True)

    def points(self, case: Case) -> list[Point]:
        """The points of a case, which is done now unless it was done before."""
        file = self.folder / f"{case.name}.json"
        if not file.exists():
            rows = [point.as_row() for point in case.work()]
            write_json(file, {"points": rows})
        rows = read_json(file, _Points, ANEW)["points"]
        try:
            return [Point.from_row(row) for row in rows]
        except ValueError as error:
            raise DamagedFile(f"{file}: {error}. {ANEW}") from None


def all_points(halves: Sequence[str], cases: Cases, show: Progress) -> list[Point]:
    """All points of the study, in the order of its cases."""
    points_of_half = {"measuring": _measuring, "solver": _solver}
    points: list[Point] = []
    time_done, total_time = 0.0, sum(SHARES[half] for half in halves)
    for half in HALVES:
        if half in halves:
            points += points_of_half[half](cases, part_of(show, time_done / total_time, SHARES[half] / total_time))
            time_done += SHARES[half]
    return points


def _measuring(cases: Cases, show: Progress) -> Iterator[Point]:
    all_cases = measuring_cases()
    for k, case in enumerate(all_cases):
        show(k / len(all_cases), case.name)
        yield from cases.points(case)


def measuring_cases() -> list[Case]:
    """All cases of the analysis half of the study."""
    from morphofold.studies.accuracy import accuracy_measuring, known_fold_errors, measuring_person

    return [*accuracy_measuring.cases(), *known_fold_errors.cases(), *measuring_person.cases()]


def _solver(cases: Cases, show: Progress) -> Iterator[Point]:
    from morphofold.studies.accuracy.assembly import SIZES, assembly_points
    from morphofold.studies.accuracy.errors_from_theory import (
        INCOMPRESSIBLE,
        onset_points,
        smooth_points,
        theory_points,
    )
    from morphofold.studies.accuracy.folds_by_mesh import fold_points, pairs, simulated_folds

    yield from cases.points(Case("theory", theory_points))
    for cells in SIZES:
        show(0.0, f"forces, {cells} cells")
        yield from cases.points(Case(f"forces-{cells}", partial(assembly_points, cells)))
    settings = [s for settings_on_axis in axes().values() for s in settings_on_axis]
    folding = [s for s in settings if s.axis != PACED]
    names_to_fold = {s.name for s in (*folding, FINEST)}
    names_without_contact = {s.name for s in settings if s.axis != "contact"}  # contact starts only with folds
    settings_by_name = {s.name: s for s in (*settings, FINEST)}
    costs = {name: _cost(s) for name, s in settings_by_name.items()}
    cost_done, total_cost = 0.0, sum(costs.values())
    folds_by_name = {}
    points_by_name: dict[str, list[Point]] = {}
    for name, s in sorted(settings_by_name.items(), key=lambda item: costs[item[0]]):
        show_part = lambda part, text: show((1 - COMPARING) * (cost_done + part * costs[name]) / total_cost, text)  # noqa: B023
        if name in names_without_contact:
            show_part(0.0, f"{s.label}, smooth")
            points_by_name[name] = cases.points(Case(f"smooth-{name}", partial(smooth_points, s)))
            points_by_name[name] += cases.points(Case(f"onset-{name}", partial(onset_points, s)))
        if name in names_to_fold:
            folds_by_name[name] = simulated_folds(s, cases.folder / f"folds-{name}.npz", show_part)
        cost_done += costs[name]
    for s in (s for s in settings if s.axis != "contact"):
        yield from _of(s, [p for p in points_by_name[s.name] if p.against != INCOMPRESSIBLE or s.axis == "kappa"])
    setting_pairs = pairs(folding)
    for k, (s, reference, against) in enumerate(setting_pairs):
        show(1 - COMPARING * (1 - k / len(setting_pairs)), "comparing folds")
        work = partial(fold_points, s, folds_by_name[s.name], folds_by_name[reference.name], against)
        yield from _of(s, cases.points(Case(f"folds-{s.name}-against-{reference.name}", work)))


def _of(s: Setting, points: Iterable[Point]) -> Iterator[Point]:
    """Points of a run that belongs to several axes, as points of this axis."""
    return (replace(p, axis=s.axis, setting=s.label, value=s.value) for p in points)


def _cost(s: Setting) -> float:
    """Approximate time of a setting, in any unit: elements times steps."""
    return s.edge**-3 * (s.through + 8) * (s.kappa_ratio / 50) ** 0.5 / s.rate
