"""How far slews disagree: against simulated pulls of slews that agree, and that do not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.slew_shares import SlewScatter, SlewShares

SLEWS, UNKNOWNS, CAMPAIGNS = 5, 4, 400


@pytest.fixture(scope="module")
def matrices() -> np.ndarray:
    """Normal matrices (slews, k, k): the last unknown rests on the last slew alone."""
    rng = np.random.default_rng(7)
    rows = rng.normal(size=(SLEWS, 12, UNKNOWNS)) * [1.0, 30.0, 1e3, 1.0]
    rows[:-1, :, -1] *= 1e-3
    return np.einsum("sni,snj->sij", rows, rows)


def scatters(matrices: np.ndarray, noise: float) -> list[SlewScatter]:
    """Fits of campaigns whose slews scatter `noise` times as much as the model says."""
    rng, found = np.random.default_rng(8), []
    roots = np.linalg.cholesky(matrices)
    prior = np.diag(1e-3 * np.diag(matrices.sum(0)))
    for _ in range(CAMPAIGNS):
        pulls = noise * np.einsum("sij,sj->si", roots, rng.normal(size=(SLEWS, UNKNOWNS)))
        towards = np.sqrt(np.diag(prior)) * rng.normal(size=UNKNOWNS)
        optimum = np.linalg.solve(matrices.sum(0) + prior, pulls.sum(0) + towards)
        gradient = np.einsum("sij,j->si", matrices, optimum) - pulls
        found.append(SlewScatter(SlewShares(matrices, gradient, prior, prior @ optimum - towards)))
    return found


def test_slews_that_agree_are_said_to_agree(matrices):
    """The p-value is uniform, so that one campaign in a hundred is widened by chance."""
    agreeing = [scatter.dispersion for scatter in scatters(matrices, 1.0)]
    assert stats.kstest([d.p_value for d in agreeing], "uniform").pvalue > 1e-3
    widened = sum(d.factor > 1.0 for d in agreeing)
    assert abs(widened - LIMITS.disagree_below * CAMPAIGNS) < 3.3 * np.sqrt(
        CAMPAIGNS * LIMITS.disagree_below * (1.0 - LIMITS.disagree_below)
    )
    # All unknowns of all slews, but for those that the fit takes.
    taken = np.trace(np.linalg.solve(matrices.sum(0), matrices.sum(0)))
    assert agreeing[0].dof == pytest.approx(SLEWS * UNKNOWNS - taken, abs=0.01)


def test_slews_that_disagree_widen_the_sds_by_as_much(matrices):
    found = [scatter.dispersion for scatter in scatters(matrices, 2.0)]
    ratios, dof = np.array([d.ratio for d in found]), found[0].dof
    error = 4.0 * np.sqrt(2.0 / dof / CAMPAIGNS)
    assert np.mean(ratios) == pytest.approx(4.0, abs=4.0 * error)
    power = stats.chi2.sf(stats.chi2.isf(LIMITS.disagree_below, dof) / 4.0, dof)
    seen = np.mean([d.factor > 1.0 for d in found])
    assert abs(seen - power) < 3.3 * np.sqrt(power * (1.0 - power) / CAMPAIGNS)


def test_the_bias_reduced_variance_is_right_on_average_and_says_how_little_it_knows(matrices):
    found = scatters(matrices, 1.0)
    variance = np.array([scatter.cr2_sd**2 for scatter in found])
    exact = np.diag(found[0].covariance)
    error = np.std(variance, axis=0) / np.sqrt(CAMPAIGNS)
    assert np.all(np.abs(variance.mean(0) - exact) < 4.0 * error)
    dof = found[0].cr2_dof
    # Satterthwaite: the scatter of the variance is that of chi^2 with these degrees of freedom.
    np.testing.assert_allclose(2.0 * exact**2 / np.var(variance, axis=0), dof, rtol=0.35)
    assert dof[-1] < 1.5 < dof[:-1].min()
