"""Programs of one padded slew give what those of the slew as it is give."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest

from bayes_inertia.inference import hyperparameters, likelihood, marginal_posterior, noise_model
from bayes_inertia.inference.laplace import marginal
from bayes_inertia.inference.likelihood import information_blocks, unpadded_sensitivities
from bayes_inertia.inference.marginal_posterior import conditional_point, log_density_of
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.maths import device_arrays
from bayes_inertia.maths.device_arrays import repeated
from bayes_inertia.physics import packing
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model

CASES = [
    ((), "commanded"),
    pytest.param((), "measured", marks=pytest.mark.long),
    pytest.param(("rate_random_walk",), "commanded", marks=pytest.mark.long),
    pytest.param(("wheel_friction", "rate_sensor_delay"), "commanded", marks=pytest.mark.long),
]


@pytest.fixture(scope="module")
def odd(flying, setup_type):
    """A campaign of which no number is a size: five slews of 89 rows, 8 fixes each."""
    turns = ((0.6, 0.1, 0.0), (0.1, 0.5, 0.5), (0.0, 0.7, 0.2), (0.1, -0.2, 0.8), (0.3, 0.3, 0.0))
    return flying(21, setup_type(turns=turns, rows=89)).campaign


@pytest.fixture
def unpadded(monkeypatch):
    """Every axis in its own size."""

    def pad_nothing():
        for module in (packing, marginal_posterior, hyperparameters, noise_model, device_arrays):
            monkeypatch.setattr(module, "padded_size", lambda n, *_, **__: n)

    return pad_nothing


def results(found, model):
    """All that is read from programs around an estimate: densities, nuisances, derivatives."""
    frozen, rng = marginal(replace(found, model=model)), np.random.default_rng(1)
    thetas = found.theta + 0.5 * found.sd * rng.normal(size=(6, len(found.theta)))
    density = log_density_of(model.structure, frozen, batch=32)(thetas)
    noise = rng.normal(size=3 + found.point.local.size)
    drawn = conditional_point(model.structure, frozen, thetas[1], noise)
    s = unpadded_sensitivities(model, found.point, found.white, found.free)
    information = information_blocks(model, found.point, found.white)
    return density - density[0], np.asarray(drawn.local), information, jax.tree.leaves(s)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(("effects", "drive"), CASES)
def test_padding_changes_nothing_but_rounding(odd, unpadded, effects, drive):
    model = Model(odd, by_name(effects), drive)
    found = estimate(model, starts=1)
    density, local, information, derivatives = results(found, model)
    unpadded()
    model = Model(odd, by_name(effects), drive)
    density_plain, local_plain, plain, derivatives_plain = results(found, model)
    np.testing.assert_allclose(density, density_plain, atol=1e-6)
    np.testing.assert_allclose(local, local_plain, atol=1e-6)
    np.testing.assert_array_equal(information.n_data, plain.n_data)
    np.testing.assert_allclose(information.chi2, plain.chi2, rtol=1e-7, atol=1e-9)
    pairs = zip((*derivatives, information.matrix), (*derivatives_plain, plain.matrix), strict=True)
    for x, y in pairs:
        assert np.isfinite(x).all()
        np.testing.assert_allclose(x, y, rtol=1e-6, atol=1e-7 * np.abs(y).max(initial=1.0))


@pytest.mark.slow
def test_padding_with_weight_would_be_seen(odd, monkeypatch):
    """Negative control: noise that is repeated into the padding counts the last row again."""
    found = estimate(Model(odd), starts=1)
    structure, frozen = found.model.structure, marginal(found)
    thetas = found.theta + np.array([[0.0], [0.5]]) * found.sd
    right = log_density_of(structure, frozen, batch=32)(thetas)
    monkeypatch.setattr(likelihood, "filled", repeated)
    wrong = log_density_of(structure, frozen, batch=32)(thetas)
    assert abs(np.diff(wrong) - np.diff(right)) > 1e-3
