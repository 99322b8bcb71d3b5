"""Effects with parameters of their own in each slew."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_inertia.errors import EffectError
from bayes_inertia.physics.check_effect import check_effect
from bayes_inertia.physics.effects import (
    ConstantTorque,
    EachSlew,
    WheelCommandLag,
    by_name,
)
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.named_effects import effects_named
from bayes_inertia.physics.prediction import predict_all
from bayes_inertia.physics.slew_input import idle_slew


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    "inner",
    [ConstantTorque(), pytest.param(WheelCommandLag(), marks=pytest.mark.long)],
    ids=lambda e: e.name,
)
def test_an_effect_of_its_own_in_each_slew_is_the_effect_where_all_slews_agree(campaign, inner):
    apart = EachSlew.of(inner, campaign)
    check_effect(apart, campaign)
    one, many = Model(campaign, (inner,)), Model(campaign, (apart,))
    value = 0.5 * one.space.sd[9:]
    same = predict_all(one.structure, jnp.asarray([*one.space.mean[:9], *value]), *nothing(one))
    each = np.tile(value, len(campaign.slews))
    repeated = predict_all(
        many.structure, jnp.asarray([*one.space.mean[:9], *each]), *nothing(many)
    )
    rate = one.structure.place("rate")
    np.testing.assert_allclose(repeated[rate], same[rate], rtol=0, atol=1e-14)
    each[: len(value)] = 0.0
    first_without = predict_all(
        many.structure, jnp.asarray([*one.space.mean[:9], *each]), *nothing(many)
    )
    assert np.abs(first_without[rate][0] - same[rate][0]).max() > 1e-9
    np.testing.assert_allclose(first_without[rate][1:], same[rate][1:], rtol=0, atol=1e-14)


def test_of_a_slew_to_come_an_effect_of_each_slew_claims_nothing(campaign):
    """It did as in the last slew, silently; and a change that stays was not there afterwards."""
    apart = EachSlew.of(ConstantTorque(), campaign)
    p = {"torque": jnp.arange(1.0, 1.0 + 3 * len(campaign.slews))}
    context = idle_slew([0.0, 1.0]).context
    last, next_one = (context._replace(index=jnp.asarray(len(campaign.slews) - k)) for k in (1, 0))
    np.testing.assert_array_equal(apart.body_torque(p, last, 0.0, None), p["torque"][-3:])
    np.testing.assert_array_equal(apart.body_torque(p, next_one, 0.0, None), np.zeros(3))
    assert apart.afterwards() == ConstantTorque()
    change = by_name(["inertia_change"])[0]
    assert EachSlew.of(change, campaign).afterwards() == change.afterwards() != change


def nothing(model: Model) -> tuple:
    return jnp.zeros((model.n_slews, model.structure.n_local)), jnp.zeros(3), model.data


def test_an_effect_of_its_own_in_each_slew_keeps_its_wider_prior(campaign):
    wide = ConstantTorque(prior_scale=8.0)
    one, each = (Model(campaign, (e,)).space.sd[9:] for e in (wide, EachSlew.of(wide, campaign)))
    np.testing.assert_array_equal(each, np.tile(one, len(campaign.slews)))
    with pytest.raises(EffectError, match="other coefficients in each slew anyway"):
        EachSlew.of(by_name(["torque_noise"])[0], campaign)


def test_a_change_from_a_slew_that_is_not_there_is_refused(campaign):
    (late,) = effects_named(["inertia_change:from_slew=3"])
    with pytest.raises(EffectError, match="inertia_change: there is no slew 3"):
        Model(campaign, (late,))
