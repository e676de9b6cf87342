"""The law of folding: terms that do not change with size, and a family that obeys it exactly."""

import math

import numpy as np
import pytest
from made_measures import made_measures

from morphofold.analysis.gyrification.folding import shape_terms, shape_terms_of
from morphofold.errors import OutOfRange


def test_a_family_that_obeys_the_law_has_one_k():
    for exposed in (1e3, 2e4, 5e5):
        for thickness in (1.0, 2.5):
            total = 0.3 * exposed**1.25 / math.sqrt(thickness)
            assert shape_terms(total, exposed, thickness).k == pytest.approx(0.3, rel=1e-12)


def test_size_changes_size_alone_and_the_three_directions_are_at_right_angles():
    one, other = shape_terms(9e4, 4e4, 2.5), shape_terms(9e4 * 7**2, 4e4 * 7**2, 2.5 * 7)
    assert (other.k, other.log_k, other.shape) == pytest.approx((one.k, one.log_k, one.shape), rel=1e-12)
    assert other.size - one.size == pytest.approx(6 * math.log10(7), rel=1e-12)
    base = np.array([4.8, 4.5, 0.6])  # log A_total, log A_exposed, log T^2

    def terms(x):
        law = shape_terms(10 ** x[0], 10 ** x[1], 10 ** (x[2] / 2))
        return np.array([law.log_k, law.size, law.shape])

    directions = np.array([terms(base + step / 10) - terms(base) for step in np.eye(3)]).T
    across = directions @ directions.T
    np.testing.assert_allclose(across - np.diag(np.diag(across)), 0, atol=1e-9)


def test_terms_by_hand():
    """Areas 10^5 and 10^4 mm^2, 10 mm thick: logarithms 5, 4 and (of the square) 2."""
    law = shape_terms(1e5, 1e4, 10.0)
    assert (law.log_k, law.size, law.shape) == pytest.approx((0.5, 11.0, 6.0), abs=1e-12)
    assert law.k == pytest.approx(math.sqrt(10))


def test_measures_give_their_terms_or_none():
    m = made_measures()
    m.scalars.update(area_pial_mm2=9e4)
    law = shape_terms_of(m)
    assert (law.total, law.exposed, law.thickness) == (9e4, 9e4 / 1.25, 2.5)
    m.scalars.update(gyrification_index=None)
    assert shape_terms_of(m) is None


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [((0, 1, 1), "^total .* 0"), ((1, -1, 1), "^exposed .* -1"), ((1, 1, math.nan), "^thickness .* nan")],
)
def test_what_is_no_area_or_thickness_is_refused(numbers, expected):
    with pytest.raises(OutOfRange, match=expected):
        shape_terms(*numbers)
