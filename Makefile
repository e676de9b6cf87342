# For those who like make: everything is in run.py.
PYTHON ?= python3

.PHONY: setup demo docs test accuracy
setup demo docs test accuracy:
	$(PYTHON) run.py $@
