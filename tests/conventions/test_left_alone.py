"""What is physical, dirty or only badly known is no wrong convention."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayes_inertia
from bayes_inertia.campaign.actuators import Change
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import body_rates
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.conventions.check import check_conventions
from bayes_inertia.conventions.laws import CLOSURE, CONSERVATION, Misfits
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.motion import composed, of_angle, sampled
from bayes_inertia.conventions.reading import stated_reading

WAYS = (0.5, -0.4, 0.6, -0.5, 0.4)  # [rad]
EXAMPLE = Path(bayes_inertia.__file__).parent / "example"


@pytest.fixture(scope="module")
def right() -> Campaign:
    return read_campaign(EXAMPLE)


def with_rates(campaign: Campaign, change: Callable[[np.ndarray], np.ndarray]) -> Campaign:
    slews = [replace(slew, rate=change(np.array(slew.rate))) for slew in campaign.slews]
    return replace(campaign, slews=tuple(slews))


def with_prior(campaign: Campaign, factors: tuple[float, float, float]) -> Campaign:
    tensor = np.sqrt(np.outer(factors, factors)) * campaign.inertia.tensor
    return replace(campaign, inertia=replace(campaign.inertia, tensor=tensor))


def outliers(rate: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(3)
    hit = rng.random(len(rate)) < 0.01
    rate[hit] += rng.normal(0.0, 0.5, (int(hit.sum()), 3))
    return rate


def stuck(rate: np.ndarray) -> np.ndarray:
    middle = len(rate) // 2
    rate[middle : middle + 12] = rate[middle]
    return rate


def gap(rate: np.ndarray) -> np.ndarray:
    middle = len(rate) // 2
    rate[middle : middle + 60] = np.nan
    return rate


def coloured(rate: np.ndarray) -> np.ndarray:
    walk = np.cumsum(np.random.default_rng(4).normal(0.0, 2e-5, rate.shape), axis=0)
    return rate + walk


TILT = np.array([[1.0, 0.05, -0.04], [-0.05, 1.0, 0.03], [0.04, -0.03, 1.0]])  # three degrees
MADE = {
    "misaligned by degrees": lambda rate: rate @ TILT.T,
    "scale factors 5 % off": lambda rate: rate * [1.05, 0.95, 1.04],
    "a stale bias": lambda rate: rate + np.array([2e-4, -1e-4, 1e-4]),
    "outliers": outliers,
    "stuck for 3 s": stuck,
    "a gap of 15 s": gap,
    "coloured noise": coloured,
    "coarse steps": lambda rate: np.round(rate / 3e-4) * 3e-4,
    "an axis that fails for a while": lambda rate: np.where(
        (np.arange(len(rate)) % 7 == 0)[:, None] & [True, False, False], np.nan, rate
    ),
}


@pytest.mark.parametrize("name", MADE)
def test_physics_and_faults_are_left_alone(right, name):
    check = check_conventions(with_rates(right, MADE[name]), quick=True)
    assert check.verdict == "consistent", check.sentence
    assert max(check.misfits.values()) < 2.0


@pytest.mark.parametrize("factors", [(0.7, 0.7, 0.7), (1.3, 1.3, 1.3), (0.75, 1.25, 1.0)])
def test_an_inertia_that_is_30_percent_wrong_is_left_alone(right, factors):
    assert check_conventions(with_prior(right, factors), quick=True).verdict == "consistent"


def test_an_inertia_in_another_unit_is_not(right):
    check = check_conventions(with_prior(right, (1e4, 1e4, 1e4)), quick=True)
    assert check.changes[0].key == "inertia.tensor"
    assert check.changes[0].mended[0][0] == pytest.approx(right.inertia.tensor[0, 0])


def test_a_stale_bias_is_reported_as_a_fault(right):
    check = check_conventions(with_rates(right, MADE["a stale bias"]))
    assert [dirt["kind"] for dirt in check.dirt] == ["stale_bias"]
    assert check_conventions(right).dirt == ()


def test_a_noise_stated_too_small_is_reported_as_a_fault(right):
    sensor = replace(right.rate_sensor, sigma=tuple(s / 3.0 for s in right.rate_sensor.sigma))
    dirt = check_conventions(replace(right, rate_sensor=sensor)).dirt
    assert [entry["kind"] for entry in dirt] == ["noise_level"]
    assert "3" in dirt[0]["note"]


def test_a_campaign_without_any_law_is_consistent_and_says_so(right):
    slews = [
        replace(slew, attitude=None, wheel_torque=None, wheel_momentum=None) for slew in right.slews
    ]
    check = check_conventions(replace(right, slews=tuple(slews), star_tracker=None))
    assert check.verdict == "consistent"
    assert check.misfits == {}
    assert len(check.cannot_show) >= 3


def misfits_of(campaign: Campaign) -> dict[str, float]:
    """Misfit of each law, as the campaign states it [sd]."""
    slews = sampled(campaign)
    assert slews is not None
    fits = Misfits(campaign, slews).of(stated_reading(campaign))
    return {law: fit.worst for law, fit in fits.items()}


def test_a_bias_that_wanders_as_stated_is_no_broken_law(right):
    walk, rng = 2e-4, np.random.default_rng(2)  # [rad/s^1.5]

    def wandering(slew):
        steps = walk * np.sqrt(np.gradient(slew.time))[:, None]
        return replace(
            slew, rate=slew.rate + np.cumsum(steps * rng.normal(size=slew.rate.shape), axis=0)
        )

    wild = replace(right, slews=tuple(map(wandering, right.slews)))
    assert min(misfits_of(wild)[law] for law in (CLOSURE, CONSERVATION)) > LIMITS.impossible
    sensor = right.gyro
    for stated in (
        replace(sensor, rate_random_walk=walk),
        replace(sensor, bias_instability=2e-3, bias_instability_time=100.0),
    ):
        assert max(misfits_of(replace(wild, rate_sensor=stated)).values()) < LIMITS.ordinary


def test_a_star_tracker_that_is_off_as_stated_breaks_no_law(right):
    def off(slew, angle):
        q = np.array(slew.attitude)
        late = slew.fixes & (slew.time > 0.5 * slew.duration)
        q[late] = composed(q[late], of_angle(np.array([0.0, 0.0, angle])))
        return replace(slew, attitude=q)

    moved = replace(right, slews=tuple(off(s, a) for s, a in zip(right.slews, WAYS, strict=True)))
    assert misfits_of(moved)[CLOSURE] > LIMITS.impossible
    tracker = replace(right.star_tracker, low_frequency_sigma=0.3)
    assert misfits_of(replace(moved, star_tracker=tracker))[CLOSURE] < LIMITS.suspicious


def test_a_dated_change_of_the_tensor_is_no_broken_law(right):
    change, after = Change("boom", right.slews[3].start, sigma_fraction=1.0), slice(3, None)
    more = 1.2 * right.inertia.tensor

    def heavier(slew):
        rate_B = body_rates(right.gyro, slew.rate, right.gyro.scale_factor)
        taken = np.linalg.solve(right.wheel_axes_B, more @ rate_B.T).T
        return replace(slew, wheel_torque=None, wheel_momentum=slew.wheel_momentum - taken)

    slews = (*right.slews[:3], *map(heavier, right.slews[after]))
    assert misfits_of(replace(right, slews=slews))[CONSERVATION] > LIMITS.impossible
    dated = replace(right, slews=slews, changes=(change,))
    assert misfits_of(dated)[CONSERVATION] < LIMITS.ordinary
