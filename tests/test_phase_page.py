"""The page of a sweep: numbers in their cells, theory where it belongs, nothing that a name could break."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from made_sweeps import GI, LENGTH, VARY, gi, made_sweep
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from morphofold.group.sweep import HINGES_PER_AREA, RunResult, SphereTheory, write_tables
from morphofold.group.sweep_grid import make_grid
from morphofold.group_pages import phase_plots
from morphofold.group_pages.phase_page import _drawn_surface, phase_report, section
from morphofold.io import write_surface
from morphofold.report import colours
from morphofold.shapes import icosphere
from morphofold.surface import Surface


def texts(figure):
    """What stands in the cells of a diagram, by their index."""
    return {tuple(map(int, text.get_position())): text.get_text() for text in figure.axes[0].texts}


def labels(texts):
    return [text.get_text() for text in texts]


def test_every_number_stands_in_its_cell_and_has_its_colour():
    phases = made_sweep()
    figure = phase_plots.diagram(phases, GI)
    (ax, *_), cells = figure.axes, texts(figure)
    low, high = phase_plots.limits_of(phases, GI)
    assert set(cells) == {(i, j) for i in range(3) for j in range(2)}
    for (i, j), text in cells.items():
        mean = 1.2 + 0.1 * i + 0.3 * j
        assert text.splitlines() == [f"{mean:.2f}", "± 0.14", "theory g 1.50"]  # sd of two: 0.2 / sqrt 2
        colour = colours.sequential()[round((mean - low) / (high - low) * 255)]
        np.testing.assert_array_equal(ax.images[0].get_array()[j, i], colour)
    assert labels(ax.get_xticklabels()) == ["1", "2", "3"]
    assert labels(ax.get_yticklabels()) == ["1.2", "1.8"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("cortex_thickness [mm]", "growth.final")


def test_the_limits_hold_all_values_and_begin_where_nothing_is_folded():
    phases = made_sweep()
    low, high = phase_plots.limits_of(phases, GI)
    assert low == 1.0
    assert high >= max(gi(run.point.grid_index, run.point.seed) for run in phases.runs)
    broken = made_sweep(broken=[(at, s) for at in phases.runs_at for s in (0, 1)])
    assert phase_plots.limits_of(broken, LENGTH) == (0.0, 1.0)
    for nearly in (1 - 1e-12, 1.0, 1 + 1e-12):  # a smooth sphere is one whatever its round-off
        smooth = made_sweep(**{GI.key: nearly})
        assert phase_plots.limits_of(smooth, GI) == (1.0, 2.0)
        assert texts(phase_plots.diagram(smooth, GI))[0, 0].splitlines()[:2] == ["1.00", "± 0.00"]


def test_failures_and_what_a_surface_does_not_have_are_said():
    phases = made_sweep(broken=[((0, 0), 0), ((0, 0), 1), ((1, 1), 0)])
    cells = texts(phase_plots.diagram(phases, GI))
    assert cells[0, 0].splitlines()[0] == "failed"
    assert cells[1, 1].splitlines()[:2] == [f"{gi((1, 1), 1):.2f}", "(1 of 2)"]
    assert phase_plots.cell(phases, (1, 1), GI.key).failed == 1
    smooth = made_sweep(**{phase_plots.WAVELENGTH_KEY: None})
    assert texts(phase_plots.diagram(smooth, LENGTH))[0, 0].splitlines() == ["–", "theory 10.0"]


@pytest.mark.parametrize(
    ("theory", "level"),
    [
        (SphereTheory(1.5, 1.6, 10.0), 0.5),  # half way from 1.2 to 1.8
        (SphereTheory(1.35, 1.6, 10.0), 0.25),
        (SphereTheory(1.1, 1.6, 10.0), None),  # all is folded
        (SphereTheory(2.5, math.nan, 10.0), None),
        (SphereTheory(reason="none"), None),
    ],
)
def test_the_line_of_theory_lies_where_final_growth_is_critical(theory, level):
    figure = phase_plots.diagram(made_sweep(theory=theory), GI)
    paths = [c.get_paths() for c in figure.axes[0].collections if type(c).__name__ == "QuadContourSet"]
    assert bool(paths) == bool(figure.legends) == (level is not None)
    if paths:
        line = np.concatenate([path.vertices for path in paths[0]])
        np.testing.assert_allclose(line[:, 1], level, atol=1e-9)
        np.testing.assert_allclose([line[:, 0].min(), line[:, 0].max()], [-0.5, 2.5])


def test_one_varied_key_is_a_curve_with_the_seeds_as_dots():
    phases = made_sweep(["growth.final=1.8,1.2,1.4"])
    ax = phase_plots.curve(phases, GI).axes[0]
    dots = [line for line in ax.lines if line.get_marker() == "o"]
    for line, final, i in zip(dots, (1.8, 1.2, 1.4), range(3)):
        np.testing.assert_allclose(line.get_xdata(), final)
        np.testing.assert_allclose(sorted(line.get_ydata()), [gi((i,), 0), gi((i,), 1)])
    mean = next(line for line in ax.lines if line.get_label() == "mean over seeds")
    np.testing.assert_allclose(mean.get_xdata(), [1.2, 1.4, 1.8])
    np.testing.assert_allclose(mean.get_ydata(), [1.3, 1.4, 1.2])
    boundary = next(line for line in ax.lines if "critical" in str(line.get_label()))
    np.testing.assert_allclose(boundary.get_xdata(), 1.5)
    wave = next(line for line in phase_plots.curve(phases, LENGTH).axes[0].lines if "theory" in str(line.get_label()))
    np.testing.assert_allclose(wave.get_ydata(), 10.0)


def test_between_words_which_have_no_order_nothing_is_joined():
    phases = made_sweep(["law=isotropic,tangential", "growth.final=1.2,1.8"])
    critical = {(0, 0): 1.35, (0, 1): 1.35, (1, 0): 1.5, (1, 1): 1.5}
    phases = replace(phases, theory={index: SphereTheory(g, 1.6, 10.0) for index, g in critical.items()})
    ends = [path.vertices for c in phase_plots.diagram(phases, GI).axes[0].collections for path in c.get_paths()]
    levels = {(float(v[:, 0].min()), float(v[:, 0].max()), round(float(v[:, 1].mean()), 6)) for v in ends if len(v)}
    assert levels == {(-0.5, 0.5, 0.25), (0.5, 1.5, 0.5)}  # a quarter and half of the way up
    assert all(np.ptp(v[:, 1]) < 1e-9 for v in ends if len(v))
    axes = phase_plots.curve(made_sweep(["law=isotropic,tangential"]), LENGTH).axes[0]
    assert labels(axes.get_xticklabels()) == ["isotropic", "tangential"]
    named = [line for line in axes.lines if not line.get_label().startswith("_")]
    assert len(named) == 2
    assert {line.get_linestyle() for line in named} == {"None"}


def test_a_run_that_is_not_healthy_is_marked_and_a_small_spread_is_no_spread_of_zero():
    phases = made_sweep()
    is_ill = lambda run: (run.point.grid_index, run.point.seed) == ((1, 0), 0)
    ill = tuple(replace(run, warnings=("it wobbles",)) if is_ill(run) else run for run in phases.runs)
    cells = texts(phase_plots.diagram(replace(phases, runs=ill), GI))
    assert {index for index, text in cells.items() if "*" in text} == {(1, 0)}
    assert cells[1, 0].splitlines()[0] == "1.30*"
    close = tuple(replace(run, measures={GI.key: 1.5 + 0.002 * run.point.seed}) for run in phases.runs)
    assert phase_plots.cell(replace(phases, runs=close), (0, 0), GI.key).lines == ["1.50", "± 0.001"]  # 0.002 / sqrt 2


def test_crossings_of_a_line_through_zero():
    assert phase_plots.crossings(np.array([0.0, 1.0, 3.0]), np.array([-1.0, 1.0, -1.0])) == [0.5, 2.0]
    assert phase_plots.crossings(np.array([0.0, 1.0]), np.array([math.nan, 1.0])) == []


@pytest.mark.slow
def test_further_keys_have_a_diagram_for_each_of_their_values(tmp_path):
    phases = made_sweep([*VARY, "mu_ratio=1,2", "law=isotropic,tangential"], seeds=1)
    assert len(phase_plots.slices(phases)) == 4
    assert texts(phase_plots.diagram(phases, GI, (1, 1)))[2, 1].splitlines()[0] == f"{gi((2, 1, 1, 1), 0):.2f}"
    page = phase_report(phases, tmp_path).read_text()
    assert len(list((tmp_path / "figures").glob(f"{GI.key}-*.png"))) == 4
    assert "at mu_ratio = 2, law = isotropic" in page


def test_what_no_run_has_has_no_diagram_and_seeds_alone_have_none(tmp_path):
    nothing = made_sweep(**{phase_plots.WAVELENGTH_KEY: None}, theory=SphereTheory(reason="of spheres"))
    page = phase_report(nothing, tmp_path).read_text()
    assert not (tmp_path / "figures" / f"{phase_plots.WAVELENGTH_KEY}.png").exists()
    assert (tmp_path / "figures" / f"{GI.key}.png").exists()
    assert "critical growth" not in re.sub(r"base64,[A-Za-z0-9+/=]*", "", page)  # of which theory says nothing
    (tmp_path / "seeds").mkdir()
    phase_report(made_sweep([], seeds=3), tmp_path / "seeds")
    assert list((tmp_path / "seeds" / "figures").iterdir()) == []


@pytest.mark.parametrize(
    ("scene", "measures"),
    [
        ("demo", [GI.key, phase_plots.WAVELENGTH_KEY, HINGES_PER_AREA]),
        ("patch", [phase_plots.AREA_RATIO.key, phase_plots.WAVELENGTH_KEY, HINGES_PER_AREA]),
        ("strip", [phase_plots.AREA_RATIO.key]),
    ],
)
def test_a_page_shows_what_means_something_of_its_shape(scene, measures):
    phases = made_sweep(["growth.final=1.2,1.5"], scene=scene, **{phase_plots.AREA_RATIO.key: 1.7})
    assert [quantity.key for quantity in phase_plots.plotted_measures(phases)] == measures


def folded_strip(length=20.0, thick=2.0, height=3.0, n=400):
    """Pial and white surface of a strip one brick deep, a wave of three folds."""
    x = np.linspace(0, length, n + 1)
    z = height * np.sin(3 * 2 * np.pi * x / length)
    k = np.arange(n)
    faces = np.concatenate([np.stack([k, k + 1, k + n + 2], 1), np.stack([k, k + n + 2, k + n + 1], 1)])
    pial, white = (
        np.concatenate([np.stack([x, np.full(n + 1, y), z - down], 1) for y in (0.0, 0.5)]) for down in (0.0, thick)
    )
    return Surface(pial, faces), Surface(white, faces)


def test_a_strip_is_seen_from_the_side(tmp_path):
    """Its section has the area between both lines, all of it seen from above, and its height is that of its folds."""
    pial, white = folded_strip()
    side = section(pial, white)
    first, second = (side.verts[side.faces[:, k]] - side.verts[side.faces[:, 0]] for k in (1, 2))
    areas = np.cross(first, second)[:, 2] / 2
    assert areas.min() > 0
    assert areas.sum() == pytest.approx(20.0 * 2.0)  # the lines are 2 mm apart, straight down
    np.testing.assert_allclose(np.ptp(side.verts, axis=0), [20.0, 3.0 + 3.0 + 2.0, 0.0], atol=1e-3)
    for name, surface in (("lh.pial", pial), ("lh.white", white)):
        write_surface(tmp_path / name, surface)
    (point,) = make_grid("strip", ["growth.final=1.2"]).points
    surface = _drawn_surface(RunResult(point, pial=tmp_path / "lh.pial"))
    np.testing.assert_allclose(np.ptp(surface.verts, axis=0), np.ptp(side.verts, axis=0), atol=1e-4)


def test_surfaces_stand_in_the_order_of_the_cells_and_are_as_large_as_the_ruler_says():
    phases = made_sweep()
    ball = Surface(*icosphere(3, 30.0))
    cells = {index: ball if index == (1, 0) else "failed" for index in phases.runs_at}
    ax = phase_plots.thumbnails(phases, cells, "lateral", 60.0).axes[0]
    (image,) = ax.images
    assert image.get_extent() == [0.5, 1.5, -0.5, 0.5]
    assert [text.get_position() for text in ax.texts] == [index for index in cells if index != (1, 0)]
    inside = (image.get_array() < 250).any(axis=2).any(axis=0)
    assert inside.mean() == pytest.approx(0.94, abs=0.01)
    assert labels(ax.get_xticklabels()) == ["1", "2", "3"]
    (bar,) = (artist for artist in ax.artists if isinstance(artist, AnchoredSizeBar))
    mm = float(bar.txt_label.get_text().removesuffix(" mm"))
    assert bar.size_bar.get_children()[0].get_width() == pytest.approx(0.94 * mm / 60)


def test_a_page_escapes_names_and_holds_no_number_that_is_none(tmp_path):
    unstable = SphereTheory(reason="the smooth sphere <is> stable")
    phases = made_sweep(broken=[((0, 0), 0)], theory=unstable, **{phase_plots.WAVELENGTH_KEY: None})
    phases = replace(phases, grid=replace(phases.grid, name="<script>alert(1)</script>"))
    page = phase_report(phases, tmp_path).read_text()
    plain = re.sub(r"base64,[A-Za-z0-9+/=]*", "", page)
    assert "<script" not in plain
    for name in ("&lt;script&gt;", "&lt;at once&gt;", "&lt;is&gt;"):
        assert name in plain
    assert not re.search(r"\bnan\b", plain, re.IGNORECASE)
    assert "script-src" not in plain
    assert "http" not in plain.replace("http-equiv", "").replace("http://www.w3.org/2000/svg", "")


@pytest.mark.slow
def test_the_same_sweep_gives_the_same_bytes(tmp_path):
    write_surface(tmp_path / "lh.pial", Surface(*icosphere(3, 30.0)))
    phases = made_sweep(broken=[((0, 0), 0)], pial=tmp_path / "lh.pial")
    written = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        phase_report(phases, tmp_path / name)
        write_tables(phases, tmp_path / name)
        files = (p for p in (tmp_path / name).rglob("*") if p.is_file())
        written.append({p.relative_to(tmp_path / name).as_posix(): p.read_bytes() for p in files})
    assert {"report.html", "measures.tsv", "runs.tsv", "theory.tsv", "figures/surfaces.png"} <= set(written[0])
    assert written[0] == written[1]
