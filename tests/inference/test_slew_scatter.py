"""How far slews disagree: against simulated pulls of slews that agree, and that do not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.slew_shares import SlewShares

SLEWS, UNKNOWNS, CAMPAIGNS = 5, 4, 400


@pytest.fixture(scope="module")
def matrices() -> np.ndarray:
    """Normal matrices (slews, k, k): the last unknown rests on the last slew alone."""
    rng = np.random.default_rng(7)
    rows = rng.normal(size=(SLEWS, 12, UNKNOWNS)) * [1.0, 30.0, 1e3, 1.0]
    rows[:-1, :, -1] *= 1e-3
    return np.einsum("sni,snj->sij", rows, rows)


def scatters(matrices: np.ndarray, noise: float) -> list[SlewShares]:
    """Fits of campaigns whose slews scatter `noise` times as much as the model says."""
    rng, found = np.random.default_rng(8), []
    roots = np.linalg.cholesky(matrices)
    prior = np.diag(1e-3 * np.diag(matrices.sum(0)))
    for _ in range(CAMPAIGNS):
        pulls = noise * np.einsum("sij,sj->si", roots, rng.normal(size=(SLEWS, UNKNOWNS)))
        towards = np.sqrt(np.diag(prior)) * rng.normal(size=UNKNOWNS)
        optimum = np.linalg.solve(matrices.sum(0) + prior, pulls.sum(0) + towards)
        gradient = np.einsum("sij,j->si", matrices, optimum) - pulls
        found.append(SlewShares(matrices, gradient, prior, prior @ optimum - towards))
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


def two_groups(matrices: np.ndarray, noise: float, apart: float) -> list[SlewShares]:
    """Campaigns of eight slews, of which the last three tell of other unknowns, `apart` sds off."""
    rng, found = np.random.default_rng(9), []
    matrices = np.concatenate([matrices, matrices[:3]])
    roots = np.linalg.cholesky(matrices)
    prior = np.diag(1e-6 * np.diag(matrices.sum(0)))
    sd = np.sqrt(np.diag(np.linalg.inv(matrices[5:].sum(0))))
    change = np.zeros((8, UNKNOWNS))
    change[5:] = apart * sd * [1.0, 1.0, 1.0, 0.0]
    for _ in range(100):
        told = noise * np.einsum("sij,sj->si", roots, rng.normal(size=(8, UNKNOWNS)))
        told += np.einsum("sij,sj->si", matrices, change)
        optimum = np.linalg.solve(matrices.sum(0) + prior, told.sum(0))
        gradient = np.einsum("sij,j->si", matrices, optimum) - told
        found.append(SlewShares(matrices, gradient, prior, prior @ optimum))
    return found


def test_slews_of_two_populations_are_told_apart(matrices):
    found = [scatter.groups for scatter in two_groups(matrices, 1.0, apart=30.0)]
    told = [groups for groups in found if groups is not None]
    # Each group's own agreement is tested at one in a hundred.
    assert len(told) >= 95
    assert {groups.slews for groups in told} == {((0, 1, 2, 3, 4), (5, 6, 7))}
    z = np.array([groups.difference / groups.sd for groups in told])
    assert np.all(z.mean(0)[:3] > 5.0)


def test_slews_that_agree_and_slews_that_all_disagree_are_no_two_groups(matrices):
    """A negative control each: one population, and one a slew."""
    assert not any(scatter.groups for scatter in two_groups(matrices, 1.0, apart=0.0))
    assert sum(scatter.groups is not None for scatter in two_groups(matrices, 4.0, 0.0)) <= 5
