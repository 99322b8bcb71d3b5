"""Programs of one padded slew give what those of the slew as it is give."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from support.marginal import DRIVES

from bayes_inertia.inference import each_slew, hyperparameters, marginal_posterior, noise_memory
from bayes_inertia.inference.laplace import marginal
from bayes_inertia.inference.likelihood import unpadded_sensitivities
from bayes_inertia.inference.marginal_posterior import conditional_point, log_posterior
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.maths.device_arrays import repeated
from bayes_inertia.physics import model_data
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model

CASES = [
    *[((), drive) for drive in DRIVES],
    pytest.param(("rate_random_walk",), "commanded", marks=pytest.mark.slow),
    pytest.param(("wheel_friction", "rate_sensor_delay"), "commanded", marks=pytest.mark.slow),
]


@pytest.fixture(scope="module")
def odd(flying, setup_type):
    """A campaign of which no number is a size: five slews of 101 rows."""
    turns = ((0.6, 0.1, 0.0), (0.1, 0.5, 0.5), (0.0, 0.7, 0.2), (0.1, -0.2, 0.8), (0.3, 0.3, 0.0))
    return flying(21, setup_type(turns=turns, rows=101)).campaign


@pytest.fixture
def unpadded(monkeypatch):
    """Every axis in its own size."""

    def pad_nothing():
        for module in (model_data, marginal_posterior, hyperparameters, noise_memory):
            monkeypatch.setattr(module, "padded_size", lambda n, *_, **__: n)

    return pad_nothing


def results(campaign, effects, drive):
    """All that is read from programs: estimate, density and nuisances around it."""
    model = Model(campaign, by_name(effects), drive)
    found = estimate(model, starts=1)
    frozen, rng = marginal(found), np.random.default_rng(1)
    thetas = found.theta + 0.5 * found.sd * rng.normal(size=(6, len(found.theta)))
    density = log_posterior(model.structure, frozen, thetas)
    noise = rng.normal(size=3 + found.point.local.size)
    drawn = conditional_point(model.structure, frozen, thetas[1], noise)
    s = unpadded_sensitivities(model, found.point, found.white, found.free)
    return found, density - density[0], np.asarray(drawn.local), jax.tree.leaves(s)


@pytest.mark.parametrize(("effects", "drive"), CASES)
def test_padding_changes_nothing_but_rounding(odd, unpadded, effects, drive):
    ours, density, local, derivatives = results(odd, effects, drive)
    unpadded()
    plain, density_plain, local_plain, derivatives_plain = results(odd, effects, drive)
    assert np.abs((ours.theta - plain.theta) / plain.sd).max() < 1e-6
    np.testing.assert_allclose(ours.sd, plain.sd, rtol=1e-7)
    np.testing.assert_allclose(ours.information.chi2, plain.information.chi2, rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(ours.information.n_data, plain.information.n_data)
    assert ours.dispersion_factor == pytest.approx(plain.dispersion_factor, rel=1e-7)
    np.testing.assert_allclose(density, density_plain, atol=1e-6)
    np.testing.assert_allclose(local, local_plain, atol=1e-6)
    for x, y in zip(derivatives, derivatives_plain, strict=True):
        assert np.isfinite(x).all()
        np.testing.assert_allclose(x, y, rtol=1e-6, atol=1e-7 * np.abs(y).max(initial=1.0))


def test_padding_with_weight_would_be_seen(odd, monkeypatch):
    """Negative control: noise that is repeated into the padding counts the last row again."""
    found = estimate(Model(odd), starts=1)
    structure, frozen = found.model.structure, marginal(found)
    thetas = found.theta + np.array([[0.0], [0.5]]) * found.sd
    right = log_posterior(structure, frozen, thetas)
    monkeypatch.setattr(each_slew, "filled", repeated)
    wrong = log_posterior(structure, frozen, thetas)
    assert abs(np.diff(wrong) - np.diff(right)) > 1e-3
