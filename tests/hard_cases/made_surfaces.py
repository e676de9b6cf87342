"""A cortex whose measures are known, with faults put into it; and how its measures are held against the clean ones."""

from functools import lru_cache

import numpy as np
from hard_cases.cases import hard_case

from morphofold.analysis import crest_lines, measure
from morphofold.cli import main
from morphofold.io import write_surface
from morphofold.shapes import icosphere
from morphofold.studies.known_shapes import regular_net
from morphofold.studies.ridged_nets import ridged_net
from morphofold.surface import Cortex, Surface

#: turned, so that no vertex lies on a crest by symmetry
NET = regular_net("dodecahedron").rotated(np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]))

#: What two meshes of one shape may differ by, 4 mm between vertices on gyri 16 mm wide: areas and depth, whose points
#: stay, by nothing; integrals of curvature, lengths of lines and widths by the accuracy they have there.
SAME, WIDTH, BENT, LINES = 1e-9, 0.01, 0.05, 0.15


#: how a test may end without its guard: a bound breaks, or what is measured is refused
BROKEN = (AssertionError, ValueError, MemoryError, RuntimeError, RuntimeWarning)


def case(name, guard="", without=None, *, peers="–", fails=BROKEN):
    """Marks a hard case; ``without`` takes a monkeypatch, or is the object, attribute and value for its ``setattr``."""
    removal = (lambda patch: patch.setattr(*without)) if isinstance(without, tuple) else without
    return hard_case("surfaces", name, peers=peers, guard=guard, without=removal, fails=fails)


def change(value, true):
    return abs(value / true - 1)


def pair(white, pial, faces):
    return Cortex(Surface(white, faces, "lh.white"), Surface(pial, faces, "lh.pial"))


def known_cortex(level=4, *, mesh=None, net=NET):
    """Ridges 16 mm wide and 8 high along the 30 edges of a dodecahedron, on a sphere of 50; white 2.5 mm inside."""
    mesh = mesh or icosphere(level)
    white, pial = (ridged_net(net, mesh, 16.0 - 2 * t, height=8.0, radius=50.0 - t) for t in (2.5, 0.0))
    return pair(white.verts, pial.verts, mesh[1])


CORTEX = known_cortex()
WHITE, PIAL, FACES = CORTEX.white.verts, CORTEX.pial.verts, CORTEX.faces


@lru_cache
def clean():
    """The cortex without a fault, and its measures."""
    result = measure(CORTEX)
    assert not {"crossing", "pair", "self_crossing", "thickness_file", "mesh"} & result.notes.keys()
    return CORTEX, result


def changed(cortex, move=lambda verts: verts, faces=None):
    """The cortex with its vertices moved or added to, and perhaps other faces."""
    return pair(move(cortex.white.verts), move(cortex.pial.verts), cortex.faces if faces is None else faces)


def with_island(cortex, at, *, white=0.9, pial=1.0, hollow=False, level=1):
    """The cortex and closed spheres; or the walls of cavities, whose outside is within."""
    verts, faces = icosphere(level)
    at = np.reshape(at, (-1, 1, 3))
    first = cortex.n_vertices + len(verts) * np.arange(len(at))
    more = (first[:, None, None] + (faces[:, ::-1] if hollow else faces)).reshape(-1, 3)
    added = lambda surface, radius: np.concatenate([surface.verts, (at + radius * verts).reshape(-1, 3)])
    return pair(added(cortex.white, white), added(cortex.pial, pial), np.concatenate([cortex.faces, more]))


def hold_all(holds, result, *, unit=1.0, bent=BENT, lines=LINES, width=WIDTH, area=SAME, without=()):
    """Holds all measures against those of the clean cortex, lengths in ``unit`` mm; those ``without`` aside."""
    whole = clean()[1]
    bounds = (
        ("area_pial_mm2 area_white_mm2", area, unit**2),
        ("gyrification_index", area, 1),
        ("mean_local_gyrification_index", 0.01, 1),
        ("folding_index intrinsic_curvature_index", bent, 1),
        ("mean_cortical_thickness_mm mean_sulcal_depth_mm median_gyral_thickness_mm", width, unit),
        ("wavelength_mm crest_length_mm", max(width, area), unit),
        ("spectral_wavelength_mm", lines, unit),
    )
    changes = {
        name: (change(result.scalars[name], size * whole.scalars[name]), bound)
        for names, bound, size in bounds
        for name in names.split()
        if name not in without
    }
    for name, power in (("H", 1), ("K", 2)):  # at the vertices of the clean cortex, relative to root mean square
        true = whole.maps[name]
        off = unit**power * result.maps[name][: len(true)] - true
        changes[name] = np.sqrt(np.mean(off**2) / np.mean(true**2)), 2 * power * bent
    if "lines" not in without:
        crests, true = (
            crest_lines(m.cortex.pial.verts, m.cortex.pial.faces, scale=m.parameters["curvature_scale_mm"])
            for m in (result, whole)
        )
        for kind in ("gyral", "sulcal"):
            changes[f"{kind} crest lines"] = change(crests.length(kind), unit * true.length(kind)), lines
    ratios = {name: off / bound if np.isfinite(off) else np.inf for name, (off, bound) in changes.items()}
    worst = max(ratios, key=ratios.get)
    off, bound = changes[worst]
    holds(f"{len(changes)} measures, nearest to its bound {worst.removesuffix('_mm')}: change", off, at_most=bound)
    counts = ("n_hinges", "n_hinges_3", "n_hinges_4", "n_crests")
    holds.equal("hinges and crests", *([m.scalars[name] for name in counts] for m in (result, whole)))


def refusal(cortex, **options):
    """What ``measure`` refuses the cortex with, its code last, as commands tell it; empty if it does not."""
    try:
        measure(cortex, **options)
    except ValueError as error:
        return f"{error} [{getattr(error, 'code', '')}]"
    return ""


def analyze(holds, tmp_path, capsys, cortex, *phrases, status=0, options=(), kind="", what="analyze"):
    """What ``morphofold analyze`` prints of files of the cortex, the phrases within."""
    out, files = tmp_path / "out", []
    for name in ("white", "pial"):
        write_surface(path := tmp_path / f"lh.{name}{kind}", getattr(cortex, name))
        files.append(f"--{name}={path}")
    ended = main(["analyze", *files, "-q", "--no-report", "-o", str(out), *options])
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    assert out.exists() == (ended == 0)
    assert ended == 0 or len(captured.err.strip().splitlines()) == 1
    holds.equal("exit status", ended, status)
    printed = captured.out + captured.err
    if phrases:
        holds.says(what, printed, *phrases)
    return printed
