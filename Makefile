# Everything is installed into .venv by the first command that needs it; needs git, Python 3.11+ and pip.
PYTHON ?= python3
export UV_PYTHON_DOWNLOADS = never

.PHONY: demo test lint clean

demo: .venv/.ok
	.venv/bin/morphofold demo -o demo

test: .venv/.ok
	.venv/bin/ruff check .
	.venv/bin/mypy
	.venv/bin/python -m pytest

.venv/.ok: pyproject.toml constraints.txt
	$(PYTHON) -m pip install --quiet --disable-pip-version-check --target .tools uv
	.tools/bin/uv venv --quiet --allow-existing --python $(PYTHON) .venv
	.tools/bin/uv pip install --quiet --python .venv/bin/python -c constraints.txt -e ".[test]"
	touch $@

clean:
	rm -rf .venv .tools
