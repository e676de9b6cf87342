"""What public objects print: what they are, in a line, with counts and units and without arrays."""

import re

import numpy as np

import morphofold as mf
from morphofold import analysis
from morphofold.analysis.graph.hinge_shapes import hinge_shapes
from morphofold.comparison import thickness_cloud
from morphofold.forecasts import MeshChoice
from morphofold.group.permutations import Model
from morphofold.shapes import icosphere
from morphofold.shapes.folded_ball import folded_ball
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.scene.scene_files import load_scene
from morphofold.spheres.resampling import Resampling, places
from morphofold.surface import Surface


def objects():
    """Public objects, each with a part that its line must have."""
    ball = folded_ball(2500)
    verts, faces = ball.pial.verts, ball.faces
    m = mf.measure(ball)
    small, large = (Surface(*icosphere(level, radius=100.0)) for level in (2, 3))
    z = large.verts[:, 2]
    spectrum = analysis.power_spectrum(large.verts, large.faces, z, last=5)
    scene = load_scene("demo", ["geometry.portion=octant", "accuracy.level=draft"])
    body, price = build_body(scene), mf.forecast(scene)
    design = np.column_stack([np.ones(9), np.arange(9.0)])
    return [
        (ball, f"{len(verts):,} vertices"),
        (m, f"{len(m.hinges)} hinges"),
        (analysis.curvature(verts, faces, 8.0), "8 mm"),
        (analysis.crest_lines(verts, faces), "gyral lines"),
        (analysis.gyral_thickness(ball), f"median {m.scalars['median_gyral_thickness_mm']:.3g} mm"),
        (analysis.gyral_thickness(Surface(*icosphere(3, radius=50.0))), "no median"),
        (hinge_shapes(m), "hinges with three arms"),
        (spectrum, "degrees 0 to 5"),
        (analysis.spin_test(z, large.verts[:, 0], large, spins=20), "20 spins"),
        (thickness_cloud(m), "points"),
        (mf.compare({"a": m, "b": m}), "'a', 'b'"),
        (Resampling(small, large), "162 to 642 vertices"),
        (places(small.verts, small.faces, large.verts), "642 points"),
        (Model(design, np.array([0.0, 1.0])), "7 degrees of freedom"),
        (body, f"{len(body.X):,} nodes"),
        (Dynamics.of(scene, body, build_effects(scene)), "contact"),
        (price, f"{price.elements:,} elements"),
        (MeshChoice(scene, price), "'demo'"),
    ]


def test_an_object_says_what_it_is_in_a_line_without_arrays():
    for value, part in objects():
        line = repr(value)
        assert re.match(rf"{type(value).__name__}\b", line), line
        assert part in line, line
        assert "array" not in line
        assert "\n" not in line
        assert len(line) < 300, line
