"""A cortex whose measures are known, with faults put into it; and how its measures are held against the clean ones."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from morphofold.analysis import crest_lines, measure, vertex_normals
from morphofold.cli import main
from morphofold.io import write_annotation, write_morph, write_surface
from morphofold.shapes import icosphere
from morphofold.shapes.ridges import ridged_net
from morphofold.studies.shapes import regular_net
from morphofold.surface import Cortex, Surface

#: turned, so that no vertex lies on a crest by symmetry
NET = regular_net("dodecahedron").rotated(np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]))

#: What two meshes of one shape may differ by, 4 mm between vertices on gyri 16 mm wide: areas and depth, whose points
#: stay, by nothing; integrals of curvature, lengths of lines and widths by the accuracy they have there.
SAME, WIDTH, BENT, LINES = 1e-9, 0.01, 0.05, 0.15


def known_cortex(level=4, *, mesh=None, net=NET):
    """Ridges 16 mm wide and 8 high along the 30 edges of a dodecahedron, on a sphere of 50; white 2.5 mm inside."""
    mesh = mesh or icosphere(level)
    white, pial = (ridged_net(net, mesh, 16.0 - 2 * t, height=8.0, radius=50.0 - t) for t in (2.5, 0.0))
    return Cortex(Surface(white.verts, mesh[1], "lh.white"), Surface(pial.verts, mesh[1], "lh.pial"))


@lru_cache
def clean():
    """The cortex without a fault, and its measures."""
    cortex = known_cortex()
    return cortex, measure(cortex)


def changed(cortex, place=lambda verts: verts, faces=None, **more):
    """The cortex with its vertices moved or added to, and perhaps other faces."""
    faces = cortex.faces if faces is None else faces
    white, pial = (Surface(place(s.verts), faces, s.name) for s in (cortex.white, cortex.pial))
    return replace(cortex, white=white, pial=pial, **more)


def split_faces(cortex, weights, count=300):
    """A vertex more in each of some faces, where the weights of its corners say; the face becomes three."""
    chosen = np.random.default_rng(1).choice(len(cortex.faces), count, replace=False)
    corners, new = cortex.faces[chosen], cortex.n_vertices + np.arange(count)
    a, b, c = corners.T
    three = [np.stack(face, axis=1) for face in ((a, b, new), (b, c, new), (c, a, new))]
    faces = np.concatenate([np.delete(cortex.faces, chosen, axis=0), *three])
    inside = lambda verts: np.einsum("k,ikj->ij", weights, verts[corners])
    return changed(cortex, lambda verts: np.concatenate([verts, inside(verts)]), faces)


def with_island(cortex, at, *, white=0.9, pial=1.0, hollow=False):
    """The cortex and a closed sphere; or the wall of a cavity, whose outside is within."""
    verts, faces = icosphere(1)
    both = np.concatenate([cortex.faces, (faces[:, ::-1] if hollow else faces) + cortex.n_vertices])
    white, pial = (
        Surface(np.concatenate([s.verts, r * verts + at]), both, s.name)
        for s, r in ((cortex.white, white), (cortex.pial, pial))
    )
    return replace(cortex, white=white, pial=pial)


def with_white_outside(cortex, count=8, by=2.0):
    """White pushed out through pial around vertex 0, where there is no crest."""
    verts = cortex.white.verts.copy()
    near = np.argsort(np.linalg.norm(cortex.pial.verts - cortex.pial.verts[0], axis=1))[:count]
    verts[near] = cortex.pial.verts[near] + by * vertex_normals(cortex.pial.verts, cortex.faces)[near]
    return replace(cortex, white=Surface(verts, cortex.faces, cortex.white.name)), near


def hold_all(holds, found, *, unit=1.0, bent=BENT, lines=LINES, width=WIDTH, area=SAME, without=()):
    """Holds all measures against those of the clean cortex, lengths in ``unit`` mm; those ``without`` aside."""
    of_clean = clean()[1]
    one, other = found.scalars, of_clean.scalars
    bounds = {
        **dict.fromkeys(("area_pial_mm2", "area_white_mm2"), (area, unit**2)),
        "gyrification_index": (area, 1),
        "mean_local_gyrification_index": (0.01, 1),
        **dict.fromkeys(("folding_index", "intrinsic_curvature_index"), (bent, 1)),
        **dict.fromkeys(
            ("mean_cortical_thickness_mm", "mean_sulcal_depth_mm", "median_gyral_thickness_mm"), (width, unit)
        ),
        **dict.fromkeys(("wavelength_mm", "crest_length_mm"), (max(width, area), unit)),
        "spectral_wavelength_mm": (lines, unit),
    }
    off = {
        name: (abs(one[name] / (size * other[name]) - 1), bound)
        for name, (bound, size) in bounds.items()
        if name not in without
    } | {name: (change, 2 * power * bent) for name, power, change in changes_of_maps(found, unit)}
    if "lines" not in without:
        off |= {f"{kind} crest lines": (change, lines) for kind, change in changes_of_lines(found, unit)}
    share = {name: change / bound if np.isfinite(change) else np.inf for name, (change, bound) in off.items()}
    worst = max(share, key=lambda name: share[name])
    change, bound = off[worst]
    holds(f"{len(off)} measures, nearest to its bound {worst.removesuffix('_mm')}: change", change, at_most=bound)
    counts = [name for name in ("n_hinges", "n_hinges_3", "n_hinges_4", "n_crests") if name not in without]
    holds.equal("hinges and crests", [one[name] for name in counts], [other[name] for name in counts])


def changes_of_maps(found, unit):
    """Of curvature at the vertices that the clean cortex has too, relative to its root mean square."""
    for name, power in (("H", 1), ("K", 2)):
        true = clean()[1].maps[name]
        off = unit**power * found.maps[name][: len(true)] - true
        yield name, power, np.sqrt(np.mean(off**2) / np.mean(true**2))


def changes_of_lines(found, unit):
    sizes = []
    for m in (found, clean()[1]):
        pial, scale = m.cortex.pial, m.parameters["curvature_scale_mm"]
        sizes.append(crest_lines(pial.verts, pial.faces, scale=scale))
    for kind in ("gyral", "sulcal"):
        yield kind, abs(sizes[0].length(kind) / (unit * sizes[1].length(kind)) - 1)


def refusal(cortex, **options):
    """What ``measure`` refuses the cortex with, its code last, as commands tell it; empty if it does not."""
    try:
        measure(cortex, **options)
    except ValueError as error:
        return f"{error} [{getattr(error, 'code', '')}]"
    return ""


def analyzed(folder, capsys, cortex, *more, kind=""):
    """Exit status, and what ``morphofold analyze`` prints, of files of the cortex; of a subject if it has regions."""
    if cortex.regions:
        for name in ("surf", "label"):
            (folder / "S" / name).mkdir(parents=True)
        surf, files = folder / "S" / "surf", [str(folder / "S")]
        write_annotation(folder / "S" / "label" / "lh.aparc.annot", cortex.regions)
        for name, values in cortex.maps.items():
            write_morph(surf / f"lh.{name}", values, nan=np.nan)
    else:
        surf, files = folder, [f"--{name}={folder / f'lh.{name}{kind}'}" for name in ("white", "pial")]
    for surface in (cortex.white, cortex.pial):
        write_surface(surf / f"{surface.name}{kind}", surface)
    out = folder / "out"
    status = main(["analyze", *files, "-q", "--no-report", "-o", str(out), *more])
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    assert out.exists() == (status == 0)
    if status:
        assert status == 2
        assert len(captured.err.strip().splitlines()) == 1
    return status, captured.out + captured.err
