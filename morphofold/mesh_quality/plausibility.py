"""Warnings on a cortex that can be measured but may be the wrong input: its size, side, label and thickness."""

import numpy as np

from morphofold import geometry
from morphofold.arrays import Bools
from morphofold.surface import Cortex, PerVertex

# [mm^2] of white: human hemispheres have 60,000 to 130,000; smaller ones may be of an animal
LARGEST_WHITE_AREA_MM2 = 150_000.0
# of the radius of the sphere of equal area: mean x of a surface on one side (people 0.4)
LEAST_SIDE_OFFSET_IN_RADII = 0.15
LEAST_LABELLED_SHARE = 0.5  # of the vertices: FreeSurfer's cortex labels hold 0.9
LARGEST_CAPPED_SHARE = 0.02  # of the cortex: people have 0.002 at FreeSurfer's cap of 5 mm
# ratio to the measured thickness, and correlation with it; fsaverage has 1.00 and 0.9
LARGEST_THICKNESS_RATIO, LEAST_THICKNESS_CORRELATION = 2.0, 0.3


def remarks(cortex: Cortex) -> dict[str, str]:
    """Notes ``size`` (too large for a person), ``side`` (left named right) and ``cortex_label`` (less than half).

    For reconstructed cortices only: a simulated one may have any size and position.
    """
    if cortex.origin == "simulation":
        return {}
    notes = {}
    area = float(geometry.face_areas(cortex.white.verts, cortex.faces).sum())
    radius = (area / (4 * np.pi)) ** 0.5
    if cortex.units == "mm" and area > LARGEST_WHITE_AREA_MM2:
        notes["size"] = (
            f"White has an area of {area / 100:,.0f} cm^2, like a sphere of radius {radius:.0f} mm. Human hemispheres "
            "have 600 to 1,300 cm^2. Are the coordinates in mm?"
        )
    x, right = float(cortex.white.verts[:, 0].mean()), cortex.hemi == "rh"
    if LEAST_SIDE_OFFSET_IN_RADII * radius < abs(x) < radius and (x > 0) != right:
        notes["side"] = (
            f"The surfaces are named {cortex.hemi}, but their mean x is {x:+.3g} {cortex.units}, "
            f"{'left' if right else 'right'} of the middle. Is it the other hemisphere, or a coordinate frame other "
            "than surface RAS?"
        )
    if cortex.cortex is not None and (share := float(np.mean(cortex.cortex))) < LEAST_LABELLED_SHARE:
        notes["cortex_label"] = (
            f"The cortex label holds {share:.1%} of the vertices; FreeSurfer's labels hold about 90 %. Is it the label "
            "of the medial wall?"
        )
    return notes


def at_cap(thickness: PerVertex, cap: float | None) -> dict[str, str]:
    """Note ``thickness_cap``: much of the cortex is as thick as the cap allows."""
    known = thickness[np.isfinite(thickness)]
    if cap is None or not len(known) or (share := float(np.mean(known >= cap * (1 - 1e-9)))) <= LARGEST_CAPPED_SHARE:
        return {}
    return {
        "thickness_cap": f"{share:.1%} of the cortex is as thick as the cap of {cap:g} allows, so means are too low. "
        "Raise the cap, or leave it out."
    }


def against_file(given: PerVertex, measured: PerVertex) -> dict[str, str]:
    """Note ``thickness_unlike``: the thickness ``given`` with the surfaces, NaN where unknown, does not match them."""
    known: Bools = np.isfinite(given) & np.isfinite(measured)
    if not known.any():
        return {}
    one, other = given[known], measured[known]
    ratio = float(np.median(one) / np.median(other))
    varies = min(one.std() / one.mean(), other.std() / other.mean()) > 0.01  # else the correlation is that of noise
    r = float(np.corrcoef(one, other)[0, 1]) if varies else 1.0
    if 1 / LARGEST_THICKNESS_RATIO <= ratio <= LARGEST_THICKNESS_RATIO and r >= LEAST_THICKNESS_CORRELATION:
        return {}
    return {
        "thickness_unlike": f"The thickness file of the surfaces has {ratio:.3g} times the thickness measured between "
        f"them (medians), and the two correlate at {r:.2f}. Is the file in another unit, or of another surface?"
    }
