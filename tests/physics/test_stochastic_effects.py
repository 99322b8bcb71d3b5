"""Effects without a fixed shape: their bases, their contract, and that broken ones are refused."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from support.effects import thrown_body

from bayes_inertia.campaign.slew import Slew, between_fix_groups
from bayes_inertia.errors import EffectError
from bayes_inertia.physics.channel_noise import ChannelNoise, NoiseModel
from bayes_inertia.physics.check_effect import check_effect
from bayes_inertia.physics.effects import LIBRARY, STOCHASTIC, by_name
from bayes_inertia.physics.effects.rate_bias import RateBiasSlewDrift
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.random_basis import (
    hat_functions,
    ornstein_uhlenbeck_covariance,
    ornstein_uhlenbeck_mean_root,
    ornstein_uhlenbeck_root,
    random_walk_covariance,
    random_walk_root,
)
from bayes_inertia.physics.small_campaign import small_campaign

ONLY_WHERE_COMMANDS_DRIVE = (
    "tachometer_noise_walk",
    "tachometer_remainder",
    "wheel_torque_noise",
    "wheel_torque_remainder",
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect",
    [
        pytest.param(e, id=e.name, marks=() if e.name == "rate_random_walk" else pytest.mark.long)
        for e in STOCHASTIC
    ],
)
def test_every_stochastic_effect_keeps_the_contract(effect, campaign):
    fingerprint = check_effect(effect, campaign).fingerprint
    assert min(fingerprint["commanded"].values()) > 0.0
    idle = max(fingerprint["measured"].values()) == 0.0
    assert idle == (effect.name in ONLY_WHERE_COMMANDS_DRIVE)


def test_stochastic_effects_are_fitted_by_name_and_not_searched_for():
    names = [effect.name for effect in STOCHASTIC]
    assert [effect.name for effect in by_name(names)] == names
    assert not set(names) & {effect.name for effect in LIBRARY}


@pytest.mark.parametrize("effect", STOCHASTIC, ids=lambda e: e.name)
def test_default_priors_scale_with_the_campaign(effect, campaign):
    """In units of the noise, the torque J w / T and the duration, priors of any body are alike."""
    units = []
    for flown in (campaign, thrown_body()):
        rate, duration, inertia = flown.scale_of_motion()
        sigma = max(flown.rate_sensor.sigma)
        units.append(
            {
                "rad/s": sigma,
                "rad/s^1.5": sigma / duration**0.5,
                "rad/s^2": sigma / duration,
                "N m": inertia * rate / duration,
                "s": duration,
            }
        )
    thrown = {p.name: p for p in effect.parameters(thrown_body())}
    for parameter in effect.parameters(campaign):
        if parameter.name in thrown and parameter.unit in units[0]:
            medians = [parameter.priors[0].median, thrown[parameter.name].priors[0].median]
            here, there = (m / u[parameter.unit] for m, u in zip(medians, units, strict=True))
            assert here == pytest.approx(there)


def test_knots_have_the_covariance_of_a_random_walk():
    """Zero in the middle of the campaign, 100 s before the slew begins."""
    slew = SimpleNamespace(time=jnp.array([2.0, 10.0]), start=198.0, middle=100.0)
    root = np.asarray(random_walk_root(jnp.asarray(3.0), slew, 5))
    offset = 100.0 + 8.0  # never zero: the slew's own length is added
    at = offset + np.linspace(0.0, 8.0, 5)
    np.testing.assert_allclose(root @ root.T, 9.0 * np.minimum.outer(at, at))


def test_a_random_walk_goes_on_between_slews():
    """Against walks that were drawn: zero in the middle of the campaign, two slews on each side."""
    start, middle, knots = np.array([0.0, 30.0, 70.0, 130.0]), 64.0, 5
    time = np.broadcast_to([1.0, 17.0], (4, 2))
    slews = SimpleNamespace(time=jnp.array(time), start=jnp.array(start), middle=jnp.full(4, 64.0))
    covariance = np.asarray(random_walk_covariance(jnp.asarray(3.0), slews, knots))
    at = (start[:, None] + np.linspace(1.0, 17.0, knots)).ravel()
    grid = np.unique([*at, middle])
    rng = np.random.default_rng(3)
    n = 20_000
    steps = np.sqrt(np.diff(grid, prepend=grid[0])) * rng.normal(size=(n, len(grid)))
    walk = 3.0 * np.cumsum(steps, axis=1)
    walk -= walk[:, np.searchsorted(grid, middle)][:, None]
    drawn = walk[:, np.searchsorted(grid, at)]
    # The sd of an average of n products of normal numbers.
    sd = np.sqrt((np.outer(np.diag(covariance), np.diag(covariance)) + covariance**2) / n)
    off = np.abs(drawn.T @ drawn / n - covariance) / sd
    assert off.max() < 5.0
    # What lies on the other side of the middle is independent.
    assert not covariance[: 2 * knots, 2 * knots :].any()
    # The control: slews that are independent.
    apart = np.where(np.kron(np.eye(4), np.ones((knots, knots))), covariance, 0.0)
    assert (np.abs(drawn.T @ drawn / n - apart) / sd).max() > 50.0


@pytest.mark.parametrize("time", [0.05, 3.0, 1e4])
def test_knots_have_the_covariance_of_an_ornstein_uhlenbeck_process(time):
    spacing, knots = 1.5, 9
    root = np.asarray(ornstein_uhlenbeck_root(2.0, time, spacing, knots))
    apart = spacing * np.abs(np.subtract.outer(np.arange(knots), np.arange(knots)))
    np.testing.assert_allclose(root @ root.T, 4.0 * np.exp(-apart / time), rtol=1e-9, atol=1e-12)


def test_a_stationary_process_goes_on_between_slews():
    start, knots = np.array([0.0, 30.0]), 5
    slews = SimpleNamespace(
        time=jnp.array([[1.0, 17.0]] * 2), start=jnp.array(start), middle=jnp.full(2, 64.0)
    )
    covariance = np.asarray(ornstein_uhlenbeck_covariance(2.0, 7.0, slews, knots))
    at = (start[:, None] + np.linspace(1.0, 17.0, knots)).ravel()
    expected = 4.0 * np.exp(-np.abs(np.subtract.outer(at, at)) / 7.0)
    np.testing.assert_allclose(covariance, expected, rtol=1e-9)


@pytest.mark.parametrize("time", [0.05, 3.0, 1e4])
def test_pieces_have_the_covariance_of_means_of_an_ornstein_uhlenbeck_process(time):
    """Against averages of the exact covariance over a fine grid."""
    width, pieces, fine = 1.5, 5, 400
    at = (np.arange(pieces * fine) + 0.5) * width / fine
    exact = 4.0 * np.exp(-np.abs(np.subtract.outer(at, at)) / time)
    means = exact.reshape(pieces, fine, pieces, fine).mean((1, 3))
    root = np.asarray(ornstein_uhlenbeck_mean_root(2.0, time, width, pieces))
    np.testing.assert_allclose(root @ root.T, means, rtol=2e-3)


def test_hats_lie_on_straight_lines():
    at, values = np.linspace(0.0, 1.0, 37), np.array([3.0, -1.0, 2.0, 0.0])
    expected = np.interp(at, np.linspace(0.0, 1.0, 4), values)
    hats = np.asarray(hat_functions(jnp.asarray(at), 4))
    np.testing.assert_allclose(hats @ values, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([0, 1, 2, 97, 98, 99], [0, 0, 0, 1, 1, 1]),
        ([3, 96], [0, 1]),
        ([50], [0]),
        ([], []),
        (list(range(0, 100, 5)), [0] * 20),
        ([0, 1, 2, 49, 50, 97, 98], [0, 0, 0, 1, 1, 2, 2]),
    ],
)
def test_fixes_without_a_gap_are_one_group(rows, expected):
    fixed = np.isin(np.arange(100), rows)
    between = between_fix_groups(Slew("a", 5.0, 7.0 + np.arange(100.0)), fixed)
    assert np.searchsorted(between, rows).tolist() == expected


@dataclass(frozen=True)
class OwnDrift(RateBiasSlewDrift):
    name = "own_drift"


@dataclass(frozen=True)
class NotZeroAtNull(OwnDrift):
    def coefficient_root(self, p, slew, count):
        return (p["sd"] + 1e-9) * jnp.eye(count)


@dataclass(frozen=True)
class NotDefinite(OwnDrift):
    def coefficient_root(self, p, slew, count):
        return p["sd"] * jnp.ones((count, count))


@dataclass(frozen=True)
class NotFinite(OwnDrift):
    def coefficient_root(self, p, slew, count):
        return p["sd"] * jnp.eye(count) * jnp.sqrt(-p["sd"])


@dataclass(frozen=True)
class NoCoefficients(OwnDrift):
    def coefficient_count(self, campaign):
        return 0


@dataclass(frozen=True)
class WrongShape(OwnDrift):
    def coefficient_count(self, campaign):
        return 2

    def coefficient_root(self, p, slew, count):
        return p["sd"] * jnp.ones((3, 2))


@dataclass(frozen=True)
class WrongShapeAcrossSlews(OwnDrift):
    def covariance_across_slews(self, p, slews):
        return p["sd"] ** 2 * jnp.eye(1)


@dataclass(frozen=True)
class NoCovarianceAcrossSlews(OwnDrift):
    def covariance_across_slews(self, p, slews):
        return -(p["sd"] ** 2) * jnp.eye(len(slews.start))


@pytest.mark.parametrize(
    ("broken", "says"),
    [
        (NotZeroAtNull, "not zero"),
        (NotDefinite, "positive definite"),
        (NotFinite, "not finite"),
        (NoCoefficients, "coefficient_count"),
        (WrongShape, "shape"),
        (WrongShapeAcrossSlews, "covariance_across_slews has the shape"),
        (NoCovarianceAcrossSlews, "covariance_across_slews is no covariance"),
    ],
)
def test_broken_covariances_are_refused(broken, says):
    with pytest.raises(EffectError, match=says):
        check_effect(broken(), small_campaign())


@pytest.mark.parametrize("kind", [type(e) for e in STOCHASTIC if hasattr(e, "knots")])
@pytest.mark.parametrize("knots", [1, 0, -3, 2.5])
def test_straight_lines_need_two_knots(kind, knots):
    with pytest.raises(EffectError, match=f"^{kind.name}: knots is {knots}; give .* 2 or more"):
        kind(knots=knots)
    assert kind(knots=2).knots == 2


@pytest.mark.parametrize("kind", [type(e) for e in STOCHASTIC if hasattr(e, "pieces")])
def test_no_pieces_are_refused(kind):
    with pytest.raises(EffectError, match=f"^{kind.name}: pieces is 0; give .* 1 or more"):
        kind(pieces=0)


def test_what_has_a_fixed_shape_has_no_coefficients(campaign):
    model = Model(campaign, LIBRARY[:3])
    assert model.structure.coefficients == ()
    assert model.structure.hyperparameters == ()
    assert model.structure.n_local == model.structure.n_start


def test_sampled_noise_and_stochastic_effects_exclude_each_other(campaign):
    noise = NoiseModel(rate=ChannelNoise("student_t"))
    with pytest.raises(EffectError, match="rate_random_walk"):
        Model(campaign, by_name(["rate_random_walk"]), noise=noise)


def test_an_effect_that_has_nothing_to_act_on_is_refused_by_name():
    campaign = small_campaign()
    wheels = tuple(replace(wheel, momentum_sigma=None) for wheel in campaign.wheels)
    slews = tuple(replace(slew, wheel_momentum=None) for slew in campaign.slews)
    deaf = replace(campaign, wheels=wheels, slews=slews)
    with pytest.raises(EffectError, match="tachometer_noise_walk: acts on nothing"):
        Model(deaf, by_name(["tachometer_noise_walk"]))
    assert Model(deaf, by_name(["rate_random_walk"])).effects
