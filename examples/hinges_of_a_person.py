"""Gyral hinges of a person.

The crests of gyri form a net. A hinge is where three or more of them meet. Nearly all hinges have three arms (3-hinge
gyri).
"""

from collections import Counter

import numpy as np
from PIL import Image

import morphofold as mf
from morphofold.report.pictures.gyral_net import net_figure, net_row

person = mf.measure(mf.read_cortex(mf.sample_path("S1"), hemi="lh"), only=["n_hinges", "hinges"])
Image.fromarray(net_figure([net_row(person, "S1")])).save("hinges_of_a_person.png")

counted = [hinge for hinge in person.hinges if hinge["confidence"] >= 0.25]  # others are doubtful
degrees = Counter(hinge["degree"] for hinge in counted)
print(f"{len(counted)} hinges: {dict(degrees)} by the number of their arms")
measured = float(np.mean([hinge["degree"] for hinge in counted]))
known = 3.0  # 3-hinges, as in most published counts
print(f"arms of a hinge: {measured:.2f} on average")
