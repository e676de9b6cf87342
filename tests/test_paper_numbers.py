"""Figs. 3 and 4 of the paper as the studies draw them are equations 11 to 13; other tests of studies are in studies."""

import numpy as np
import pytest

from morphofold.studies.paper import paper_theory


def curves(ax):
    return [np.array(line.get_data()) for line in ax.get_lines() if not line.get_label().startswith("_")]


def test_figure_3a_is_equation_11():
    ((g, c),) = curves(paper_theory.fig3().axes[0])
    np.testing.assert_allclose(c**3, 1 + g**3 * ((50 / 48) ** 3 - 1), rtol=1e-12)
    assert (g[0], g[-1]) == (1, 2)


def test_figure_3b_ends_in_the_stress_of_a_free_surface_the_highest_in_the_thinnest_cortex():
    """sigma_r = 0 there, so sigma_theta/mu = lambda^2 - lambda^-4 with lambda = c/(g C)."""
    stresses = curves(paper_theory.fig3().axes[1])
    for T, (x, sigma) in zip((1, 2, 3), stresses, strict=True):
        C_bar = 50 / (50 - T)
        stretch = (1 + 8 * (C_bar**3 - 1)) ** (1 / 3) / (2 * C_bar)
        assert sigma[-1] == pytest.approx(stretch**2 - stretch**-4, rel=1e-12)
        assert (x[0], x[-1]) == (0, 1)
        assert max(sigma) < 0
    thin, middle, thick = (np.interp(np.linspace(0, 1, 50), *curve) for curve in stresses)
    assert (thin < middle).all()
    assert (middle < thick).all()


def test_figure_4_is_equations_12_and_13():
    (ax,) = paper_theory.fig4().axes
    isotropic, tangential = curves(ax)
    C, g = isotropic[:, np.isfinite(isotropic[1])]
    np.testing.assert_allclose(g**3 * (1 - 7 / 12 * C**3), 1, rtol=1e-9)
    assert C[-1] == pytest.approx((12 / 7) ** (1 / 3), abs=1e-3)
    C, g = tangential
    np.testing.assert_allclose(g**3 * C**3 - 2.4 * g**2 * (C**3 - 1), 2.4, rtol=1e-12)
    text = " ".join(text.get_text() for text in ax.texts)
    assert "1.34" in text  # the limits that the paper names
    assert "1.20" in text
