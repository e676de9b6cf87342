"""Cortical thickness over the parts that shape and depth make."""

import numpy as np
import pytest

from morphofold.analysis import measure
from morphofold.analysis.region_tables import DEPTHS, thickness_by_shape
from morphofold.geometry import vertex_areas
from morphofold.shapes import icosphere
from morphofold.studies.folded_ball import folded_ball
from morphofold.surface import Cortex, Surface

VERTS, FACES = icosphere(5)
SHELL = Cortex(Surface(48 * VERTS, FACES), Surface(50 * VERTS, FACES))


def row_of(rows, part):
    return next(row for row in rows if row["part"] == part)


def test_means_are_by_area_and_parts_by_the_shape_index():
    """Thickness is 1 in the south and 3 in the north; the north is concave."""
    north = VERTS[:, 2] > 0
    maps = {"cortical_thickness": np.where(north, 3.0, 1.0), "shape_index": np.where(north, -0.8, 0.7)}
    rows = thickness_by_shape(SHELL, maps)
    assert [row["part"] for row in rows] == ["concave", "saddle", "convex"]
    assert row_of(rows, "concave")["thickness_mm"] == pytest.approx(3.0)
    assert row_of(rows, "convex")["thickness_mm"] == pytest.approx(1.0)
    assert row_of(rows, "saddle")["thickness_mm"] is None
    assert row_of(rows, "saddle")["n_vertices"] == 0
    area = 0.5 * sum(vertex_areas(s.verts, FACES) for s in (SHELL.white, SHELL.pial))
    assert row_of(rows, "concave")["area_mid_mm2"] == pytest.approx(area[north].sum())
    for row in rows:
        assert row["column_mm"] is None or row["column_mm"] == pytest.approx(2.0)


def test_crown_wall_and_fundus_have_their_shares_of_the_area_in_the_order_of_depth():
    depth = 50 - 50 * VERTS[:, 2]
    maps = {"cortical_thickness": depth, "sulcal_depth": depth}
    rows = thickness_by_shape(SHELL, maps)
    whole = 0.5 * sum(vertex_areas(s.verts, FACES).sum() for s in (SHELL.white, SHELL.pial))
    for part, (low, high) in DEPTHS.items():
        row = row_of(rows, part)
        assert row["area_mid_mm2"] / whole == pytest.approx(high - low, abs=0.003)
        assert row["thickness_mm"] == pytest.approx(50 * (low + high), abs=0.3)  # area is even in z
        assert row["thickness_sd_mm"] == pytest.approx(100 * (high - low) / np.sqrt(12), rel=0.02)


def test_vertices_of_equal_depth_stay_together(rng):
    """Half of the body lies on its hull; which vertices are its crown must not depend on their numbers."""
    depth = np.maximum(-50 * VERTS[:, 2], 0.0) + rng.uniform(0, 1e-9, len(VERTS))
    rows = thickness_by_shape(SHELL, {"cortical_thickness": np.ones(len(VERTS)), "sulcal_depth": depth})
    assert row_of(rows, "crown")["n_vertices"] == np.count_nonzero(depth < 1e-6)
    none = thickness_by_shape(SHELL, {"cortical_thickness": np.full(len(VERTS), np.nan), "sulcal_depth": depth})
    assert [row["n_vertices"] for row in none] == [0, 0, 0]


def test_unknown_values_have_no_weight():
    depth = 50 - 50 * VERTS[:, 2]
    thickness = np.where(VERTS[:, 0] > 0, np.nan, 2.0)
    rows = thickness_by_shape(
        SHELL, {"cortical_thickness": thickness, "sulcal_depth": depth, "shape_index": depth / 50}
    )
    known = [row["thickness_mm"] for row in rows if row["n_vertices"]]
    assert known == pytest.approx([2.0] * len(known))
    assert sum(row["n_vertices"] for row in rows if row["by"] == "shape") == np.isfinite(thickness).sum()


def test_measured_parts_of_a_folded_ball_cover_its_cortex():
    m = measure(folded_ball(6000), only=["shapes", "cortical_thickness"])
    shapes = [row for row in m.shapes if row["by"] == "shape"]
    assert sum(row["n_vertices"] for row in shapes) == 6000
    assert row_of(m.shapes, "crown")["n_vertices"] > 0
    frame = m.to_frame("shapes")
    assert frame["thickness_mm"].between(1.0, 2.5).all()
