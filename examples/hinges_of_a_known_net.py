"""Hinges of a net that is known.

Ridges along the edges of a dodecahedron, pushed out of a sphere: twenty places where three crests meet. A measure
that finds hinges in brains should find these twenty and no more.
"""

from PIL import Image

import morphofold as mf
from morphofold.report.pictures.gyral_net import net_figure, net_row
from morphofold.studies.folded_ball import folded_ball
from morphofold.studies.known_shapes import regular_net

ball = folded_ball(40_000, regular_net("dodecahedron"))
found = mf.measure(ball, only=["n_hinges"])
Image.fromarray(net_figure([net_row(found, "dodecahedron")])).save("hinges_of_a_known_net.png")

measured, known = found.scalars["n_hinges"], 20
print(f"{measured} hinges, of {known}")
