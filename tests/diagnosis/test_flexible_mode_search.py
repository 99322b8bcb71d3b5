"""A planted mode comes back as it was, and noise alone gains what its p-value says."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from bayes_inertia.diagnosis.candidates import (
    best_flexible_mode,
    frequencies,
    restarted_with_mode,
    theta_with_mode,
)
from bayes_inertia.diagnosis.torque_response import torque_response
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference.likelihood import Point
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.physics.effects import FlexibleMode
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign

# A coupling so large that every frequency is seen: where a mode is invisible the p-value is only
# the safer.
NAME, SCALE = "flexible_mode", 100.0


@pytest.fixture(scope="module")
def searched(small_flown):
    """`searched(residual)`: the best ringing in residuals (slews, numbers) that an estimate of two
    slews might have left, and the response.
    """
    at = estimate(Model(small_flown.campaign), starts=1, discount=False)
    response, fit = torque_response(at), at.linearised()

    # At the prior mean, so that nothing but the residuals pulls.
    centre = Point(at.model.space.mean, np.zeros(3), np.zeros_like(at.point.local))

    def search(residual):
        left = replace(fit, point=centre)
        vars(left)["rows"] = replace(fit.rows, residual=residual)  # what is cached there otherwise
        return best_flexible_mode(NAME, response, left, SCALE)

    return search, response, fit.residual.shape


def p_value(found, trials=None):
    return -np.expm1((trials or found.trials) * np.log1p(-stats.chi2.sf(found.score, found.dof)))


def products_of(delta):
    x, y, z = delta
    return np.array([x * x, y * y, z * z, x * y, x * z, y * z])


@pytest.mark.slow
def test_a_planted_ringing_comes_back(searched):
    search, response, shape = searched
    noise = np.random.default_rng(4).normal(size=shape)
    # Where noise alone happens to look best: a mode there, of which the fit can imitate a part.
    somewhere = search(noise)
    delta = np.array([1.0, -0.5, 0.7])
    delta *= np.sqrt(40.0 / np.linalg.norm(somewhere.products @ products_of(delta)))
    found = search(noise - somewhere.products @ products_of(delta))
    assert abs(found.frequency - somewhere.frequency) < np.diff(frequencies(response))[0]
    assert p_value(somewhere) > 1e-3
    assert p_value(found) < 1e-6
    along = abs(found.coupling @ delta) / np.linalg.norm(delta)
    assert along == pytest.approx(np.linalg.norm(delta), rel=0.25)


@pytest.mark.slow
def test_noise_gains_what_the_p_value_says(searched):
    search, _, shape = searched
    rng, n = np.random.default_rng(5), 60
    found = [search(rng.normal(size=shape)) for _ in range(n)]
    for level in (0.3, 0.1):
        assert sum(p_value(f) < level for f in found) <= stats.binom.ppf(0.999, n, level)
        # Negative controls: as if only one frequency had been tried; and not safe at the price of
        # seeing nothing.
        assert sum(p_value(f, trials=1) < level for f in found) > stats.binom.ppf(0.999, n, level)
    assert sum(p_value(f) < 0.5 for f in found) >= stats.binom.ppf(0.001, n, 0.25)
    # Where nothing is seen a mode is less probable than beforehand, by sizes that would be seen.
    assert all(0.1 < f.elsewhere < 1.0 for f in found)


def test_a_mode_begins_with_no_more_inertia_than_half_the_body_has():
    """With all of it nothing is left that turns, and a flight from there has no numbers."""
    model = Model(small_campaign(), (FlexibleMode(),))
    at = SimpleNamespace(model=model, theta=model.expected)
    strong = SimpleNamespace(name=NAME, coupling=np.array([-9.0, 0.0, 30.0]), frequency=0.3)
    theta = theta_with_mode(at, strong)
    rest = inertia_tensor.tensor(theta[:6]) - np.outer(theta[9:12], theta[9:12])
    assert np.linalg.eigvalsh(rest)[0] > 0.3 * theta[:3].min()
    assert theta[9] < 0.0 < theta[11]


@pytest.mark.long
@pytest.mark.slow
def test_an_optimizer_that_stayed_at_zero_coupling_begins_again_at_the_ringing():
    plan = replace(paper_like_plan(), telemetry_period=0.5)
    plan = replace(plan, slews=(plan.slews[0], plan.slews[3], plan.slews[4]))
    mode, truth = FlexibleMode(frequency=0.2), np.array([0.25, 0.0, 0.15])
    values = {
        mode.name: {"coupling": truth, "frequency": np.array(0.23), "damping": np.array(0.005)}
    }
    flight = draw_flight(
        planned_campaign(plan, most_like_mission()),
        plan,
        3,
        effects=(mode,),
        values=values,
        vary=False,
    )
    at = estimate(Model(flight.campaign, (mode,)), starts=1, discount=False)
    coupling = slice(9, 12)
    assert (
        np.abs(at.theta[coupling]).max() < 0.01
    )  # a stationary point, which it does not leave by itself
    found = restarted_with_mode(at)
    assert found.objective < at.objective - 20.0
    aligned = found.theta[coupling] * np.sign(found.theta[9])
    assert np.abs((aligned - truth) / found.sd[coupling]).max() < 4.0
    assert abs(found.theta[12] - 0.23) < 4.0 * found.sd[12]
    assert found.sd[12] < 0.01
    rigid = estimate(Model(flight.campaign), starts=1, discount=False)
    assert restarted_with_mode(rigid) is rigid
