"""Files that are cut, flipped in bits, or promise too much: what is read is as before, or refused in one line."""

import contextlib
import csv
import io
import re
import struct
import tracemalloc
import warnings
import zipfile
from dataclasses import replace

import meshio
import nibabel as nib
import numpy as np
import pytest
import trimesh
from hard_cases.cases import hard_case
from hard_cases.made_files import Sample, compared, same, samples, verdict
from made_surfaces import FORMATS

from morphofold.io import formats, mesh_files, meshio_files, read_annotation, read_label, read_morph, read_surface
from morphofold.results import layouts
from morphofold.sim.mesh import tet_files
from morphofold.sim.mesh.checked_tets import read_tets
from morphofold.sim.output import checkpoint, stage_records
from morphofold.sim.scene import MeshFile

LENGTHLESS = ("a.obj", "ball.inp", "scene.toml")  # a part of such a text is a whole one
SURFACES = (*FORMATS, "a.stl", "text.ply", "text.stl", "text.vtk", "lh.quads", "raw.gii")
MAPS = ("lh.thickness", "lh.k.shape", "lh.old", "lh.aparc.annot", "lh.old.annot", "lh.a.label", "lh.cortex.label")
RUN = ("checkpoint.npz", "log.jsonl", "stage.json", "run/")
ANALYSIS = ("analysis/", "summary.json", "bids/")
BRAINGROWTH = "BrainGrowth, FetalFoldSim: no restart, so no file of a run is read (read)"

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


@pytest.fixture(scope="module")
def by_name(tmp_path_factory):
    """Samples by name; each is restored after it was damaged."""
    return samples(tmp_path_factory.mktemp("samples"))


def chosen(by_name, names):
    return {name: s for name, s in by_name.items() if name.startswith(tuple(names)) and name not in LENGTHLESS}


def every_tenth(by_name, names):
    """How readers took each sample, cut before every tenth byte, up to a hang: (name, cut) by verdict."""
    outcomes = {}
    for name, sample in chosen(by_name, names).items():
        raw, whole = sample.path.read_bytes(), sample.read()
        inside = range(0) if len(raw) < 5000 else range(2000, len(raw) - 1000)
        step = 500 if name.endswith((".vtk", ".vtp", ".vtu")) else 10  # a process starts for each cut
        for cut in sorted({*range(0, len(raw), step), *range(len(raw) - 1, 0, -step)[:20]} - set(inside)):
            outcome = compared(sample, raw[:cut], whole)
            outcomes.setdefault(outcome, []).append((name, cut))
            if outcome.startswith("Hang"):
                return outcomes
    return outcomes


def assert_sound(holds, outcomes, at_least):
    """No damage was read as something else, or ended in anything but one line."""
    refused, _ = outcomes.pop("refused", []), outcomes.pop("same", [])
    holds("read as something else", len(outcomes.pop("different", [])), at_most=0)
    assert not outcomes, f"{len(outcomes)} other ends, the first: {next(iter(outcomes.items()))!r:.300}"
    holds("damaged files refused in one line", len(refused), at_least=at_least)


def nothing(*args, **options):
    pass


@hard_case(
    "files",
    "surfaces cut before every tenth byte: FreeSurfer, GIFTI, PLY, STL, OFF, GLB, VTK, VTP, VTU",
    peers="trimesh: takes as many faces of a PLY text as are left (measured)",
    guard="the counts in the header",
    without=lambda patch: patch.setattr(mesh_files, "_HEADER_COUNTS", {}),
)
def test_cut_surfaces(by_name, holds):
    assert_sound(holds, every_tenth(by_name, SURFACES), 1000)


def by_nibabel():
    *others, curv = formats.FORMATS["map"]
    return *others, replace(curv, read=lambda raw, path: nib.freesurfer.read_morph_data(path))


@hard_case(
    "files",
    "maps, annotations and labels cut before every tenth byte",
    peers="nibabel: reads the values that are left of a curv file (measured)",
    guard="the count held against the size",
    without=lambda patch: patch.setitem(formats.FORMATS, "map", by_nibabel()),
)
def test_cut_maps(by_name, holds):
    assert_sound(holds, every_tenth(by_name, MAPS), 300)


@hard_case(
    "files",
    "tetrahedra cut before every tenth byte: VTU, VTK, Ansys, Medit",
    peers="meshio: its readers of .msh, .mdpa, .tec, .ele never end on some of these (measured)",
    guard="an end to asking beyond the end",
    without=lambda patch: patch.setattr(meshio_files._EndingFile, "readinto", io.FileIO.readinto),
)
def test_cut_meshes(by_name, holds):
    assert_sound(holds, every_tenth(by_name, ["ball."]), 500)


@hard_case(
    "files",
    "checkpoint, log, stage and health of a run cut before every tenth byte",
    peers=BRAINGROWTH,
    guard="a check of finished runs",
    without=lambda patch: patch.setattr("morphofold.sim.output.simulation_folder.check_finished", nothing),
)
def test_cut_runs(by_name, holds):
    assert_sound(holds, every_tenth(by_name, RUN), 300)


