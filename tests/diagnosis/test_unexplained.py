"""Planted torques come back with size, axis and words; sensor errors are called by name."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.diagnosis.torque_response import torque_response
from bayes_inertia.diagnosis.unexplained import (
    cardinal_splines,
    infer_signal,
    signal_basis,
    unexplained_signal,
)
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.report.words import phrase

X, Z = np.eye(3)[[0, 2]]
SQUARE = 1.0 / 3e-4 * X  # a torque along x [N m s^2] for one of 1 N m at the usual rates


def describe(found):
    return phrase("diagnosis", "equivalent_signal", found)


def fitted(campaign):
    return estimate(Model(campaign), discount=False, starts=1)


def edited(campaign, change):
    def one(slew):
        rate = slew.rate.copy()
        change(slew.time, rate)
        return replace(slew, rate=rate)

    return replace(campaign, slews=tuple(one(s) for s in campaign.slews))


@pytest.mark.long
@pytest.mark.slow
def test_ringing_about_an_axis(planted):
    amplitude = 3e-4
    found = unexplained_signal(fitted(planted(seed=1, pump=amplitude)))
    assert found.source == "body torque"
    assert found.frequency_hz == pytest.approx(0.3, abs=0.01)  # a slew resolves 1 / 115 s
    assert abs(found.axis_B[1]) > 0.99
    assert found.torque_rms == pytest.approx(amplitude / np.sqrt(2.0), rel=0.2)
    assert describe(found).startswith("0.3 Hz ringing about y")
    assert "before the wheels act" in describe(found)  # it runs all the time
    # The band holds the truth.
    truth = -amplitude * np.sin(2.0 * np.pi * 0.3 * found.torque.time)
    inside = np.abs(found.torque.mean[..., 1] - truth) < 2.5 * found.torque.sd[..., 1]
    assert inside.mean() > 0.9


@pytest.mark.slow
def test_ringing_is_rather_a_torque_than_an_error_of_the_rates(planted):
    at = fitted(planted(seed=1, pump=3e-4))
    fit, response = at.linearised(), torque_response(at)
    torque, error = (
        infer_signal(fit, signal_basis(fit, response, source)).log_evidence
        for source in ("body torque", "rate sensor")
    )
    assert torque > error > 100.0


@pytest.mark.slow
def test_a_torque_that_grows_with_the_square_of_the_rate(planted):
    found = unexplained_signal(fitted(planted(seed=1, square=2e-5 * SQUARE)))
    assert found.source == "body torque"
    assert found.axis_B[0] > 0.99
    assert found.matches[0].name == "square of the body rate"
    assert "about +x, proportional to the square of the body rate" in describe(found)
    assert found.frequency_hz is None


@pytest.mark.slow
def test_a_constant_torque(planted):
    found = unexplained_signal(fitted(planted(seed=1, steady=-5e-6 * Z)))
    assert "constant about -z in all slews" in describe(found)
    assert found.torque_rms == pytest.approx(5e-6, rel=0.1)


@pytest.mark.long
@pytest.mark.slow
def test_evidence_tells_what_a_weak_torque_follows(planted):
    # Squares of rates are nearly constant in these slews, and a constant torque explains most of
    # this one.
    at = fitted(planted(seed=1, square=1e-6 * SQUARE))
    assert followed(at)["speed_squared"] == max(followed(at).values())
    assert followed(at)["speed_squared"] > followed(at)["constant"] + 3.0 > 30.0
    # The other way round, and with nothing there.
    steady = followed(fitted(planted(seed=1, steady=8e-7 * Z)))
    assert steady["constant"] > steady["speed_squared"]
    assert max(followed(fitted(planted(seed=1))).values()) < 3.0


def followed(estimate):
    """Log evidence of torques in proportion to something."""
    return {match.driver: match.log_evidence for match in unexplained_signal(estimate).matches}


@pytest.mark.long
@pytest.mark.slow
def test_a_glitch_of_the_rate_sensor_is_no_torque(planted):
    def shifted(time, rate):
        rate[(time > 60.0) & (time < 70.0), 0] += 3e-4

    found = unexplained_signal(fitted(edited(planted(seed=1), shifted)))
    assert found.source == "rate sensor"
    assert "no torque explains it: it is in the sensors" in describe(found)

    def spikes(time, rate):
        rate[::23, 2] += 6e-4

    found = unexplained_signal(fitted(edited(planted(seed=1), spikes)))
    assert found.source in ("rate sensor", "nothing smooth")
    assert "no torque explains it" in describe(found)


@pytest.mark.slow
def test_nothing_is_found_in_perfect_data(planted):
    at = fitted(planted(seed=1))
    fit = at.linearised()
    history = infer_signal(fit, signal_basis(fit, torque_response(at), "body torque"))
    assert history.log_evidence < 8.0  # the best of many sizes and lengths gains a little by chance
    assert np.mean(np.abs(history.mean) < 2.5 * history.sd) > 0.97


def test_splines_reproduce_cubics():
    t = np.linspace(0.0, 10.0, 12)
    at = np.linspace(0.0, 10.0, 77)
    np.testing.assert_allclose(
        cardinal_splines(at, t) @ (t**3 - 4.0 * t), at**3 - 4.0 * at, atol=1e-9
    )
