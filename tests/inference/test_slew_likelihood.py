"""Log likelihoods by slew: they add up to the density; ArviZ leaves out what refits leave out."""

from __future__ import annotations

import warnings
from pathlib import Path

import arviz as az
import numpy as np
import pytest
from support.commands import run

import bayes_inertia as bi
from bayes_inertia.diagnosis.score_test import log_evidence_of_fit, log_normalisation
from bayes_inertia.inference.predicted_telemetry import slew_log_likelihood

EXAMPLE = Path(bi.__file__).parent / "example"


@pytest.fixture(scope="module")
def campaign():
    return bi.read_campaign(EXAMPLE)


@pytest.fixture(scope="module")
def density(campaign):
    return bi.log_density(campaign, as_stated=True)


def drawn(density, rng):
    """Draws (4000, d) of a density's own Gaussian."""
    return rng.multivariate_normal(density.mean, density.covariance, 4000, method="cholesky")


def by_slew(density, theta, rng):
    return slew_log_likelihood(density.estimate, theta, density.log_likelihood(theta), rng)


class NoNoise:
    """The bias at its best value in place of a draw."""

    def standard_normal(self, shape):
        return np.zeros(shape)


@pytest.mark.slow
def test_slews_add_up_to_the_density_that_is_sampled(density):
    theta = drawn(density, np.random.default_rng(1))[:50]
    logs, likelihood = by_slew(density, theta, NoNoise()), density.log_likelihood(theta)
    # With the bias at its best value, its prior and its spread make the rest.
    equations = density.estimate.information.matrix
    assert logs.shape == (50, len(equations))
    off = logs.sum(1) - likelihood
    assert np.ptp(off) < 0.2 * np.ptp(likelihood)
    assert np.corrcoef(logs.sum(1), likelihood)[0, 1] > 0.98


@pytest.mark.slow
def test_noise_that_is_not_as_stated_has_no_slews_apart(campaign):
    noise = bi.NoiseModel(rate=bi.ChannelNoise("student_t"))
    fitted = bi.estimate(bi.Model(campaign, noise=noise))
    assert slew_log_likelihood(fitted, fitted.theta[None], np.zeros(1), NoNoise()) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    "template",
    [
        None,
        *(
            pytest.param(name, marks=pytest.mark.long)
            for name in ("gyroless", "microsat", "thruster", "two-gyros")
        ),
    ],
)
def test_leave_one_slew_out_is_that_of_exact_refits(template, tmp_path):
    folder = tmp_path / "flown" if template else EXAMPLE
    if template:
        assert run("new", folder, "--like", template) == 0
    campaign = bi.read_campaign(folder)
    density, rng = bi.log_density(campaign, as_stated=True), np.random.default_rng(1)
    logs = by_slew(density, drawn(density, rng), rng)
    tree = az.from_dict(
        {"posterior": {"x": logs[None, :, 0]}, "log_likelihood": {"slew": logs[None]}}
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        loo = az.loo(tree, pointwise=True)

    def evidence(estimate):
        return log_evidence_of_fit(estimate) - log_normalisation(estimate.model, estimate.white)

    fitted, n = density.estimate, len(campaign.slews)
    exact = []
    for left_out in range(n):
        others = bi.estimate(campaign.subset(i for i in range(n) if i != left_out), discount=False)
        numbers = fitted.information.n_data[left_out].sum()
        exact.append(evidence(fitted) - evidence(others) + 0.5 * numbers)
    # Above a Pareto k of 0.7 a slew tells much that no other does, and ArviZ says so.
    within = np.where(loo.pareto_k.values <= 0.7, 1.0, 1.6)
    assert (np.abs(loo.elpd_i.values - exact) < within).all()
    assert np.ptp(exact) > 20.0


@pytest.mark.slow
def test_arviz_reads_a_posterior_as_it_is():
    campaign = bi.read_campaign(EXAMPLE)
    settings = bi.Settings(seed=1, steps=16, max_steps=16, target_ess=100)
    posterior = bi.fit(campaign, settings=settings, as_stated=True)
    tree = posterior.tree
    assert tree["posterior"].sizes["chain"] == settings.ensembles
    np.testing.assert_array_equal(
        np.stack([tree["posterior"][name].values.ravel() for name in posterior.names], -1),
        posterior.samples,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        summary = az.summary(tree, round_to="none")
        loo = az.loo(tree)
        sense = az.psense_summary(tree)
        compared = az.compare({"a": tree, "b": tree})
    nested = posterior.attributes["diagnostics"]["nested_rhat_max"]
    assert abs(float(summary["r_hat"].max()) - nested) < 0.02
    assert loo.n_data_points == len(campaign.slews)
    assert (sense["likelihood"] > sense["prior"]).all()
    assert np.isfinite(compared["elpd"]).all()
    assert np.isfinite(compared["weight"]).all()
