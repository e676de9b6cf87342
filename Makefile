# For those who like make: everything is in run.py.
PYTHON ?= python3

.PHONY: setup demo docs test
setup demo docs test:
	$(PYTHON) run.py $@
