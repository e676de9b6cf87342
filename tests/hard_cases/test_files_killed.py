"""A process killed at any step on files, a full disk, two writers at once: all find the old or the new, whole."""

import errno
import os
import shutil
import signal
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hard_cases.cases import hard_case
from hard_cases.made_files import RADIAL, killed_at, resource
from made_measures import made_measures

from morphofold.io import atomic_file, write_annotation, write_gifti_map, write_morph, write_surface
from morphofold.results import write_analysis
from morphofold.shapes import icosphere
from morphofold.sim.run import simulate
from morphofold.surface import Regions, Surface

NO_RESTART = "BrainGrowth, FetalFoldSim: no restart (read)"
NAMES = ("lh.white", "a.gii", "a.ply", "a.vtk", "a.vtp")


@contextmanager
def in_place(path):
    yield Path(path)


@contextmanager
def folder_in_place(path):
    path.mkdir(parents=True)
    yield path


def writers_in_place(patch):
    for module in ("io.files", "io.gifti", "io.mesh_files", "sim.output.simulation_folder"):
        patch.setattr(f"morphofold.{module}.atomic_file", in_place)


def state(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def writers(folder):
    """What writes a thing by the name of its file or folder, from a size: surfaces, maps, regions, an analysis."""
    surface, values = (lambda r: Surface(*icosphere(2, r))), (lambda r: np.linspace(0, r, 162))
    colours = np.array([[200, 10, 10], [10, 200, 10]], dtype=np.uint8)
    halves = lambda r: Regions(np.arange(162) // r % 2, ("front", "back"), colours)
    measures = lambda r: [made_measures(name=f"{r}", level=1)]
    return {
        **{name: lambda r, name=name: write_surface(folder / name, surface(r)) for name in NAMES},
        **{name: lambda r, name=name: write_morph(folder / name, values(r)) for name in ("lh.k", "lh.k.mgh")},
        "lh.k.shape.gii": lambda r: write_gifti_map(folder / "lh.k.shape.gii", values(r)),
        "lh.a.annot": lambda r: write_annotation(folder / "lh.a.annot", halves(r)),
        "analysis": lambda r: write_analysis(measures(r), folder / "analysis", report=False),
    }


@hard_case(
    "files",
    "a writer of a surface, map or annotation killed before each step, and within writes",
    peers="nibabel, trimesh, meshio: write in place (read)",
    guard="a file beside, moved when whole",
    without=writers_in_place,
)
def test_killed_file(holds, tmp_path):
    kills = lost = 0
    files = {name: write for name, write in writers(tmp_path).items() if name != "analysis"}
    for name, write in files.items():
        path, whole = tmp_path / name, []
        for size in (2, 1):
            write(size)
            whole.append(path.read_bytes())
        for fifth in range(5):
            assert killed_at(0, lambda write=write: write(2), size=fifth * len(whole[0]) // 5)
            lost += path.read_bytes() not in whole
            kills += 1
        k = 1
        while killed_at(k, lambda write=write: write(2)):
            lost += path.read_bytes() not in whole
            kills, k = kills + 1, k + 1
    holds("neither the old file nor the new one found", lost, at_most=0)
    holds("kills", kills, at_least=5 * len(files))
    left = len(os.listdir(tmp_path)) - len(files)
    holds("left beside, for each kill", left / kills, at_most=1)


def grow(out):
    return simulate("radial", out, settings=RADIAL, resume=True)


@pytest.mark.slow
@hard_case(
    "files",
    "a run killed before each of its steps, and resumed",
    peers=NO_RESTART,
    guard="a folder beside, moved when whole",
    fails=(AssertionError, ValueError, OSError),
    without=lambda patch: patch.setattr("morphofold.sim.output.simulation_folder.atomic_folder", folder_in_place),
)
def test_killed_run(holds, tmp_path):
    whole = {name: raw for name, raw in state(grow(tmp_path / "whole").path).items() if "/" in name}
    k, kills, equal = 1, 0, 0
    while killed_at(k, lambda: grow(tmp_path / "run")):
        after = state(grow(tmp_path / "run").path)
        equal += {name: raw for name, raw in after.items() if "/" in name} == whole
        shutil.rmtree(tmp_path / "run")
        kills, k = kills + 1, k + 1
    holds("kills", kills, at_least=10)
    holds("resumed to the same stages, share", equal / kills, at_least=1)


def unread(patch):
    def write_only(path, read, write, *content, **options):
        with atomic_file(path) as temporary:
            write(os.fspath(temporary), *content, **options)

    for module in ("freesurfer", "mesh_files"):
        patch.setattr(f"morphofold.io.{module}.write_and_read", write_only)


@contextmanager
def room_for(size):
    """No file may grow beyond a size [bytes], as at a full disk."""
    limit, ignored = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limit[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, ignored)


@hard_case(
    "files",
    "a disk that is full after each fifth of a surface, map, annotation, or a file of an analysis",
    peers="numpy's tofile, and so nibabel and meshio: cut files in silence (measured)",
    guard="a look at what was written",
    without=unread,
    fails=(AssertionError, ValueError),
)
def test_full_disk(holds, tmp_path):
    tried, refusals = 0, []
    writers_by_name = writers(tmp_path)
    for name, write in writers_by_name.items():
        path = tmp_path / name
        write(1)
        before = state(tmp_path)
        most = max(p.stat().st_size for p in (path, *path.rglob("*")) if p.is_file())
        for size in range(0, most, most // 5 + 1):
            with room_for(size):
                try:
                    write(2)
                except OSError as error:
                    refusals.append((error.errno, tmp_path / name, Path(error.filename)))
            tried += 1
            assert state(tmp_path) == before, f"{name} is another one, full after {size} bytes"
    holds("writes refused, share", len(refusals) / tried, at_least=1)
    holds("the old one found", tried, at_least=5 * len(writers_by_name))
    aside = [
        refusals
        for code, path, named in refusals
        if code not in (errno.EFBIG, errno.ENOSPC) or not named.is_relative_to(path)
    ]
    holds("refusals that name another cause, or another place than the one to write", len(aside), at_most=0)
    holds.equal("left beside", sorted(p.name for p in tmp_path.iterdir()), sorted(writers_by_name))
