# For those who like make: everything is in run.py.
PYTHON ?= python3

.PHONY: setup demo test
setup demo test:
	$(PYTHON) run.py $@
