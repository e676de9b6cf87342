"""Every example runs by itself in an empty folder, draws its picture, and finds the number that is known."""

import runpy
from pathlib import Path

import pytest
from PIL import Image

from morphofold.studies.pages import gallery

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
pytestmark = pytest.mark.skipif(not EXAMPLES.is_dir(), reason="needs a checkout")
#: by how much the number may be off what is known, relative; most are discretisation errors
TOLERANCE = {
    "wrinkles_of_a_strip": 0.01,  # elements of 1 mm
    "figure_5_in_six_pictures": 0.003,  # its bulk modulus is not infinite
    "crease_at_a_notch": 0.03,  # the edge of 0.5 mm, and 0.5 T is not 0
    "ellipsoid_folds": 0.03,  # the bound of health on the drift of volume
    "growth_by_a_map": 0.02,  # vertices on a coarse mesh, and stress pushes volume about
    "person_unfolded": 0.01,
    "theory_of_wrinkles": 0.02,  # the formula is that of the limit
    "stress_through_the_cortex": 1e-10,
    "price_of_a_run": 0,
    "curvature_of_a_torus": 0.005,
    "hinges_of_a_person": 0.05,
    "hinges_of_a_known_net": 0,
    "local_gyrification": 0.002,
    "gyral_thickness_by_region": 0.03,  # FreeSurfer's file is a mean over 40 people, not of these surfaces
    "areas_beside_freesurfer": 0.001,  # the table has whole mm2
    "wavelength_of_a_bumpy_sphere": 0,
    "folding_across_scales": 0.3,  # people are past the law: docs/laws.md
    "model_beside_brain": 1e-9,
    "group_difference": 0.1,  # its edge is tested with less certainty
    "nilearn_plots": 1e-6,
    "material_of_your_own": 1e-9,
    "effect_of_your_own": 0.01,  # what the load bends beyond linear elasticity
    "measure_of_your_own": 0.005,
}
QUICK = (
    "theory_of_wrinkles stress_through_the_cortex curvature_of_a_torus areas_beside_freesurfer nilearn_plots "
    "wavelength_of_a_bumpy_sphere material_of_your_own measure_of_your_own person_unfolded"
).split()


def test_every_example_is_in_the_gallery_and_short():
    names = " ".join(gallery.ORDER.values()).split()
    assert sorted(names) == sorted(TOLERANCE) == sorted(path.stem for path in EXAMPLES.glob("*.py"))
    folder = EXAMPLES.parent / "docs" / "gallery"
    for name in names:
        assert len((EXAMPLES / f"{name}.py").read_text("utf-8").splitlines()) < 65
        assert Image.open(folder / f"{name}.png").width >= 300
    text = (EXAMPLES / "README.md").read_text("utf-8")
    assert text == gallery.gallery_page(EXAMPLES, "../docs/gallery/", ".py")


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in TOLERANCE]
)
def test_an_example_finds_what_is_known(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    result = runpy.run_path(str(EXAMPLES / f"{name}.py"))
    assert result["measured"] == pytest.approx(result["known"], rel=max(TOLERANCE[name], 1e-15))
    assert Image.open(tmp_path / f"{name}.png").width >= 300
    printed = capsys.readouterr().out
    if name in QUICK:
        assert printed == (EXAMPLES.parent / "docs" / "gallery" / f"{name}.txt").read_text("utf-8")


def test_notebooks_of_examples_are_valid():
    nbformat = pytest.importorskip("nbformat")
    files = dict(gallery.generated(EXAMPLES.parent))
    notebooks = [content for path, content in files.items() if path.endswith(".ipynb")]
    assert len(notebooks) == len(TOLERANCE)
    for content in notebooks:
        nbformat.validate(nbformat.reads(content, as_version=4))
