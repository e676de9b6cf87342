"""The README's own example: as it stands (minutes, so marked slow), and with a body that hardly folds."""

import functools
import re
from pathlib import Path

import pytest

import morphofold as mf

README = Path(__file__).resolve().parent.parent / "README.md"
pytestmark = pytest.mark.skipif(not README.exists(), reason="needs a checkout")
COARSE = ["geometry.portion=octant", "accuracy.edge=6", "growth.final=1.1", "output.stages=[]"]


@pytest.mark.parametrize(
    ("settings", "least"),
    [pytest.param(COARSE, 0.99, id="coarse"), pytest.param([], 1.5, marks=pytest.mark.slow, id="as it stands")],
)
def test_the_readme_example_ends_in_two_numbers_and_a_page(tmp_path, monkeypatch, capsys, settings, least):
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.S)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(mf, "simulate", functools.partial(mf.simulate, settings=settings))
    exec(compile(code, "README.md", "exec"), {})
    model, brain, page = capsys.readouterr().out.split()
    assert least < float(model) < 2.2
    assert float(brain) == pytest.approx(2.66, abs=0.01)  # as two other studies of this surface found
    assert (tmp_path / page).stat().st_size > 1_000_000
