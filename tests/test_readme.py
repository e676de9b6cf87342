"""The README's own example: as it stands (minutes, so marked slow), and with small surfaces that hardly fold."""

import functools
import re
from pathlib import Path

import pytest

import morphofold as mf

README = Path(__file__).resolve().parent.parent / "README.md"
pytestmark = pytest.mark.skipif(not README.exists(), reason="needs a checkout")
COARSE = ["geometry.portion=octant", "accuracy.edge=6", "growth.final=1.1", "output.stages=[]"]


REAL = pytest.param([], "S1", (1.5, 2.65, 2.67), marks=pytest.mark.slow)  # 2.66, as two other studies of it found


@pytest.mark.parametrize(("settings", "sample", "bounds"), [(COARSE, "fsaverage5", (0.99, 1.2, 2.0)), REAL])
def test_the_readme_example_ends_in_two_numbers_and_a_page(tmp_path, monkeypatch, capsys, settings, sample, bounds):
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.S)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(mf, "simulate", functools.partial(mf.simulate, settings=settings))
    exec(compile(code.replace('"S1"', f'"{sample}"'), "README.md", "exec"), {})
    model, brain, page = capsys.readouterr().out.split()
    assert bounds[0] < float(model) < bounds[1] < float(brain) < bounds[2]
    assert (tmp_path / page).stat().st_size > 1_000_000
