"""The README's own example: as it stands (minutes, so marked slow), and with small surfaces that hardly fold."""

import functools
import re
from pathlib import Path

import pytest

import morphofold as mf

README = Path(__file__).resolve().parent.parent / "README.md"
pytestmark = pytest.mark.skipif(not README.exists(), reason="needs a checkout")
COARSE = ["geometry.portion=octant", "accuracy.edge=6", "growth.final=1.1", "output.stages=[]"]


@pytest.mark.parametrize(
    ("settings", "sample", "least", "most"),
    [
        pytest.param(COARSE, "fsaverage5", 0.99, 2.0, id="coarse"),
        pytest.param([], "S1", 1.5, 2.67, marks=pytest.mark.slow, id="as it stands"),
    ],
)
def test_the_example_of_the_readme_ends_in_two_numbers_and_a_page(
    tmp_path, monkeypatch, capsys, settings, sample, least, most
):
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.S)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(mf, "simulate", functools.partial(mf.simulate, settings=settings))
    exec(compile(code.replace('"S1"', f'"{sample}"'), "README.md", "exec"), {})
    model, brain, page = capsys.readouterr().out.split()
    assert least < float(model) < float(brain) < most
    assert sample != "S1" or float(brain) > 2.65  # 2.66, as two other studies of this surface found
    assert (tmp_path / page).stat().st_size > 1_000_000
