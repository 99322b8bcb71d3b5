"""Effects without a fixed shape against several steps of a search."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_inertia.diagnosis import needless_steps, stochastic_contest
from bayes_inertia.diagnosis.prior_of_sets import cost_of_further
from bayes_inertia.diagnosis.result import Step
from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.diagnosis.stochastic_candidates import StochasticCandidate
from bayes_inertia.physics.effects import RateRandomWalk, StarTrackerLowFrequency, TorqueNoise

SHIFT, FRICTION, LOW = "star_tracker_shift", "wheel_friction", "star_tracker_low_frequency"
TORQUE, WALK = "torque_noise", "rate_random_walk"
CANDIDATES = 24
# What a second effect must bring: with "no name" and the random effects there are four more.
COST = cost_of_further(1, 1, CANDIDATES + 4)


def _fit(*names):
    effects = tuple(SimpleNamespace(name=name) for name in names)
    model = SimpleNamespace(effects=effects)
    return SimpleNamespace(model=model, discount=np.ones((1, 3)), objective=0.0)


@pytest.fixture
def settled(monkeypatch):
    """The contest of two steps worth 20 and 10 with a random effect of this log evidence."""
    monkeypatch.setattr(stochastic_contest, "with_stochastic", lambda *_: _fit(LOW))

    def settle(evidence, others=()):
        none, shift, both = _fit(), _fit(SHIFT), _fit(SHIFT, FRICTION)
        steps = [Step(SHIFT, none, shift, 20.0), Step(FRICTION, shift, both, 10.0)]
        nameless = StochasticCandidate("", "star tracker", -5.0)
        low = StochasticCandidate(LOW, "star tracker", evidence)
        behind = [StochasticCandidate(name, "", evidence - gap) for name, gap in others]
        rounds = [
            SimpleNamespace(
                estimate=fit, stochastic=at, threshold=1e-3, candidates=(None,) * CANDIDATES
            )
            for fit, at in (
                (none, (low, *behind, nameless)),
                (shift, (nameless,)),
                (both, (nameless,)),
            )
        ]
        effects = (StarTrackerLowFrequency(), TorqueNoise(), RateRandomWalk())
        return stochastic_contest.contest(steps, both, rounds, effects, Rules())

    return settle


@pytest.mark.parametrize("lead", [1.0, 2.9])
def test_steps_that_one_effect_hardly_beats_stay_beside_it_together(settled, lead):
    (step,) = settled(30.0 - COST + lead).steps
    assert step.added == LOW
    pair = step.alternatives[0]
    assert (pair.effect, pair.beside) == (SHIFT, (FRICTION,))
    assert pair.log_bayes_factor == pytest.approx(step.log_bayes_factor - lead)
    assert [e.name for e in pair.estimate.model.effects] == [SHIFT, FRICTION]


def test_steps_that_one_effect_beats_clearly_give_way(settled):
    outcome = settled(30.0 - COST + 3.1)
    (step,) = outcome.steps
    assert step.added == LOW
    assert step.alternatives == ()
    assert [e.name for e in outcome.displaced] == [SHIFT, FRICTION]


@pytest.mark.parametrize("lead", [-0.1, 3.1])
def test_an_effect_with_which_no_motion_can_be_computed_does_not_count(settled, monkeypatch, lead):
    endless = _fit(LOW)
    endless.objective = np.nan
    monkeypatch.setattr(stochastic_contest, "with_stochastic", lambda *_: endless)
    first, second = settled(30.0 - COST + lead).steps
    assert (first.added, second.added) == (SHIFT, FRICTION)
    assert first.alternatives == ()


@pytest.mark.parametrize("lead", [-0.1, -2.9])
def test_one_effect_that_hardly_loses_to_several_stands_beside_them(settled, lead):
    first, second = settled(30.0 - COST + lead).steps
    assert (first.added, second.added) == (SHIFT, FRICTION)
    (low,) = first.alternatives
    assert (low.effect, low.replaces) == (LOW, (FRICTION,))
    assert low.log_bayes_factor == pytest.approx(20.0 + lead)
    assert second.alternatives == ()


def test_further_random_effects_that_hardly_lose_stand_beside_the_first_of_them(settled):
    first, _ = settled(30.0 - COST - 1.0, [(TORQUE, 1.5), (WALK, 1.9)]).steps
    assert [a.effect for a in first.alternatives] == [LOW, TORQUE]
    assert [a.log_bayes_factor for a in first.alternatives] == pytest.approx([19.0, 17.5])
    assert first.alternatives[1].replaces == (FRICTION,)
    first, _ = settled(30.0 - COST - 1.0, [(TORQUE, 2.1)]).steps
    assert [a.effect for a in first.alternatives] == [LOW]


def test_one_effect_that_clearly_loses_to_several_is_not_listed(settled):
    assert all(step.alternatives == () for step in settled(30.0 - COST - 3.1).steps)


def test_a_random_effect_where_the_search_added_nothing_is_named_alone(monkeypatch):
    monkeypatch.setattr(stochastic_contest, "with_stochastic", lambda *_: _fit(LOW))
    none = _fit()
    low = StochasticCandidate(LOW, "star tracker", 9.0)
    nameless = StochasticCandidate("", "star tracker", -5.0)
    rounds = [
        SimpleNamespace(
            estimate=none, stochastic=(low, nameless), threshold=1e-3, candidates=(None,) * 9
        )
    ]
    outcome = stochastic_contest.contest([], none, rounds, (StarTrackerLowFrequency(),), Rules())
    assert [step.added for step in outcome.steps] == [LOW]
    assert outcome.displaced == ()


@pytest.mark.parametrize(
    ("evidence", "kept", "refits"),
    [
        # Of the fits with the effect after no step, after one, and after both.
        ((999.0, 1000.0, 1000.0), [LOW], 2),
        ((900.0, 999.0, 1000.0), [SHIFT, LOW], 2),
        ((900.0, 950.0, 1000.0), [SHIFT, FRICTION, LOW], 2),
        ((1000.0, 800.0, 1000.0), [SHIFT, FRICTION, LOW], 1),
    ],
)
def test_steps_before_a_random_effect_stay_if_the_fit_needs_them(
    monkeypatch, evidence, kept, refits
):
    """Without the last step first: a fit that misses that by far is not tried without more."""
    none, shift, both = _fit(), _fit(SHIFT), _fit(SHIFT, FRICTION)
    fits, asked = {0: _fit(LOW), 1: _fit(SHIFT, LOW), 2: _fit(SHIFT, FRICTION, LOW)}, []

    def fitted(before, *_):
        asked.append(len(before.model.effects))
        return fits[asked[-1]]

    monkeypatch.setattr(stochastic_contest, "with_stochastic", fitted)
    monkeypatch.setattr(needless_steps, "without_effects", lambda _fit, _names, *at: fitted(*at))
    monkeypatch.setattr(
        needless_steps,
        "log_evidence_of_fit",
        lambda fit: evidence[len(fit.model.effects) - 1],
    )
    steps = [Step(SHIFT, none, shift, 20.0), Step(FRICTION, shift, both, 10.0)]
    at = (
        StochasticCandidate(LOW, "star tracker", 500.0),
        StochasticCandidate("", "star tracker", -5.0),
    )
    # First-order evidence prefers the effect after both steps.
    last = (replace(at[0], log_bayes_factor=600.0), at[1])
    rounds = [
        SimpleNamespace(estimate=fit, stochastic=s, threshold=1e-3, candidates=(None,) * CANDIDATES)
        for fit, s in ((none, at), (shift, at), (both, last))
    ]
    effects = (StarTrackerLowFrequency(),)
    outcome = stochastic_contest.contest(steps, both, rounds, effects, Rules())
    assert [step.added for step in outcome.steps] == kept
    # The first fit is that after both steps.
    assert len(asked) == 1 + refits
    assert [e.name for e in outcome.displaced] == [SHIFT, FRICTION][len(kept) - 1 :]