def as_it_is(path, text_columns, n_rows, *, number_columns):
    with path.open(newline="") as file:
        return list(csv.DictReader(file, delimiter="\t"))


@hard_case(
    "files",
    "summary, tables, graph and provenance of an analysis cut before every tenth byte",
    guard="tables that are whole",
    without=lambda patch: patch.setattr(layouts, "read_table", as_it_is),
)
def test_cut_analyses(by_name, holds):
    assert_sound(holds, every_tenth(by_name, ANALYSIS), 300)


@hard_case(
    "files",
    "an OBJ or OFF text cut before every byte",
    peers="trimesh: reads what is left of a number (measured)",
    guard="a warning",
    without=lambda patch: patch.setattr(formats, "warn_of_no_end", nothing),
)
def test_texts_cut_within_a_line(by_name, holds):
    silent = warned = 0
    for name in ("a.obj", "a.off"):
        raw, whole = by_name[name].path.read_bytes(), by_name[name].read()
        faces = set(map(tuple, whole.faces.tolist()))
        path = by_name[name].path.with_name(f"cut-{name}")
        for _, surface, messages in cuts_that_are_read(path, raw, read_surface):
            wrong = not set(map(tuple, surface.faces.tolist())) <= faces
            wrong |= not (surface.verts == whole.verts[: len(surface.verts)]).all()
            warned += bool(messages)
            silent += wrong and not messages
    holds("faces or points that were not there, in silence", silent, at_most=0)
    holds("cuts warned of", warned, at_least=1)


def cuts_that_are_read(path, raw, read, first=0):
    """The cuts of a file from a byte on that are not refused, what is read of each, and its warnings."""
    for cut in range(first, len(raw)):
        path.write_bytes(raw[:cut])
        with warnings.catch_warnings(record=True) as messages:
            warnings.simplefilter("always")
            with contextlib.suppress(ValueError, OSError):
                yield cut, read(path), messages


