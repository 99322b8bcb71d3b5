"""Which effects of a library can be candidates."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from bayes_inertia.diagnosis.candidates import candidate_effects
from bayes_inertia.diagnosis.random_signals import candidate_kinds
from bayes_inertia.diagnosis.score_test import ScoreTests
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.errors import EffectError
from bayes_inertia.physics.effects import STOCHASTIC, ConstantTorque, EachSlew, FlexibleMode
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.physics.stochastic_effect import StochasticEffect


def test_candidates_need_names_of_their_own():
    clean = small_campaign()
    with pytest.raises(EffectError, match="2 candidates have this name"):
        candidate_effects(clean, (ConstantTorque(), ConstantTorque(sigma=1e-6)))
    with pytest.raises(EffectError, match="give a FlexibleMode itself"):
        candidate_effects(clean, (EachSlew.of(FlexibleMode(), clean),))


def test_candidates_are_effects_in_lists_and_random_ones_act_where_they_are_looked_for():
    @dataclass(frozen=True)
    class Blur(StochasticEffect):
        name: ClassVar[str] = "blur"

        def direction_output(self, p, slew, trajectory, direction_S):
            return direction_S

    fixed, random = candidate_kinds((e for e in STOCHASTIC[:1]), [ConstantTorque()])
    assert (fixed, random) == ((ConstantTorque(),), (STOCHASTIC[0],))
    assert candidate_kinds(["constant_torque"], [STOCHASTIC[0].name]) == (fixed, random)
    for wrong in ({"library": [3]}, {"stochastic": "rate_bias"}, {"library": [Blur()]}):
        with pytest.raises(EffectError, match="give"):
            diagnose(small_campaign(), **wrong)


def test_a_column_without_numbers_is_no_column(rigid_library):
    clean = small_campaign()
    empty = replace(
        clean,
        slews=tuple(replace(s, position_N=np.full((len(s.time), 3), np.nan)) for s in clean.slews),
    )
    effects = candidate_effects(empty, rigid_library)
    assert "gravity_gradient" not in {e.name for e in effects.linear}
    assert "gravity_gradient" in dict(effects.skipped)


def test_a_one_sided_candidate_of_the_wrong_sign_has_no_significance():
    one = np.array([0])
    tests = ScoreTests(("lag",), (one,), (True,), np.array([-30.0]), np.array([[100.0]]), {})
    assert tests.p_value(0, tests.score(0)) == pytest.approx(1.0, abs=1e-12)
    right = replace(tests, gradient=-tests.gradient)
    assert right.p_value(0, right.score(0)) == pytest.approx(0.5 * 0.0027, rel=1e-2)
    # Of what the campaign cannot see all p-values are one; a bound beside them counts alone.
    unseen = replace(tests, matrix=np.zeros((1, 1)))
    guarded = unseen.threshold(0.02, np.random.default_rng(1), 200, further=1)
    assert guarded == pytest.approx(0.02, abs=1e-3)
    # As often as not a campaign without the effect shows the wrong sign.
    assert tests.threshold(0.01, np.random.default_rng(1), 20000) == pytest.approx(0.01, rel=0.1)
