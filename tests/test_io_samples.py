"""The samples' known facts, and that each travels with its origin and licence."""

import numpy as np
import pytest
from made_surfaces import area

from morphofold.io import read_cortex, read_surface, sample_path


@pytest.mark.parametrize(
    ("hemi", "white", "pial", "thickness", "cortex"),
    [("lh", 66661.8, 76345.4, 2.3351, 9354), ("rh", 66619.2, 76671.8, 2.3502, 9361)],
)
def test_fsaverage5_has_the_known_counts_areas_and_thickness(hemi, white, pial, thickness, cortex):
    c = read_cortex(sample_path("fsaverage5"), hemi)
    assert (c.n_vertices, len(c.faces), c.hemi) == (10242, 20480, hemi)
    assert (c.name, c.origin) == ("fsaverage5", "FreeSurfer")
    assert area(c.white) == pytest.approx(white, abs=0.05)
    assert area(c.pial) == pytest.approx(pial, abs=0.05)
    assert set(c.maps) == {"thickness", "curv", "sulc", "area"}
    t = c.maps["thickness"]
    assert t[t > 0].mean() == pytest.approx(thickness, abs=5e-5)
    assert c.cortex.sum() == cortex
    assert c.inflated is not None
    assert len(c.regions.names) == 36
    assert {"unknown", "corpuscallosum", "precentral"} <= set(c.regions.names)
    precentral = c.regions.labels == c.regions.names.index("precentral")
    assert t[precentral].mean() == pytest.approx({"lh": 2.445, "rh": 2.432}[hemi], abs=5e-4)
    assert len(c.files) == 10


def test_the_individual_hemisphere_has_the_known_counts_and_areas():
    c = read_cortex(sample_path("S1"))
    assert (c.n_vertices, len(c.faces), c.hemi, c.name, c.origin) == (152893, 305782, "lh", "S1", "files")
    assert area(c.white) == pytest.approx(91471.5, abs=0.05)
    assert area(c.pial) == pytest.approx(119337.2, abs=0.05)
    assert (c.maps, c.regions, c.cortex) == ({}, None, None)


@pytest.mark.parametrize("name", ["fsaverage5/surf/lh.white", "S1/lh.pial.surf.gii"])
def test_samples_are_closed_spheres_with_outward_faces(name):
    surface = read_surface(sample_path(name))
    assert len(surface.verts) - len(surface.faces) / 2 == 2
    a, b, c = np.moveaxis(surface.verts[surface.faces], 1, 0)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0


def test_every_sample_travels_with_its_origin_and_licence():
    table = sample_path("README.md").read_text()
    for folder in (p for p in sample_path().iterdir() if p.is_dir() and not p.name.startswith(("_", "."))):
        made_elsewhere = f"`{folder.name}/`" in table
        assert made_elsewhere == bool(list(folder.glob("LICENSE*"))), folder.name
        assert (folder / "README.md").is_file() or not made_elsewhere, folder.name
    assert "`fsaverage5/`" in table
    assert "`S1/`" in table


def test_the_licence_of_fsaverage5_begins_with_the_words_it_asks_for():
    text = sample_path("fsaverage5/LICENSE.FreeSurfer.txt").read_text()
    assert text.startswith("All or portions of this licensed product")
    readme = " ".join(sample_path("fsaverage5/README.md").read_text().split())
    assert "average of 40 people" in readme
    assert "obtained under license from The General Hospital Corporation" in readme


def test_a_sample_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(FileNotFoundError, match=r"\bbert\b.*\bS1, .*\bfsaverage5\b"):
        sample_path("bert")
