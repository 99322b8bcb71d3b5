"""Campaigns drawn from the prior hide as many things as the prior of sets says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from bayes_inertia.diagnosis.hypothesis_table import log_prior_of_set
from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.diagnosis.random_signals import NAMELESS

MEMBERS, DRAWS = 25, 4000


@pytest.fixture
def module(analysis):
    """`prior_campaigns.py`."""
    return analysis("naming.prior_campaigns")


def shares_of_sets():
    """Prior of none, one, two and three things: single sets times how many there are."""
    sets = [1.0, 25.0, 25.0 * 24.0 / 2.0, 25.0 * 24.0 * 23.0 / 6.0]
    each = np.exp([log_prior_of_set(size, MEMBERS) for size in range(4)])
    return np.array(sets) * each / np.sum(np.array(sets) * each)


def test_as_many_are_hidden_as_the_prior_says(module):
    rng = np.random.default_rng(7)
    drawn = [module.number_of_hidden(rng, MEMBERS) for _ in range(DRAWS)]
    counts = np.bincount(drawn, minlength=4)
    right = stats.chisquare(counts, DRAWS * shares_of_sets()).pvalue
    assert right > 1e-4
    # The control: one thing more in a fifth instead of a tenth of the campaigns.
    wrong = shares_of_sets() * np.array([1.0, 1.0, 2.0, 4.0])
    assert stats.chisquare(counts, DRAWS * wrong / wrong.sum()).pvalue < 1e-4


@pytest.mark.slow
def test_campaigns_are_drawn_anew_and_equal_for_equal_seeds(module):
    """Campaigns that hide nothing are taken: they need no fit to be drawn."""
    drawn = {}
    for key in range(40):
        seed = np.random.SeedSequence(3, spawn_key=(key,))
        _, chosen = np.random.SeedSequence(3, spawn_key=(key,)).spawn(2)
        if module.number_of_hidden(np.random.default_rng(chosen), MEMBERS) == 0:
            drawn[key] = module.prior_campaign(seed, tachometers=True)
        if len(drawn) == 2:
            break
    first, second = drawn.values()
    key = next(iter(drawn))
    again = module.prior_campaign(np.random.SeedSequence(3, spawn_key=(key,)), tachometers=True)
    assert first.hidden == second.hidden == ()
    np.testing.assert_array_equal(first.campaign.slews[0].rate, again.campaign.slews[0].rate)
    assert not np.array_equal(first.campaign.slews[0].rate, second.campaign.slews[0].rate)


@pytest.fixture(scope="module")
def weighed(analysis):
    """What a table weighs at a flight with tachometers."""
    module = analysis("naming.prior_campaigns")
    flight = module.draw(np.random.SeedSequence(4), (), {}, True)
    return module._Weighed(flight.campaign, np.random.default_rng(4))


@pytest.mark.slow
def test_sizes_are_those_that_the_table_weighs(weighed):
    """A lag has one direction: |z| times a size that is even in its logarithm."""
    (lag,) = (m for m in weighed.linear.members if m.name == "wheel_command_lag")
    drawn = np.log([weighed._amplitudes(lag)[0] for _ in range(DRAWS)])
    stated = lag.sizes[: LIMITS.fixed_sizes]
    rng = np.random.default_rng(5)
    normal = np.log(np.abs(rng.normal(size=DRAWS)))
    wanted = normal + rng.uniform(*np.log(stated[[0, -1]]), DRAWS)
    assert stats.ks_2samp(drawn, wanted).pvalue > 1e-4
    # The control: the smallest size a fifth of a decade larger.
    wrong = normal + rng.uniform(np.log(stated[0]) + 0.5, np.log(stated[-1]), DRAWS)
    assert stats.ks_2samp(drawn, wrong).pvalue < 1e-4


@pytest.mark.slow
def test_a_shape_without_a_name_that_repeats_is_that_of_every_slew(weighed):
    shapes = [weighed.without_name() for _ in range(200)]
    assert {shape.source for shape in shapes} == set(NAMELESS) - {"star tracker"}
    first = weighed.campaign.slews[0]
    for alike in (True, False):
        shape = next(s for s in shapes if s.alike is alike and s.formula is None)
        signal = shape.signal(shape.kind, weighed.campaign, np.random.default_rng(6))
        since = np.linspace(0.0, first.time[-1], 50)
        values = [signal.along(slew.start + since) for slew in weighed.campaign.slews]
        apart = np.max(np.abs(values[0] - values[1])) / np.max(np.abs(values))
        # Slews differ in length by some percent.
        assert (apart < 0.3) == alike
