"""Further sensors are further instances of a channel: nothing else changes."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.hardware import RateSensor, StarTracker
from bayes_inertia.campaign.inspection import with_dirt_masked
from bayes_inertia.errors import CampaignError
from bayes_inertia.inference.likelihood import residuals
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.inference.point import Point
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.prediction import predict_all

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
