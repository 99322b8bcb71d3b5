"""Which effects of a library can be candidates."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.diagnosis.candidates import candidate_effects
from bayes_inertia.diagnosis.score_test import ScoreTests
from bayes_inertia.errors import EffectError
from bayes_inertia.physics.effects import ConstantTorque, EachSlew, FlexibleMode
from bayes_inertia.physics.small_campaign import small_campaign


def test_candidates_need_names_of_their_own():
    clean = small_campaign()
    with pytest.raises(EffectError, match="2 candidates have this name"):
        candidate_effects(clean, (ConstantTorque(), ConstantTorque(sigma=1e-6)))
    with pytest.raises(EffectError, match="give a FlexibleMode itself"):
        candidate_effects(clean, (EachSlew.of(FlexibleMode(), clean),))


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
    # As often as not a campaign without the effect shows the wrong sign.
    assert tests.threshold(0.01, np.random.default_rng(1), 20000) == pytest.approx(0.01, rel=0.1)
