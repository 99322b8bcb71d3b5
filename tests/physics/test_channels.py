"""Further sensors are further instances of a channel: nothing else changes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.hardware import RateSensor, StarTracker
from bayes_inertia.campaign.inspection import with_dirt_masked
from bayes_inertia.campaign.sensors import SensorStream
from bayes_inertia.errors import CampaignError
from bayes_inertia.inference.hyperparameters import information_with_learnt
from bayes_inertia.inference.likelihood import Point, residuals
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.channels.channel import Readings, SeparateColumns
from bayes_inertia.physics.channels.rate import RateChannel
from bayes_inertia.physics.effects import RateBiasSlewDrift
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import Normal, vector
from bayes_inertia.physics.prediction import predict_all
from bayes_inertia.physics.small_campaign import small_campaign


@dataclass(frozen=True)
class FieldChannel(SeparateColumns):
    """A magnetometer's field in body axes; its parameter is its bias."""

    columns = components = "field_axis"
    sees_attitude = True

    def readings(self, campaign, slew):
        values = self.stream.values(slew)
        return Readings(np.nan_to_num(values), np.isfinite(values), np.arange(len(values)))

    def own_parameters(self, campaign):
        return (vector("bias", "xyz", unit="T", prior=Normal(0.0, 1e-7)),)

    def sensed(self, constants, bias, slew, trajectory):
        return quaternion.to_body(trajectory.attitude, slew.environment.magnetic_field_N)

    def read(self, parameters, values):
        return values + parameters

    def whitened_motion(self, fit, turn, rate_B):
        field_B = np.asarray(fit.readings.values)[..., None]
        return self.whitened_columns(fit.factors, np.cross(field_B, turn, axis=2))


@dataclass(frozen=True)
class FieldStream(SensorStream):
    """Its readings."""

    sensor = title = "magnetometer"
    unit = "T"
    channel = FieldChannel

    def sigma(self, campaign):
        return (self.hardware(campaign).sigma,) * 3

    def components(self, campaign):
        return ("x", "y", "z")

    def louder(self, campaign, factor):
        return self.with_hardware(campaign, Magnetometer(factor * self.hardware(campaign).sigma))


@dataclass(frozen=True)
class Magnetometer:
    """Of an outsider: nothing in the package knows of it."""

    sigma: float
    stream = FieldStream


SECOND = RateSensor(sigma=3e-5, axes=Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix())
TRACKER = StarTracker((1.0, 0.0, 0.0), 3e-5, 2e-4)
K, BIAS = np.array([1.02, 0.97, 1.01]), np.array([6e-6, -4e-6, 2e-6])


@pytest.fixture(scope="module")
def more(flown):
    """A campaign with a second rate sensor and a second star tracker, and what it predicts."""
    model = Model(flown.campaign)
    rates, attitudes, _ = predicted(model, model.space.mean)
    sensor, slews = flown.campaign.rate_sensor, []
    for slew, rate, attitude in zip(flown.campaign.slews, rates, attitudes, strict=True):
        n = len(slew.time)
        rate_B = np.linalg.solve(
            sensor.axes, (rate[:n] * model.space.mean[6:9]).T - bias_of(sensor)
        )
        second = (SECOND.axes @ rate_B + BIAS[:, None]).T / K
        second[1::2] = np.nan
        fixes = np.full((n, 4), np.nan)
        fixes[np.flatnonzero(slew.fixes)[:3]] = -attitude[:3]
        slews.append(replace(slew, more={"second": second, "tracker": fixes}))
    sensors = (("second", SECOND), ("tracker", TRACKER))
    return replace(flown.campaign, slews=tuple(slews), more_sensors=sensors)


def bias_of(sensor):
    return np.array(sensor.bias)[:, None]


def predicted(model, theta):
    local, bias = jnp.zeros((model.n_slews, model.structure.n_local)), jnp.zeros(3)
    prediction = predict_all(model.structure, jnp.asarray(theta), local, bias, model.data)
    return [np.asarray(values) for values in prediction]


def residuals_at(model, theta):
    point = Point(theta, np.zeros(3), np.zeros((model.n_slews, model.structure.n_local)))
    found = residuals(model.structure, point, model.data, whitening(model, theta))
    return dict(zip([c.name for c in model.channels], map(np.asarray, found), strict=True))


@pytest.mark.slow
def test_a_further_sensor_is_a_further_instance(flown, more):
    model = Model(more)
    names = [f"second.{kind}{axis}" for kind in ("K", "bias") for axis in (1, 2, 3)]
    assert list(model.space.names[9:]) == names
    theta = np.concatenate([model.space.mean[:9], K, BIAS])
    found = residuals_at(model, theta)
    assert list(found) == ["rate", "attitude", "momentum", "second", "tracker"]
    for name, values in residuals_at(Model(flown.campaign), theta[:9]).items():
        np.testing.assert_array_equal(found[name], values)
    assert np.abs(found["second"]).max() < 1e-6
    assert np.abs(found["tracker"]).max() < 1e-6
    wrong = residuals_at(model, model.space.mean)
    assert np.abs(wrong["second"]).max() > 1.0


