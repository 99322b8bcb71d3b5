"""Priors and the flat parameter space."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from bayes_inertia.campaign.hardware import InertiaPrior
from bayes_inertia.errors import EffectError, SettingsError
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.physics.effects.constant_torque import ConstantTorque
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import (
    LogNormal,
    Normal,
    ParameterSpace,
    log_prior,
    prior_residual,
    scalar,
    vector,
)

SPACE = ParameterSpace(
    (
        ("", scalar("K1", unit="", prior=Normal(1.0, 0.03), null=1.0)),
        ("a", vector("torque", "xyz", unit="N m", prior=Normal(0.0, 1e-5))),
        ("a", scalar("lag", unit="s", prior=Normal(0.0, 0.5, lower=0.0))),
        ("b", scalar("frequency", unit="Hz", prior=LogNormal(0.5, 0.4))),
        ("b", scalar("share", unit="", prior=Normal(0.3, 0.4, lower=0.0, upper=1.0))),
    )
)


def test_names_units_and_splitting_agree():
    assert SPACE.names == (
        "K1",
        "a.torque_x",
        "a.torque_y",
        "a.torque_z",
        "a.lag",
        "b.frequency",
        "b.share",
    )
    assert SPACE.units == ("", "N m", "N m", "N m", "s", "Hz", "")
    flat = jnp.arange(7.0)
    values = SPACE.split(flat)
    assert values[""]["K1"] == 0.0
    assert values["a"]["torque"].tolist() == [1.0, 2.0, 3.0]
    assert values["a"]["lag"].shape == ()
    assert values["b"]["share"] == 6.0
    assert flat[SPACE.slice_of("a")].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert flat[SPACE.slice_of("b")].tolist() == [5.0, 6.0]
    assert flat[SPACE.slice_of("nobody")].size == 0
    assert SPACE.nulls.tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_draws_follow_the_stated_distributions():
    drawn = SPACE.draw(np.random.default_rng(5), 4000)
    for column, prior, name in zip(drawn.T, SPACE.priors, SPACE.names, strict=True):
        assert stats.kstest(column, prior.distribution.cdf).pvalue > 1e-3 / SPACE.size, name
        spread = np.std((column - column.mean()) ** 2) / np.sqrt(len(column))
        assert abs(column.var() - prior.sd**2) < 4.0 * spread, name
    assert np.all((drawn >= SPACE.lower) & (drawn <= SPACE.upper))
    assert SPACE.draw(np.random.default_rng(5), 0).shape == (0, SPACE.size)


def test_log_prior_is_scipys_density_up_to_one_constant():
    drawn = SPACE.draw(np.random.default_rng(6), 200)
    exact = sum(p.distribution.logpdf(x) for p, x in zip(SPACE.priors, drawn.T, strict=True))
    ours = np.asarray(log_prior(SPACE.constants(), jnp.asarray(drawn)))
    np.testing.assert_allclose(ours - ours[0], exact - exact[0], atol=1e-9)


@pytest.mark.parametrize(
    ("index", "value"), [(4, -1e-9), (5, 0.0), (5, -1.0), (6, 1.0 + 1e-9), (6, -1e-9)]
)
def test_outside_the_support_the_density_is_zero(index, value):
    flat = SPACE.mean
    flat[index] = value
    assert np.isfinite(log_prior(SPACE.constants(), jnp.asarray(SPACE.mean)))
    assert np.isneginf(log_prior(SPACE.constants(), jnp.asarray(flat)))
    assert np.all(np.isfinite(prior_residual(SPACE.constants(), jnp.asarray(flat))))


def test_every_prior_draw_of_a_model_is_physical_even_when_the_prior_is_nearly_flat(flown):
    # A plate: the triangle inequality is nearly an equality, so that half of the plain draws are
    # unphysical.
    plate = InertiaPrior(np.diag([3.9, 2.0, 2.0]), 0.05, 0.1)
    model = Model(replace(flown.campaign, inertia=plate))
    plain = model.space.draw(np.random.default_rng(1), 500)
    assert 0.1 < np.mean(np.asarray(inertia_tensor.is_physical(plain[:, :6]))) < 0.8
    drawn = model.draw_prior(np.random.default_rng(1), 500)
    moments = inertia_tensor.principal_moments(drawn[:, :6])
    assert np.all(moments[:, 0] > 0.0)
    assert np.all(moments[:, 0] + moments[:, 1] > moments[:, 2])


def test_what_slews_about_one_axis_cannot_see_keeps_its_prior_sd(flying, setup_type):
    """Slews about x from rest with wheels at rest see neither Jyy nor Jzz nor K2 nor K3."""
    setup = setup_type(
        turns=((0.6, 0.0, 0.0),) * 3,
        start_rate=(0.0, 0.0, 0.0),
        start_momentum=0.0,
        product_sigma=1e-4,
    )
    fitted = estimate(Model(flying(8, setup).campaign), starts=1)
    kept = fitted.sd / fitted.model.space.sd
    seen = dict(zip(fitted.model.space.names, kept, strict=True))
    assert seen["Jxx"] < 0.2
    assert seen["K1"] < 0.2
    for name in ("Jyy", "Jzz", "K2", "K3", "Jyz"):
        assert 0.9 < seen[name] < 1.0 + 1e-6, name


@pytest.mark.parametrize(
    ("kind", "numbers", "words"),
    [
        (Normal, (0.0, 0.0), "scale is 0.0"),
        (Normal, (0.0, -1.0), "scale is -1.0"),
        (Normal, (0.0, np.inf), "scale is inf"),
        (Normal, (np.nan, 1.0), "mean is nan"),
        (Normal, (0.0, 1.0, 2.0, 2.0), "between 2.0 and 2.0"),
        (Normal, (0.0, 1.0, np.nan), "between nan and inf"),
        (LogNormal, (0.0, 1.0), "median is 0.0"),
        (LogNormal, (1.0, np.nan), "scale is nan"),
        (LogNormal, (1.0, 1.0, -2.0, 0.0), "between -2.0 and 0.0"),
    ],
)
def test_numbers_that_make_no_prior_are_refused_where_it_is_made(kind, numbers, words):
    with pytest.raises(SettingsError, match=f"^{kind.__name__} prior: .*{words}"):
        kind(*numbers)


def test_a_parameter_says_what_is_no_prior_and_no_component():
    with pytest.raises(SettingsError, match="priors of a: an int is no Normal or LogNormal"):
        scalar("a", unit="m", prior=3)
    with pytest.raises(SettingsError, match="components of a: an int is no list"):
        vector("a", 3, unit="m", prior=Normal(0.0, 1.0))


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf])
def test_a_prior_scale_that_is_no_factor_is_refused_by_the_model(factor, campaign):
    with pytest.raises(EffectError, match=f"^constant_torque, .*prior_scale: {factor}"):
        Model(campaign, (ConstantTorque(prior_scale=factor),))


def test_a_size_of_zero_is_refused_by_the_model(campaign):
    with pytest.raises(EffectError, match=r"^constant_torque, .*the scale is 0\.0"):
        Model(campaign, (ConstantTorque(sigma=0.0),))


@pytest.mark.parametrize(
    "prior",
    [
        LogNormal(1.0, 1.0, upper=2.0),
        LogNormal(1.0, 0.5, lower=1.5),
        LogNormal(3e-6, 0.1, lower=2.9e-6, upper=3.2e-6),
        LogNormal(1.0, 1.0, lower=1e-9, upper=1e9),
    ],
)
def test_limits_of_a_log_normal_prior_count_in_draws_and_sd(prior):
    space = ParameterSpace((("a", scalar("size", unit="", prior=prior)),))
    drawn = space.draw(np.random.default_rng(3), 4000)
    assert np.isfinite(log_prior(space.constants(), drawn)).all()
    assert prior.sd == pytest.approx(drawn.std(), rel=0.1)
    gaussian = stats.truncnorm(
        *(np.log(np.array([max(prior.lower, 1e-300), prior.upper]) / prior.median) / prior.scale)
    )
    whitened = np.log(drawn[:, 0] / prior.median) / prior.scale
    assert stats.kstest(whitened, gaussian.cdf).pvalue > 1e-3
    assert stats.kstest(drawn[:, 0], prior.distribution.cdf).pvalue > 1e-3
    middle = prior.distribution.ppf([0.3, 0.6])
    exact = np.diff(prior.distribution.logpdf(middle))
    assert exact == pytest.approx(np.diff(log_prior(space.constants(), middle[:, None])))
