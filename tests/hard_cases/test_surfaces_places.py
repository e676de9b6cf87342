"""Where coordinates lie and how they are written: far from the origin, in other units, in single precision."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hard_cases.cases import hard_case
from hard_cases.made_surfaces import analyzed, changed, clean, hold_all, refusal
from made_surfaces import FORMATS

from morphofold.analysis import curvatures, measure
from morphofold.analysis.thickness import gyral
from morphofold.io import read_cortex, read_surface, write_surface
from morphofold.mesh_quality import defects
from morphofold.surface import Surface

FAR = 1e6


def where_it_is(patch):
    """Rays in the coordinates as they are."""
    patch.setattr(gyral.RayCaster, "_scaled", lambda self, points: points.astype(np.float32))


@hard_case(
    "surfaces",
    "coordinates offset by 1e6 mm, in double precision",
    guard="rays are cast around the origin",
    peers="embree's rays are single precision (said)",
    without=where_it_is,
)
def test_a_surface_a_kilometre_away_has_the_same_measures(holds):
    """Round-off is 1e6 x 2^-52 = 2e-10 mm, and over the square of a scale of 10 mm in curvature."""
    found = measure(changed(clean()[0], lambda verts: verts + FAR))
    hold_all(holds, found, bent=1e-8, lines=1e-6, width=1e-8)


def silent(patch):
    patch.setattr(defects, "remarks", lambda cortex, mask, given=None: {})


@hard_case(
    "surfaces", "coordinates offset by 1e6 mm and written as float32", guard="the note on rounding", without=silent
)
def test_coordinates_rounded_far_from_the_origin_are_told(holds, tmp_path, capsys):
    """float32 has steps of 1/16 mm there; those of the scanner, 100 mm away, are none to speak of."""
    cortex = clean()[0]
    rounded = changed(cortex, lambda verts: (verts + FAR).astype(np.float32))
    holds.says("note", measure(rounded).notes.get("mesh", ""), " 0.062 (float32")
    status, printed = analyzed(tmp_path, capsys, rounded)
    holds.equal("exit status", status, 0)
    holds.says("analyze", printed, " lh.white ", " 0.062 (float32", "[mesh]")
    near = measure(changed(cortex, lambda verts: (verts + 100.0).astype(np.float32)))
    holds.equal("note, 100 mm away", near.notes.get("mesh"), None)


def in_float16(patch):
    """What is read has half the precision."""
    made = Surface.__post_init__

    def rounded(self):
        object.__setattr__(self, "verts", np.asarray(self.verts).astype(np.float16))
        made(self)

    patch.setattr(Surface, "__post_init__", rounded)


@pytest.mark.parametrize(
    ("size", "place"),
    [(1.0, 0.0), (1e-3, 0.0), (1e3, 0.0), (1.0, 1000.0)],
    ids=["mm", "metres", "micrometres", "a metre away"],
)
@hard_case(
    "surfaces",
    "float32 in files of FreeSurfer, in any unit and a metre away",
    guard="float64 from there on",
    without=in_float16,
    fails=(AssertionError, ValueError),
)
def test_single_precision_in_a_file_is_round_off_in_the_measures(holds, tmp_path, size, place):
    """2^-24 of 60 mm is 4e-6 mm; over the square of the scale that is 1e-6 of curvature, and ten times that in K.
    All of it 16 times as much a metre away."""
    files = {name: tmp_path / f"lh.{name}" for name in ("white", "pial")}
    for name, surface in (("white", clean()[0].white), ("pial", clean()[0].pial)):
        write_surface(files[name], Surface(size * surface.verts + place, surface.faces))
    found, coarser = measure(read_cortex(**files)), 1 + place / 60
    holds.equal("read as", found.cortex.pial.verts.dtype, np.dtype(np.float64))
    hold_all(
        holds,
        found,
        unit=size,
        area=1e-7 * coarser,
        bent=1e-5 * coarser,
        lines=1e-4 * coarser,
        width=1e-5 * coarser,
        without=() if size == 1 else ("mean_local_gyrification_index",),
    )


@pytest.mark.parametrize("kind", FORMATS)
@hard_case("surfaces", "the same surface in every format", guard="float64 from there on", without=in_float16)
def test_every_format_holds_the_surface_to_single_precision(holds, tmp_path, kind):
    surface = clean()[0].pial
    write_surface(tmp_path / kind, surface)
    found = read_surface(tmp_path / kind)
    holds.equal(f"faces, {kind}", found.faces.tolist(), surface.faces.tolist())
    off = np.abs(found.verts - clean()[0].pial.verts).max()
    holds(f"vertices, {kind}", off, at_most=64 * 2.0**-24, unit="mm")


def in_mm(patch):
    """The mesh is not asked what is fine."""
    patch.setattr(curvatures, "LEAST_CURVATURE_SCALE_IN_EDGES", 0.0)


@pytest.mark.parametrize("size", [1e-3, 1e3], ids=["metres", "micrometres"])
@hard_case(
    "surfaces",
    "coordinates in metres or micrometres",
    guard="the scale follows the mesh",
    without=in_mm,
    peers="LaPy: curvature in units of the mean edge, not 1/mm (measured)",
    fails=(AssertionError, ValueError),
)
def test_another_unit_changes_lengths_only_and_is_told(holds, tmp_path, capsys, size):
    cortex, whole = clean()
    other = changed(cortex, lambda verts: size * verts)
    found = measure(other)
    hold_all(holds, found, unit=size, bent=1e-9, lines=1e-9, without=("mean_local_gyrification_index",))
    holds.equal("local gyrification, of a ball of 15 mm", found.scalars["mean_local_gyrification_index"], None)
    note = found.notes["curvature_scale"]
    holds.says("note", note, f" {found.parameters['curvature_scale_mm']:.3g}, ")
    named = re.search(r" (\S+)\.$", note)[1]
    radius = float(named)
    area = min(whole.scalars["area_white_mm2"], whole.scalars["area_pial_mm2"])
    holds("radius it names", abs(radius / (size * np.sqrt(area / (4 * np.pi))) - 1), at_most=5e-3)
    status, printed = analyzed(tmp_path, capsys, other)
    holds.equal("exit status", status, 0)
    holds.says("analyze", printed, f" {named}.", "[curvature_scale]")


def unwatched(patch):
    patch.setattr("morphofold.validators.check_positions", lambda verts, name: None)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@hard_case(
    "surfaces",
    "coordinates that are no numbers",
    guard="the check of what is read",
    without=unwatched,
    fails=(AssertionError, ValueError, RuntimeWarning),
)
def test_coordinates_that_are_no_numbers_are_refused(holds, value):
    cortex = clean()[0]
    verts = cortex.white.verts.copy()
    verts[77, 1] = value
    try:
        message = refusal(replace(cortex, white=Surface(verts, cortex.faces, "lh.white")))
    except ValueError as error:
        message = str(error)
    holds.says("refusal", message, "lh.white: ", " 1 of 2562 ", " 77:")
