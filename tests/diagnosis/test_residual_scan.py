"""The scan is calibrated on perfect models, and right about where a fault was planted."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.diagnosis.residuals import scan_residuals, scan_windows
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.forward_model import Model


def fitted(campaign, drive=None):
    return estimate(Model(campaign, (), drive), discount=False, starts=1)


def edited(campaign, index, change):
    slews = list(campaign.slews)
    slews[index] = change(slews[index])
    return replace(campaign, slews=tuple(slews))


@pytest.mark.slow
def test_perfect_campaigns_give_uniform_p_values(flying):
    fits = [fitted(flying(100 + i).campaign) for i in range(12)]
    p = np.array([scan_residuals(at, seed=i).p_value for i, at in enumerate(fits)])
    assert stats.kstest(p, "uniform").pvalue > 1e-3
    n = sum(bool(scan_residuals(at, seed=i).windows) for i, at in enumerate(fits))
    assert n <= stats.binom.ppf(0.9999, len(fits), LIMITS.significant)


@pytest.mark.slow
def test_replicates_have_the_covariance_that_a_fit_leaves(flown):
    fit = fitted(flown.campaign).linearised()
    drawn = fit.replicates(np.random.default_rng(1), 400, np.ones_like(fit.weight))
    hat = sum(
        np.einsum("np,pq,nq->", J, fit.covariance_of(s), J) for s, J in enumerate(fit.columns)
    )
    expected = np.count_nonzero(fit.valid) - hat
    chi2 = np.sum(drawn**2, axis=(0, 1))
    assert abs(chi2.mean() - expected) < 4.0 * np.sqrt(2.0 * expected / 400)
    # What the fit can do, it has done: nothing is left along a well-determined column.
    column = fit.shared[:, :, 0] / np.linalg.norm(fit.shared[:, :, 0])
    assert np.abs(np.einsum("sn,snk->k", column, drawn)).max() < 0.2


@pytest.mark.parametrize(("channel", "column"), [("rate", 1), ("momentum", 2)])
def test_a_planted_offset_is_found_where_it_is(flown, channel, column):
    def change(slew):
        values = getattr(slew, {"rate": "rate", "momentum": "wheel_momentum"}[channel]).copy()
        values[40:56, column] += 4.0 * {"rate": 2e-5, "momentum": 5e-6}[channel]
        return replace(slew, **{{"rate": "rate", "momentum": "wheel_momentum"}[channel]: values})

    found = scan_residuals(fitted(edited(flown.campaign, 1, change)))
    best = found.windows[0]
    assert (best.channel, best.slew) == (channel, "slew 2")
    assert best.component == ("axis 2" if channel == "rate" else "w2")
    assert best.kind == "shift"
    assert best.t_start < 56.0
    assert best.t_end >= 40.0
    assert best.p_value < 1e-6
    same = [w for w in found.windows if (w.channel, w.slew) == (best.channel, best.slew)]
    assert all(
        a.t_end < b.t_start or b.t_end < a.t_start for i, a in enumerate(same) for b in same[:i]
    )


def test_more_noise_is_energy_everywhere_and_none_against_the_measured_noise(flying):
    at = fitted(flying(3, noise=1.5).campaign)
    found = scan_residuals(at)
    assert {w.slew for w in found.windows if w.kind == "energy"} == {"slew 1", "slew 2", "slew 3"}
    from bayes_inertia.inference.optimizer import with_noise

    louder = with_noise(at, dict.fromkeys(("rate", "attitude", "momentum"), 1.5))
    assert scan_residuals(louder, stated=False).p_value > 1e-3
    assert scan_residuals(louder).p_value < 1e-6  # the stated noise is still wrong


@pytest.mark.long
@pytest.mark.slow
def test_measured_drive_without_star_tracker(flying, setup_type):
    campaign = flying(4, setup_type(fix_rows=(), rows=160)).campaign
    found = scan_residuals(fitted(campaign, "measured"))
    assert set(found.cells) == {"rate"}
    assert found.p_value > 1e-3
    assert found.cells["rate"].shift.shape == (3, 3, 60)


def test_the_same_seed_gives_the_same_answer(flown):
    at = fitted(flown.campaign)
    assert scan_residuals(at, seed=5).p_value == scan_residuals(at, seed=5).p_value


def test_windows_cover_everything_and_overlap_by_half():
    start, stop = scan_windows(96, 1)
    assert (start.min(), stop.max()) == (0, 96)
    assert set(np.unique(stop - start)) == {1, 2, 4, 8, 16, 32, 64, 96}
    of_16 = np.sort(start[stop - start == 16])
    assert np.all(np.diff(of_16) == 8)
