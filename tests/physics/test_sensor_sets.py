"""Any set of sensors: gyros of n axes, none at all, directions; what each predicts."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.hardware import DirectionSensor, RateSensor
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.errors import CampaignError, EffectError
from bayes_inertia.inference.likelihood import Point, residuals
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.channel_noise import ChannelNoise, NoiseModel
from bayes_inertia.physics.effects import RateBias, by_name
from bayes_inertia.physics.forward_model import Model

SKEWED = np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [-1.0, -1.0, 1.0], [1.0, -1.0, 1.0]])
AXES = {
    "two": np.eye(3)[:2],
    "four skewed": SKEWED / np.sqrt(3.0),
}
SIGMA = 2e-5
EVERY_ROW = tuple(range(96))


def true_rates(exact):
    """Rates along body axes (n, 3) of each slew, of a campaign without noise."""
    K, bias = exact.truth.theta[6:9], exact.truth.bias
    return [slew.rate * K - bias for slew in exact.campaign.slews]


def with_gyro(noisy, exact, axes, K, bias, rng):
    """The campaign with another rate sensor in place of its own."""
    rates = (rate_B @ axes.T for rate_B in true_rates(exact))
    slews = [
        replace(slew, rate=(rate_S + bias) / K + SIGMA * rng.normal(size=rate_S.shape))
        for slew, rate_S in zip(noisy.campaign.slews, rates, strict=True)
    ]
    sensor = RateSensor(SIGMA, axes, range=0.05)
    return replace(noisy.campaign, rate_sensor=sensor, slews=tuple(slews))


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    "axes",
    [pytest.param(AXES["two"], marks=pytest.mark.long), AXES["four skewed"]],
    ids=AXES,
)
def test_a_gyro_of_n_axes_has_n_scale_factors_and_finds_J(flying, axes):
    noisy, exact = flying(3), flying(3, noise=0.0)
    rng, n = np.random.default_rng(1), len(axes)
    K, bias = 1.0 + 0.02 * rng.normal(size=n), 1e-5 * rng.normal(size=n)
    campaign = with_gyro(noisy, exact, axes, K, bias, rng)
    fitted = estimate(Model(campaign), starts=1)
    assert fitted.model.space.names[6:] == tuple(f"K{i + 1}" for i in range(n))
    assert fitted.model.n_bias == len(fitted.point.bias) == n
    truth = np.concatenate([exact.truth.theta[:6], K])
    z = (fitted.theta - truth) / fitted.sd
    assert np.sqrt(np.mean(z**2)) < 1.8
    assert np.abs(z).max() < 4.0
    chi2 = fitted.information.chi2.sum() / fitted.information.n_data.sum()
    assert 0.9 < chi2 < 1.1
    read = np.stack([slew.rate for slew in campaign.slews])
    predicted = fitted.model.predict(fitted.theta)["rate"][0]
    assert predicted.shape == read.shape
    # Each slew begins at its first reading, whose noise and bias last.
    assert np.std(predicted - read) < 0.1 * np.std(read)
    assert np.std(predicted[::-1] - read) > 0.1 * np.std(read)


@pytest.mark.slow
def test_without_a_gyro_J_comes_from_the_star_tracker(flying, setup_type):
    setup = setup_type(fix_rows=EVERY_ROW)
    noisy, exact = flying(5, setup), flying(5, setup, noise=0.0)
    slews = tuple(replace(slew, rate=None) for slew in noisy.campaign.slews)
    campaign = replace(noisy.campaign, rate_sensor=None, slews=slews)
    model = Model(campaign)
    assert model.space.names == ("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz")
    assert model.n_bias == 0
    fitted = estimate(model, starts=1)
    z = (fitted.theta - exact.truth.theta[:6]) / fitted.sd
    assert np.sqrt(np.mean(z**2)) < 1.8
    assert fitted.sd.max() < 2e-3
    with pytest.raises(EffectError, match="needs a rate sensor"):
        Model(campaign, (RateBias(),))


@pytest.mark.parametrize(
    ("effect", "drive", "error", "words"),
    [
        ("wheel_friction", None, EffectError, "needs wheels, and this campaign has none"),
        ("star_tracker_shift", None, EffectError, "needs a star tracker, and this campaign"),
        (None, "measured", CampaignError, "there are no wheels to drive the model"),
    ],
)
def test_what_a_spacecraft_has_not_is_no_effect_and_no_drive_of_it(
    flown, effect, drive, error, words
):
    slews = [
        replace(s, attitude=None, wheel_torque=None, wheel_momentum=None)
        for s in flown.campaign.slews
    ]
    free = replace(flown.campaign, wheels=(), star_tracker=None, slews=tuple(slews))
    effects = by_name([effect]) if effect else ()
    assert Model(free).structure.wheels == 0
    with pytest.raises(error, match=words):
        Model(free, effects, drive)


@pytest.mark.parametrize(
    ("name", "drive", "advice"),
    [("momentum", "measured", "use the commanded drive"), ("attitude", None, "leave it out")],
)
def test_noise_of_what_is_not_compared_is_refused_with_its_reason(flown, name, drive, advice):
    campaign = flown.campaign
    if name == "attitude":
        slews = tuple(replace(slew, attitude=None) for slew in campaign.slews)
        campaign = replace(campaign, slews=slews)
    with pytest.raises(CampaignError, match=f"of the channel {name} are compared.*{advice}"):
        Model(campaign, drive=drive, noise=NoiseModel(**{name: ChannelNoise("student_t")}))


def test_without_gyro_and_attitudes_a_campaign_is_refused(flown):
    slews = tuple(replace(slew, rate=None, attitude=None) for slew in flown.campaign.slews)
    with pytest.raises(CampaignError, match="neither a rate sensor nor two attitudes"):
        replace(flown.campaign, rate_sensor=None, slews=slews)


def test_rates_have_one_column_an_axis(flown):
    with pytest.raises(CampaignError, match="3 columns for a RateSensor of 2"):
        replace(flown.campaign, rate_sensor=RateSensor(1e-5, np.eye(3)[:2]))
    gyro, tracker = flown.campaign.rate_sensor, flown.campaign.star_tracker
    for sensor, channel, factor, words in (
        (gyro, "rate", np.eye(3)[:, :2], "2 columns for a RateSensor of 3"),
        (tracker, "attitude", 2.0 * np.eye(4), "the quaternion has length 2, not 1"),
    ):
        slews = [replace(s, more={"b": getattr(s, channel) @ factor}) for s in flown.campaign.slews]
        with pytest.raises(CampaignError, match=words):
            replace(flown.campaign, slews=slews, more_sensors=(("b", sensor),))


def test_gyros_of_different_axes_have_their_own_dimension_in_a_posterior(flown):
    slews = tuple(replace(slew, more={"mems": slew.rate[:, :2]}) for slew in flown.campaign.slews)
    sensors = (("mems", RateSensor(1e-4, np.eye(3)[:2])),)
    model = Model(replace(flown.campaign, slews=slews, more_sensors=sensors))
    lengths: dict[str, set[int]] = {}
    for channel, given in zip(model.channels, model.data.arrays.telemetry.readings, strict=True):
        lengths.setdefault(channel.axes[-1], set()).add(given.values.shape[-1])
        lengths.setdefault(channel.residual_axes[-1], set()).add(given.valid.shape[-1])
    assert lengths["sensor_axis"] == {3}
    assert lengths["mems_axis"] == {2}
    assert all(len(of_name) == 1 for of_name in lengths.values())


SUN_N = np.array([0.5, 0.7, 0.51]) / np.linalg.norm([0.5, 0.7, 0.51])
OFFSET = np.array([3e-7, -2e-7, 1e-7])
SCALE = np.array([0.02, -0.01, 0.015])
IRON = np.array([0.004, -0.003, 0.005])
MOUNTING = np.array([0.01, -0.02, 0.005])


def field_N(slew):
    """A field that turns (n, 3) [T]."""
    angle = 0.01 * slew.time
    return 3e-5 * np.stack([np.cos(angle), np.sin(angle), 0.5 + 0.0 * angle], -1)


def with_directions(exact, **magnetometer):
    """Sun sensor and magnetometer in place of the star tracker, without noise."""
    symmetric = np.diag(SCALE) + np.array(
        [[0.0, IRON[0], IRON[1]], [IRON[0], 0.0, IRON[2]], [IRON[1], IRON[2], 0.0]]
    )
    slews = []
    for slew in exact.campaign.slews:
        to_body = Rotation.from_quat(slew.attitude).inv()
        tilted = (Rotation.from_quat(slew.attitude) * Rotation.from_rotvec(MOUNTING)).inv()
        field_B = to_body.apply(field_N(slew))
        more = {
            # A direction needs no length.
            "sun": 2.0 * tilted.apply(np.broadcast_to(SUN_N, (len(slew.time), 3))),
            "field": field_B + field_B @ symmetric + OFFSET,
        }
        inputs = {"field": InputStream(slew.time, field_N(slew), "line")}
        slews.append(replace(slew, attitude=None, more=more, inputs=inputs))
    sensors = (
        ("sun", DirectionSensor(0.01, tuple(SUN_N), mounting_sigma=0.02)),
        ("field", DirectionSensor(2e-7, unit="T", **magnetometer)),
    )
    return replace(exact.campaign, star_tracker=None, slews=tuple(slews), more_sensors=sensors)


@pytest.fixture(scope="module")
def directions(flying, setup_type):
    exact = flying(4, setup_type(fix_rows=EVERY_ROW), noise=0.0)
    sds = {"offset_sigma": 1e-6, "scale_sigma": 0.05, "soft_iron_sigma": 0.02}
    return exact, Model(with_directions(exact, **sds))


def at_truth(exact, model):
    """Parameters and start states with which the campaign was simulated."""
    theta = np.concatenate([exact.truth.theta, MOUNTING, OFFSET, SCALE, IRON])
    local = np.zeros((model.n_slews, model.structure.n_local))
    scale, reference = np.asarray(model.data.scale.local), model.data.arrays.reference
    for k, (slew, rate_B) in enumerate(zip(exact.campaign.slews, true_rates(exact), strict=True)):
        start = Rotation.from_quat(np.asarray(reference.attitude)[k])
        turn = (start.inv() * Rotation.from_quat(slew.attitude[0])).as_rotvec()
        rate = rate_B[0] - np.asarray(reference.rate_B)[k]
        momentum = slew.wheel_momentum[0] - np.asarray(reference.wheel_momentum)[k]
        local[k] = np.concatenate([rate, turn, momentum]) / scale
    bias = exact.truth.bias / np.asarray(model.data.scale.bias)
    return Point(theta, bias, local)


@pytest.mark.slow
def test_directions_are_predicted_with_the_sensors_own_errors(directions):
    exact, model = directions
    assert model.space.names[9:] == (
        *(f"sun.mounting_{axis}" for axis in "xyz"),
        *(f"field.{e}_{axis}" for e in ("offset", "scale") for axis in "xyz"),
        *(f"field.soft_iron_{axes}" for axes in ("xy", "xz", "yz")),
    )
    point = at_truth(exact, model)
    found = residuals(model.structure, point, model.data, whitening(model, point.theta))
    found = dict(zip([c.name for c in model.channels], map(np.asarray, found), strict=True))
    assert found["sun"].shape[1] == 2 * found["field"].shape[1] // 3
    assert np.abs(found["sun"]).max() < 1e-6
    # The reference is read along straight lines between its rows, and so is the simulator's.
    assert np.abs(found["field"]).max() < 1e-3
    perfect = replace(point, theta=np.concatenate([point.theta[:9], np.zeros(12)]))
    wrong = residuals(model.structure, perfect, model.data, whitening(model, point.theta))
    assert all(np.abs(np.asarray(r)).max() > 1.0 for r in wrong[3:])


def test_two_directions_tell_the_start_attitude(directions):
    exact, model = directions
    started = Rotation.from_quat(np.asarray(model.data.arrays.reference.attitude))
    true = Rotation.from_quat([slew.attitude[0] for slew in exact.campaign.slews])
    # Mounting, offset, scale and soft iron are not known then.
    assert np.degrees((started.inv() * true).magnitude()).max() < 5.0


@pytest.mark.parametrize("place", ["sun", "field"])
def test_a_direction_moved_by_angles_is_found_again(directions, place):
    channel = next(c for c in directions[1].channels if c.name == place)
    rng = np.random.default_rng(2)
    values = rng.normal(size=(5, 50, 3))
    values /= np.linalg.norm(values, axis=-1, keepdims=True)
    change = 0.3 * rng.normal(size=(5, 50, 3 if place == "field" else 2))
    moved = channel.moved(values, change)
    again = np.asarray(channel.gap(jnp.asarray(moved), jnp.asarray(values)))
    np.testing.assert_allclose(again, change, atol=1e-9)


def test_a_direction_without_a_reference_is_refused(flown):
    slews = tuple(
        replace(slew, more={"sun": np.ones((len(slew.time), 3))}) for slew in flown.campaign.slews
    )
    campaign = replace(flown.campaign, slews=slews, more_sensors=(("sun", DirectionSensor(0.01)),))
    with pytest.raises(CampaignError, match="nothing says in which inertial direction"):
        Model(campaign)


def test_the_first_sensor_of_a_kind_is_the_reference_of_frames(flown):
    turned = replace(flown.campaign.rate_sensor, mounting_sigma=0.01)
    with pytest.raises(CampaignError, match="reference of frames"):
        replace(flown.campaign, rate_sensor=turned)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"unit": "G"}, "no unit"),
        ({"offset_sigma": 1e-7}, "only a magnetometer"),
        ({"sigma": (0.01, 0.02, 0.03)}, "one noise"),
        ({"reference_N": (0.0, 0.0, 0.0)}, "not positive"),
        ({"mounting_sigma": -1.0}, "not positive"),
    ],
    ids=["unit", "offset of a direction", "three noises", "no direction", "negative sd"],
)
def test_directions_that_cannot_be_are_refused(changes, what):
    with pytest.raises(CampaignError, match=what):
        DirectionSensor(**{"sigma": 0.01, **changes})


def test_axes_in_one_plane_are_refused_where_three_are_needed():
    plane = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    with pytest.raises(CampaignError, match="one plane"):
        RateSensor(1e-5, plane)
    assert RateSensor(1e-5, plane[:2]).sigma == (1e-5, 1e-5)
    with pytest.raises(CampaignError, match="nor one for each of 2 axes"):
        RateSensor((1e-5, 1e-5, 1e-5), plane[:2])
