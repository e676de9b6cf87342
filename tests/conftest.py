"""Fixtures that every test file may use."""

import numpy as np
import pytest


@pytest.fixture
def rng():
    """A fresh random generator with a fixed seed."""
    return np.random.default_rng(20150901)
