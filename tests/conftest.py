"""Fixtures that every test file may use."""

import os

if "PYTEST_XDIST_WORKER" in os.environ:         # several processes share the cores: before numpy is imported
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np
import pytest


@pytest.fixture
def rng():
    """A fresh random generator with a fixed seed."""
    return np.random.default_rng(20150901)