@pytest.mark.slow
def test_impossible_readings_of_a_further_sensor_are_masked(more):
    slew = more.slews[1]
    wild = slew.more["second"].copy()
    wild[10, 2] = 2e3
    changed = replace(slew, more={**slew.more, "second": wild})
    found = with_dirt_masked(replace(more, slews=(more.slews[0], changed, *more.slews[2:])))
    record = next(dirt for dirt in found.dirt if dirt.kind == "outliers")
    assert (record.channel, record.slew, record.rows) == ("second", slew.name, (10,))
    assert np.isnan(found.slews[1].more["second"][10, 2])


def test_readings_of_a_sensor_that_is_not_listed_are_refused(more):
    with pytest.raises(CampaignError, match=r"second.*no sensor"):
        replace(more, more_sensors=(("tracker", TRACKER),))


@pytest.mark.slow
def test_an_outsider_adds_a_kind_of_sensor_and_edits_nothing(flown):
    slews, bias = [], np.array([6e-8, -4e-8, 2e-8])
    for slew in flown.campaign.slews:
        n = len(slew.time)
        field = np.stack([2e-5 * np.cos(0.01 * slew.time), np.full(n, 1e-5), np.full(n, -3e-5)], 1)
        slews.append(replace(slew, magnetic_field_N=field, more={"field": np.full((n, 3), np.nan)}))
    sensors = (("field", Magnetometer(1e-8)),)
    silent = Model(replace(flown.campaign, slews=tuple(slews), more_sensors=sensors))
    theta = np.concatenate([silent.space.mean[:9], bias])
    told = [
        replace(slew, more={"field": field_B[: len(slew.time)]})
        for slew, field_B in zip(slews, predicted(silent, theta)[3], strict=True)
    ]
    model = Model(replace(silent.campaign, slews=tuple(told)))
    assert model.space.names[9:] == ("field.bias_x", "field.bias_y", "field.bias_z")
    found = residuals_at(model, theta)
    assert np.abs(found["field"]).max() < 1e-9
    np.testing.assert_array_equal(found["rate"], residuals_at(silent, theta)["rate"])
    for slew in told:
        sizes = [
            np.linalg.norm(x, axis=1) for x in (slew.more["field"] - bias, slew.magnetic_field_N)
        ]
        np.testing.assert_allclose(*sizes, rtol=1e-12)
    assert np.abs(residuals_at(model, model.space.mean)["field"]).max() > 1.0


def test_what_is_no_sensor_is_refused(flown):
    with pytest.raises(CampaignError, match=r"more_sensors.x: a float is no kind of sensor"):
        replace(flown.campaign, more_sensors=(("x", 1.0),))


@pytest.mark.long
@pytest.mark.slow
def test_sizes_of_random_effects_are_learnt_beside_further_sensors(more):
    model = Model(more, (RateBiasSlewDrift(),))
    silent = np.zeros((model.n_slews, model.structure.n_local))
    point = Point(model.space.mean, np.zeros(3), silent)
    every, white = np.arange(model.space.size), whitening(model, point.theta)
    information = information_with_learnt(model, point, white, every)
    assert information.matrix.shape[1] == len(model.channels) == 5
    size = list(model.structure.hyperparameters)
    assert np.all(information.matrix.sum((0, 1))[size, size] != 0.0)


def test_gyros_that_tachometer_noise_shakes_alike_do_not_average_it_away():
    """All gyros together know the rate no better than the noise that they share lets them."""
    plain = small_campaign()
    loud = tuple(replace(wheel, momentum_sigma=1e-3) for wheel in plain.wheels)

    def known(*sigmas):
        """Covariance (3, 3) of one body rate by gyros of these sigmas [rad^2/s^2]."""
        first, *others = (RateSensor(sigma) for sigma in sigmas)
        names = [f"gyro {k}" for k in range(len(others))]
        slews = (replace(s, more=dict.fromkeys(names, s.rate)) for s in plain.slews)
        several = tuple(zip(names, others, strict=True))
        campaign = replace(
            plain, wheels=loud, rate_sensor=first, slews=tuple(slews), more_sensors=several
        )
        model = Model(campaign, (), "measured")
        gyros = [c for c in model.channels if isinstance(c, RateChannel)]
        noises = [c.noise(campaign, model.space.mean, "measured") for c in gyros]
        return np.linalg.inv(sum(map(np.linalg.inv, noises)))

    alone, fine, coarse = known(2e-5), 2e-5, 2e-2
    shaken = alone - fine**2 * np.eye(3)
    for sigmas in ([fine, fine], [fine, fine, fine]):
        together = shaken + fine**2 / len(sigmas) * np.eye(3)
        np.testing.assert_allclose(known(*sigmas), together, rtol=1e-9, atol=1e-15)
    # A gyro that tells little takes hardly anything from one that tells much.
    np.testing.assert_allclose(known(fine, coarse), alone, rtol=1e-3, atol=1e-12)
