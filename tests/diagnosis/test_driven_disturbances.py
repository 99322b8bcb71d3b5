"""Disturbances that follow something known, and how well each explains what a fit leaves."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.diagnosis.formulas import drivers, told_blocks
from bayes_inertia.diagnosis.hypothesis_table import log_evidence_of_columns
from bayes_inertia.diagnosis.torque_response import torque_response
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign

TIME = "campaign_time"


def estimate_of(campaign):
    return estimate(Model(campaign), starts=1)


def evidence_in(estimate):
    """Log evidence of each disturbance in proportion to something, by place and driver."""
    found, fit = {}, estimate.linearised()
    for block in told_blocks(torque_response(estimate)):
        matrix, gradient = fit.projected(block.columns)
        value = log_evidence_of_columns(gradient, matrix)
        found[block.formula.place, block.formula.driver] = value
    return found


@pytest.mark.long
@pytest.mark.slow
def test_coasting_wheels_are_no_driver():
    campaign = small_campaign()
    coasting = replace(
        campaign,
        slews=tuple(replace(s, wheel_torque=np.zeros_like(s.wheel_torque)) for s in campaign.slews),
    )
    evidence = evidence_in(estimate_of(coasting))
    assert evidence
    assert not any("command" in driver for _, driver in evidence)
    assert np.isfinite(list(evidence.values())).all()


@pytest.mark.slow
def test_the_campaigns_clock_may_count_from_any_epoch():
    """With seconds counted from 1970 the time in the campaign is no twin of a constant."""
    campaign = small_campaign()
    late = replace(campaign, slews=tuple(replace(s, start=s.start + 1.7e9) for s in campaign.slews))
    now, then = estimate_of(campaign), estimate_of(late)
    times = [
        next(d.values for d in drivers(torque_response(at)) if d.key == TIME) for at in (now, then)
    ]
    np.testing.assert_allclose(times[1], times[0], atol=1e-5)
    assert abs(times[1].min() + times[1].max()) < 1e-5
    before, after = evidence_in(now), evidence_in(then)
    for source in ("body_torque", "rate_error"):
        assert after[source, TIME] == pytest.approx(before[source, TIME], abs=1e-5)
        assert abs(after[source, TIME] - after[source, "constant"]) > 1e-4
