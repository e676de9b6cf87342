"""A small file of every format that morphofold reads, each with its reader; child processes short of something."""

import json
import os
import re
import signal
import struct
import sys
from collections.abc import Callable
from dataclasses import dataclass, is_dataclass, replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from made_measures import made_measures
from made_simulations import made_simulation
from made_surfaces import FOOTER, FORMATS
from nibabel.gifti import GiftiDataArray, GiftiImage
from trimesh.exchange.ply import export_ply
from trimesh.exchange.stl import export_stl_ascii

from morphofold.analysis import gyral_graph
from morphofold.errors import Refusal
from morphofold.io import (
    read_annotation,
    read_cortex,
    read_label,
    read_morph,
    read_surface,
    write_annotation,
    write_gifti_map,
    write_morph,
    write_surface,
)
from morphofold.results import read_analysis, write_analysis, write_dataset
from morphofold.shapes import icosphere
from morphofold.sim.mesh.checked_tets import read_tets
from morphofold.sim.output.checkpoint import as_bytes, as_lines, read_checkpoint, read_log
from morphofold.sim.output.simulation_folder import is_finished
from morphofold.sim.scene import MeshFile
from morphofold.sim.scene.scene_files import load_scene
from morphofold.surface import Regions, Surface


class NoResource:
    """Stands for ``resource`` on systems that have none: a test that asks it for anything is skipped."""

    def __getattr__(self, name):
        if name.startswith("_"):  # as pytest asks of all names in a module
            raise AttributeError(name)
        pytest.skip(f"needs Linux: there is no resource.{name} on {sys.platform}")


try:
    import resource
except ImportError:  # Windows
    resource = NoResource()  # type: ignore[assignment]

SLOW = 2  # seconds of processor time of one small file


@dataclass(frozen=True)
class Sample:
    """A file, and what reads it, or the folder that it is part of."""

    path: Path
    read: Callable[[], object]


def samples(folder: Path) -> dict[str, Sample]:
    """One sample per format, by name."""
    by_name: dict[str, Sample] = {}

    def add(name, read, path=None):
        path = path or folder / name
        by_name[name] = Sample(path, lambda: read(path))

    _surfaces(folder, add)
    _maps(folder, add)
    _meshes(folder, add)
    _scene_and_run(folder, add)
    _analysis(folder, add)
    return by_name


def _surfaces(folder, add):
    verts, faces = icosphere(0, 40.0)
    surface = Surface(verts.astype(np.float32), faces, geometry=FOOTER)
    for name in [*FORMATS, "a.stl"]:
        write_surface(folder / name, surface)
        add(name, read_surface)
    mesh = surface.to_trimesh()
    (folder / "text.ply").write_bytes(export_ply(mesh, encoding="ascii"))
    (folder / "text.stl").write_text(export_stl_ascii(mesh))
    surface.to_pyvista().save(folder / "text.vtk", binary=False)
    for name in ("text.ply", "text.stl", "text.vtk"):
        add(name, read_surface)
    (folder / "lh.quads").write_bytes(_quads())
    add("lh.quads", read_surface)
    (folder / "raw.gii").write_bytes(_plain_gifti(surface))
    add("raw.gii", read_surface)


