"""The ideal test of a random effect, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

LEVEL = 0.01
# Binomial error of a power from 20,000 draws, and that of the level's limit beside it.
ERROR = 4.0 * np.sqrt(0.25 / 20_000 * 2.0)


@pytest.fixture
def ideal(analysis):
    """`random_power.py`."""
    return analysis("naming.ideal_power")


def closed_form(count, size):
    """Power for `count` equal eigenvalues of one: sums of squares are chi^2."""
    limit = stats.chi2.isf(LEVEL, count)
    return stats.chi2.sf(limit / (1.0 + size**2), count)


@pytest.mark.parametrize("count", [1, 12])
@pytest.mark.parametrize("size", [0.5, 1.5, 4.0])
def test_power_is_that_of_a_chi_square_test_where_all_directions_are_alike(ideal, count, size):
    assert ideal.ideal_power(np.ones(count), size, LEVEL) == pytest.approx(
        closed_form(count, size), abs=ERROR
    )


def test_a_power_without_the_level_would_be_seen(ideal):
    wrong = stats.chi2.sf(stats.chi2.isf(0.05, 12) / 3.25, 12)
    assert abs(ideal.ideal_power(np.ones(12), 1.5, LEVEL) - wrong) > ERROR


def test_a_size_found_has_its_power_and_directions_that_show_nothing_do_not_count(ideal):
    powers = np.array([40.0, 3.0, 1.0, 0.2, 0.0, 0.0])
    size = ideal.ideal_size(powers, 0.99, LEVEL)
    assert ideal.ideal_power(powers, size, LEVEL) == pytest.approx(0.99, abs=2e-3)
    assert ideal.ideal_size(powers[:4], 0.99, LEVEL) == pytest.approx(size, rel=0.02)
