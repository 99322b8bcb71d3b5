"""Probabilities of answers: what was weighed, what it costs to choose, and that they add up."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayes_inertia.diagnosis.hypotheses import (
    Level,
    hypotheses,
    log_evidence_of,
    with_shapes,
)
from bayes_inertia.diagnosis.prior_of_sets import cost_of_further, log_prior_of_set
from bayes_inertia.diagnosis.result import AlternativeEffect, NamelessShape, Step
from bayes_inertia.diagnosis.rules import Rules

RAW = Rules(evidence_temperature=1.0)
FIT = SimpleNamespace()


def _probabilities(*arguments, rules=RAW):
    rows = hypotheses(*arguments, rules)
    assert sum(row.probability for row in rows) == pytest.approx(1.0)
    assert [r.probability for r in rows] == sorted((r.probability for r in rows), reverse=True)
    return {row.effects or row.kind: row.probability for row in rows}


def test_without_evidence_nothing_is_the_most_probable_answer():
    silent = Level((), 0.0, dict.fromkeys("abcdefghijkl", -1.0), ())
    told = _probabilities([silent], [], 0.4, 12)
    assert max(told, key=told.get) == "nothing"
    assert told["nothing"] > 0.5
    # Four candidates less than the twelve are listed one by one.
    assert "others" in told


def test_the_priors_of_all_sets_add_up():
    total = sum(np.exp(log_prior_of_set(k, 12)) * _choices(12, k) for k in range(13))
    assert total == pytest.approx(1.0, abs=1e-9)


def _choices(n: int, k: int) -> float:
    return float(np.prod([(n - i) / (i + 1) for i in range(k)]))


def test_a_name_and_its_rivals_share_by_evidence():
    first = Level((), 0.0, {"lag": 40.0, "friction": 38.0, "bias": 5.0}, ())
    second = Level(("lag",), 40.0, {"friction": -1.0, "bias": -2.0}, ())
    beside = AlternativeEffect("friction", FIT, 38.0, 0.9)
    told = _probabilities([first, second], [Step("lag", FIT, FIT, 40.0, (beside,))], 0.3, 25)
    assert told[("lag",)] / told[("friction",)] == pytest.approx(np.exp(2.0))
    assert told[("lag",)] > 0.8
    assert told["nothing"] < 1e-10


@pytest.mark.parametrize(("lead", "nameless_wins"), [(-8.0, False), (8.0, True)])
def test_what_has_no_name_competes_with_the_names(lead, nameless_wins):
    level = Level((), 0.0, {"lag": 40.0}, ())
    (first, last) = with_shapes(
        [level, Level(("lag",), 40.0, {}, ())], [[NamelessShape("body torque", 40.0 + lead)]]
    )
    assert last.nameless == ()
    told = _probabilities([first, last], [Step("lag", FIT, FIT, 40.0)], 0.3, 25)
    assert (told["nameless"] > 0.9) == nameless_wins
    assert (told[("lag",)] > 0.9) != nameless_wins


def test_residuals_that_are_not_noise_speak_against_all_names():
    levels = [Level((), 0.0, {"lag": 40.0}, ()), Level(("lag",), 40.0, {}, ())]
    steps = [Step("lag", FIT, FIT, 40.0)]
    fine, poor = (_probabilities(levels, steps, p, 25) for p in (0.4, 1e-12))
    assert fine["nameless"] < 0.05
    assert poor["nameless"] > 0.9
    assert log_evidence_of(0.0) < 1e3


def test_a_temperature_makes_statements_less_sure_and_keeps_their_order():
    levels = [Level((), 0.0, {"lag": 12.0, "friction": 6.0}, ())]
    sure = _probabilities(levels, [], 0.4, 25)
    calm = _probabilities(levels, [], 0.4, 25, rules=Rules(evidence_temperature=3.0))
    assert calm[("lag",)] < sure[("lag",)]
    assert calm[("lag",)] / calm[("friction",)] == pytest.approx(np.exp(2.0))


def test_each_further_effect_must_bring_more_than_it_costs():
    """A set and a larger one are even where the larger one's evidence exceeds by the cost."""
    cost = cost_of_further(1, 2, 13)
    levels = [
        Level((), 0.0, {"lag": 40.0}, ()),
        Level(("lag",), 40.0, {"friction": 40.0 + cost}, ()),
        Level(("lag", "friction"), 80.0 + cost, {"bias": -40.0}, ()),
    ]
    told = _probabilities(levels, [Step("lag", FIT, FIT, 40.0)], 0.4, 12)
    assert told[("lag", "friction", "bias")] == pytest.approx(told[("lag",)])


def test_one_effect_in_place_of_several_is_a_set_of_its_own():
    """Neither with the effects that it makes needless, nor two of several without each other."""
    levels = [
        Level((), 0.0, {"shift": 20.0, "friction": 3.0, "low": 24.0}, ()),
        Level(("shift",), 20.0, {"friction": 6.0, "low": 1.0}, ()),
        Level(("shift", "friction"), 26.0, {"low": -1.0}, ()),
    ]
    low = AlternativeEffect("low", FIT, 19.0, 0.0, replaces=("friction",))
    pair = [Step("shift", FIT, FIT, 20.0, (low,)), Step("friction", FIT, FIT, 6.0)]
    both = AlternativeEffect("shift", FIT, 23.0, 0.0, beside=("friction",))
    alone = [Step("low", FIT, FIT, 24.0, (both,), stochastic=True)]
    told = [_probabilities(levels, steps, 0.4, 12) for steps in (pair, alone)]
    cost = cost_of_further(1, 1, 13)
    for rows in told:
        assert rows[("low",)] / rows[("shift", "friction")] == pytest.approx(np.exp(cost - 2.0))