def _quads():
    """A cube of quadrangles in FreeSurfer's old format."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * 4000
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    three = lambda n: int(n).to_bytes(3, "big")
    ends = b"".join(three(i) for quad in quads for i in quad)
    return b"\xff\xff\xff" + three(8) + three(6) + corners.astype(">i2").tobytes() + ends


def _plain_gifti(surface):
    points = GiftiDataArray(surface.verts.astype(np.float32), "NIFTI_INTENT_POINTSET", encoding="ASCII")
    faces = GiftiDataArray(surface.faces.astype(np.int32), "NIFTI_INTENT_TRIANGLE", encoding="B64BIN")
    return GiftiImage(darrays=[points, faces]).to_bytes()


def _maps(folder, add):
    values = np.linspace(1, 3, 42)
    colours = np.array([[200, 10, 10], [10, 200, 10]], dtype=np.uint8)
    regions = Regions(np.arange(42) % 2, ("front", "back"), colours)
    write_morph(folder / "lh.thickness", values)
    write_gifti_map(folder / "lh.k.shape.gii", values)
    (folder / "lh.old").write_bytes(bytes([0, 0, 42, 0, 0, 80]) + (100 * values).astype(">i2").tobytes())
    for name in ("lh.thickness", "lh.k.shape.gii", "lh.old"):
        add(name, read_morph)
    write_annotation(folder / "lh.aparc.annot", regions)
    add("lh.aparc.annot", read_annotation)
    (folder / "lh.old.annot").write_bytes(_old_annotation())
    add("lh.old.annot", read_annotation)
    write_annotation(folder / "lh.a.label.gii", regions)
    add("lh.a.label.gii", read_annotation)
    lines = "".join(f"{i}  1.000  2.000  3.000 0.0\n" for i in range(0, 42, 2))
    (folder / "lh.cortex.label").write_text(f"#!ascii label\n21\n{lines}")
    add("lh.cortex.label", lambda path: read_label(path, 42))


def _old_annotation():
    """With a colour table of the first layout."""
    vertices = b"".join(struct.pack(">2i", i, 1 + 256 * 2 + 65536 * 3) for i in range(42))
    text = lambda t: struct.pack(">i", len(t) + 1) + t + b"\0"
    table = struct.pack(">2i", 1, 1) + text(b"a") + text(b"front") + struct.pack(">4i", 1, 2, 3, 0)
    return struct.pack(">i", 42) + vertices + table


MESHES = tuple(f"ball.{kind}" for kind in "vtu msh mesh meshb vtk inp mdpa tec ele".split())


def _meshes(folder, add):
    verts, faces = icosphere(0, 50.0)
    points = np.vstack([verts, np.zeros(3)])
    tets = np.column_stack([faces, np.full(len(faces), len(verts))])
    for name in MESHES:
        meshio.Mesh(points, [("tetra", tets)]).write(folder / name)
        add(name, _tets_and_maps)


def _tets_and_maps(path):
    """A body, and the maps of its nodes, without the object of meshio, which equals only itself."""
    body = read_tets(MeshFile(shape="mesh", file=str(path), cortex_thickness=3.0))
    return body._replace(file=None), body.file.point_maps()


SCENE = """\
name = "ball"
[geometry]
shape = "sphere"
portion = "octant"
cortex_thickness = 3.0
[material]
mu_ratio = 2.0
[growth]
final = 1.5
[accuracy]
level = "draft"
[output]
stages = [1.2, 1.4]
"""
RADIAL = ["growth.final=1.2", "output.stages=[1.1]"]


def _scene_and_run(folder, add):
    (folder / "scene.toml").write_text(SCENE)
    add("scene.toml", load_scene)
    like = {"x": np.linspace(0, 1, 30).reshape(10, 3), "growth": np.array(1.2), "lines": np.array(3)}
    np.savez(folder / "checkpoint.npz", **like)
    add("checkpoint.npz", lambda path: read_checkpoint(path, like))
    lines = [{"step": k, "growth": 1 + k / 100, "elapsed": 0.5 * k, "seconds": {"a": 0.1}} for k in range(3)]
    (folder / "log.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    add("log.jsonl", lambda path: read_log(path.parent, 3, as_bytes(as_lines(lines))))
    run = made_simulation(folder / "run", "radial", RADIAL)
    for name in ("health.json", "scene.toml", "stages/g1.20/stage.json", "stages/g1.20/files.json"):
        add(f"run/{name}", lambda path: (is_finished(run.path, run.scene, True), run.health, _but_a_scene(path)))
    bare = lambda path: replace(read_cortex(path.parent), inputs=())  # whose digests tell any two files apart
    add("stage.json", bare, run.path / "stages" / "g1.20" / "stage.json")


def _but_a_scene(path):
    """The text of a file; a scene that lacks its last default is the same."""
    return "" if path.suffix == ".toml" else path.read_text().strip()


def _analysis(folder, add):
    measures = made_measures(level=3)
    measures = replace(measures, graph=gyral_graph(measures.cortex.pial))
    write_analysis([measures], folder / "analysis", report=False)
    for name in ("summary.json", "hinges.tsv", "regions.tsv", "graph/lh.json"):
        add(f"analysis/{name}", lambda path: read_analysis(folder / "analysis"))
    add("summary.json", lambda path: read_cortex(path.parent), folder / "analysis" / "summary.json")
    subject = write_dataset([measures], folder / "bids", "one", report=False)
    for pattern in ("*provenance.json", "*hinges_morph.tsv"):
        for file in sorted((subject / "anat").glob(pattern)):
            add(f"bids/{file.name}", lambda path: read_analysis(subject), file)


class Hang(BaseException):
    """A reader took too long."""


def needs_linux() -> None:
    """Skips a test of child processes that are short of something, off Linux."""
    if sys.platform != "linux":
        pytest.skip(f"needs Linux: fork, /proc, timers and limits of a process, not {sys.platform}")


def verdict(sample: Sample) -> str:
    """What a reader says of a file: "" if it reads it, or its refusal, seen to be one line, with its kind as commands
    tell it, ``[damaged-file]``. Anything else is raised.

    A refusal for want of memory is none: the reader had taken all there was.
    """
    try:
        sample.read()
    except (ValueError, OSError) as error:
        message = str(error)
        if re.search("memory|allocat", message, re.IGNORECASE):
            raise AssertionError(f"{sample.path.name}: took all memory: {message[:300]!r}") from error
        lines = message.splitlines()
        scene = sample.path.suffix == ".toml"  # of which each problem is told on its line
        if isinstance(error, UnicodeError) or len(lines) > (21 if scene else 1) or len(message) > 600 * len(lines):
            raise AssertionError(f"{sample.path.name}: no clear line: {message[:300]!r}") from error
        return f"{message} [{error.code}]" if isinstance(error, Refusal) else message
    return ""


def compared(sample: Sample, raw: bytes, whole: object) -> str:
    """How a reader takes other bytes: "refused", "same" as ``whole``, "different", "slow", or what it raised."""
    needs_linux()
    original = sample.path.read_bytes()
    sample.path.write_bytes(raw)

    def stop(number, frame):
        raise Hang("slow")

    before = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, SLOW)
    try:
        return "refused" if verdict(sample) else "same" if same(sample.read(), whole) else "different"
    except (Exception, SystemExit, Hang) as error:  # meshio leaves through SystemExit
        return f"{type(error).__name__}: {error}"[:200]
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)
        sample.path.write_bytes(original)


def same(a: Any, b: Any) -> bool:
    """Whether two readings hold the same; of a surface its numbers, as the volume geometry may end anywhere."""
    if isinstance(a, Surface) and isinstance(b, Surface):
        return same((a.verts, a.faces), (b.verts, b.faces))
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if type(a) is not type(b):
        return False
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(same, a, b))
    if is_dataclass(a):
        return same(vars(a), vars(b))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(value, b[key]) for key, value in a.items())
    return a == b or "MultiGraph" in type(a).__name__


def killed_at(k: int, work: Callable[[], object], *, size: int | None = None) -> bool:
    """Whether a child process that is killed before its k-th step on files got that far; works to the end otherwise.

    With ``size`` it is killed once a file has so many bytes, within a write.

    Steps are what Python tells its audit hooks: opening, moving, making and removing. What a file was given before and
    is not flushed is lost with the process, as it is in a real one.
    """
    needs_linux()
    child = os.fork()
    if child == 0:
        steps = [0]

        def hook(event, arguments):
            if event in STEPS:
                steps[0] += 1
                if steps[0] == k:
                    os.kill(os.getpid(), signal.SIGKILL)

        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            if size is not None:
                resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
                signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
                resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
            sys.addaudithook(hook)
            work()
        except BaseException:
            os._exit(1)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    ended = os.WTERMSIG(status) if os.WIFSIGNALED(status) else status
    assert ended in (0, signal.SIGKILL, signal.SIGXFSZ), f"the work failed by itself: status {status}"
    return status != 0


STEPS = "open os.rename os.mkdir os.remove os.rmdir shutil.rmtree os.link os.truncate ctypes.dlsym".split()
