"""The README's own example, as it stands; a minute or two, so marked slow."""

import re
from pathlib import Path

import pytest

README = Path(__file__).resolve().parents[2] / "README.md"
pytestmark = [pytest.mark.slow, pytest.mark.skipif(not README.exists(), reason="needs a checkout")]


def test_the_readme_example_ends_in_two_numbers_and_a_page(tmp_path, monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.S)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})
    model, brain, page = capsys.readouterr().out.split()
    assert 1.5 < float(model) < 2.2
    assert float(brain) == pytest.approx(2.66, abs=0.01)               # as two other studies of this surface found
    assert (tmp_path / page).stat().st_size > 1_000_000