@hard_case(
    "files",
    "tetrahedra in texts without counts (Abaqus, SU2, FLAC3D, PERMAS) cut before each of their last bytes",
    peers="meshio: reads what is left of a number (measured)",
    guard="a warning",
    without=lambda patch: patch.setattr(tet_files, "warn_of_no_end", nothing),
)
def test_tetrahedra_cut_within_a_line(holds, tmp_path):
    points, tets = np.array([[0, 0, 0], [10, 0, 0], [0, 20, 0], [0, 0, 30], [9, 9, 9.0]]), [[0, 1, 2, 3], [1, 2, 3, 4]]
    silent = warned = 0
    for name in ("a.inp", "a.su2", "a.f3grid", "a.post"):
        path = tmp_path / name
        meshio.Mesh(points, [("tetra", np.array(tets))]).write(path)
        whole, raw = body(path), path.read_bytes()
        for cut, read, messages in cuts_that_are_read(path, raw, body, len(raw) // 2):
            warned += bool(messages)
            silent += not messages and raw[cut - 1 : cut] != b"\n" and not same(read, whole)
    holds("cut within a line and read as another body, in silence", silent, at_most=0)
    holds("cuts warned of", warned, at_least=1)


def body(path):
    tets = read_tets(MeshFile(shape="mesh", file=str(path), cortex_thickness=3.0))
    return tets.points, tets.tets


def unguarded_libraries(patch):
    @contextlib.contextmanager
    def as_it_comes(*args):
        yield

    for module in (formats, tet_files, checkpoint, stage_records):
        patch.setattr(module, "decoding", as_it_comes)


@hard_case(
    "files",
    "a bit flipped at every 60th (20th) byte of every format",
    peers="nibabel, meshio, trimesh: dozens of kinds of exceptions (measured)",
    guard="one clear error for all that libraries raise",
    without=unguarded_libraries,
)
@pytest.mark.parametrize("step", [60, pytest.param(20, marks=pytest.mark.slow)])
def test_flipped_bits(by_name, holds, step):
    refused, other, count = 0, {}, 0
    for name, sample in by_name.items():
        raw = sample.path.read_bytes()
        for byte in range(0, min(len(raw), 2500), step):
            flipped = bytearray(raw)
            flipped[byte] ^= 1 << (byte // step % 8)
            outcome = compared(sample, bytes(flipped), None)
            refused, count = refused + (outcome == "refused"), count + 1
            if outcome not in ("refused", "different") and not outcome.startswith("MemoryError: "):  # a huge array
                other[name, byte] = outcome
    assert not other, f"{len(other)} other ends, the first: {next(iter(other.items()))!r:.300}"
    holds("hangs, crashes, unclear errors", len(other), at_most=0)
    holds("damaged files", count, at_least=30_000 / step)
    holds("refused in one line, share", refused / count, at_least=0.3)


@hard_case(
    "files",
    "every seventh bit of a checkpoint flipped, one at a time",
    peers=BRAINGROWTH,
    guard="its checksums",
    without=lambda patch: patch.setattr(zipfile.ZipExtFile, "_update_crc", nothing),
)
def test_flipped_checkpoint(by_name, holds):
    sample = by_name["checkpoint.npz"]
    raw, whole, outcomes = sample.path.read_bytes(), sample.read(), {}
    for bit in range(0, 8 * len(raw), 7):
        flipped = bytearray(raw)
        flipped[bit // 8] ^= 1 << bit % 8
        outcomes.setdefault(compared(sample, bytes(flipped), whole), []).append(bit)
    assert_sound(holds, outcomes, 600)


def format_by_name(raw, name, content="surface"):
    return next((format_ for format_ in formats.FORMATS[content] if re.search(format_.names, name)), None)


@hard_case(
    "files",
    "every format under every other's name",
    guard="the first bytes decide, not the name",
    without=lambda patch: patch.setattr("morphofold.io.formats.format_of", format_by_name),
)
def test_wrong_names(by_name, holds):
    wrong = {}
    for name in SURFACES:
        raw = by_name[name].path.read_bytes()
        silent = name in ("a.obj", "a.stl", "a.surf.gii.gz")  # whose first bytes say nothing, or packed
        for other in SURFACES:
            path = by_name[name].path.with_name(f"as-{other}")
            path.write_bytes(raw)
            sample = Sample(path, lambda path=path: read_surface(path))
            if verdict(sample) and not silent:
                wrong[name, other] = verdict(sample)
    holds("pairs of formats", len(SURFACES) ** 2, at_least=200)
    holds("of those whose first bytes tell, refused", len(wrong), at_most=0)
    made_up = b"\0\1\2\3" * 50
    others = chosen(by_name, SURFACES + MAPS).values()
    refused = [bool(verdict(Sample(s.path, lambda s=s: _with(s, made_up)))) for s in others]
    holds("readers that refuse a wrong magic, share", sum(refused) / len(refused), at_least=1)


def _with(sample, raw):
    original = sample.path.read_bytes()
    sample.path.write_bytes(raw)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            return sample.read()
    finally:
        sample.path.write_bytes(original)


@hard_case(
    "files",
    "an STL text whose normals are no numbers (found by fuzzing)",
    peers="trimesh: logs a traceback (seen)",
    guard="packages log nothing while they read",
    without=lambda patch: patch.setattr(mesh_files.logging, "disable", nothing),
)
def test_normals(holds, tmp_path, caplog):
    text = trimesh.exchange.stl.export_stl_ascii(trimesh.creation.icosphere(1))
    path, wrong = tmp_path / "a.stl", tmp_path / "wrong.stl"
    path.write_text(text)
    wrong.write_text(re.sub(r"facet normal \S+", "facet normal x", text, count=1))
    surfaces = read_surface(path), read_surface(wrong)
    holds("lines logged", len(caplog.records), at_most=0)
    holds.equal("vertices", *(surface.verts.tolist() for surface in surfaces))


# --- headers that promise more than their file holds

MANY = 2**31 - 1
LIGHT = 512  # MiB that a refusal may take
VTK = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS\t{} float\n{}POLYGONS\t1 {}\n3 0 1 2\n"
TRIANGLE = "0 0 0 1 0 0 0 1 0\n"
PLY = "ply\nformat {} 1.0\nelement\tvertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
PLY_BODY = "property list uchar int vertex_indices\nend_header\n0 0 0\n"
FILES = {
    "lh.k": (b"\xff\xff\xff" + struct.pack(">3i", MANY, 1, 1) + bytes(999), read_morph),
    "a.annot": (struct.pack(">i", MANY) + bytes(999), read_annotation),
    "a.label": (f"#!ascii\n{MANY}\n0 1 2 3 4\n".encode(), lambda path: read_label(path, 42)),
    "points.vtk": (VTK.format(MANY, TRIANGLE, 4).encode(), read_surface),
    "polygons.vtk": (VTK.format(3, TRIANGLE, MANY).encode(), read_surface),
    "text.ply": ((PLY.format("ascii", MANY) + PLY_BODY).encode(), read_surface),
    "binary.ply": ((PLY.format("binary_little_endian", MANY) + PLY_BODY).encode(), read_surface),
}


@pytest.mark.parametrize("name", FILES)
@hard_case(
    "files",
    "a map, annotation, label or surface that promises 2³¹ vertices or faces",
    peers="nibabel: allocates what the header says (read); VTK: ends the process (measured)",
)
def test_promises(name, holds, tmp_path):
    raw, read = FILES[name]
    path = tmp_path / name
    path.write_bytes(raw)
    tracemalloc.start()
    try:
        message = verdict(Sample(path, lambda: read(path)))
        taken = tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()
    holds.says(name, message.replace(str(path), path.name), path.name, "[damaged-file]")
    holds(f"{name}: memory taken", taken, at_most=LIGHT, unit="MiB")
