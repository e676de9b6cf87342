"""What public objects print: what they are, in a line, with counts and units and without arrays."""

import re

import numpy as np

import morphofold as mf
from morphofold import analysis
from morphofold.analysis.graph.hinge_statistics import hinge_shapes
from morphofold.comparison import thickness_cloud
from morphofold.group.permuted_model import Model
from morphofold.shapes import icosphere
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.scene.scene_files import load_scene
from morphofold.spheres.resampling import Resampling
from morphofold.studies.folded_ball import folded_ball
from morphofold.surface import Surface


def test_an_object_says_what_it_is_in_a_line_without_arrays():
    ball = folded_ball(2500)
    m = mf.measure(ball)
    small, large = (Surface(*icosphere(level, radius=100.0)) for level in (2, 3))
    scene = load_scene("demo", ["geometry.portion=octant", "accuracy.edge=6"])
    body = build_body(scene)
    parts = [
        (ball, f"{ball.n_vertices:,} vertices"),
        (m, f"{len(m.hinges)} hinges"),
        (analysis.curvature(ball.pial.verts, ball.faces, 8.0), "8 mm"),
        (analysis.crest_lines(ball.pial.verts, ball.faces), "gyral lines"),
        (analysis.gyral_thickness(ball), f"median {m.scalars['median_gyral_thickness_mm']:.3g} mm"),
        (analysis.gyral_thickness(Surface(*icosphere(3, radius=50.0))), "no median"),
        (hinge_shapes(m), "hinges with three arms"),
        (thickness_cloud(m), "points"),
        (mf.compare({"a": m, "b": m}), "'a', 'b'"),
        (Resampling(small, large), "162 to 642 vertices"),
        (Model(np.column_stack([np.ones(9), np.arange(9.0)]), np.array([0.0, 1.0])), "7 degrees of freedom"),
        (body, f"{len(body.X):,} nodes"),
        (Dynamics.of(scene, body, build_effects(scene)), "contact"),
    ]
    for value, part in parts:
        line = repr(value)
        assert re.match(rf"{type(value).__name__}\b", line), line
        assert part in line, line
        assert "array" not in line
        assert "\n" not in line
        assert len(line) < 300, line
