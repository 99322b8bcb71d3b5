"""Plans compared: what is expected against what simulated campaigns achieve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.errors import CampaignError
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.studies.plan_comparison import (
    compare_plans,
    fit_simulated_campaigns,
    simulated_fits,
)


@pytest.mark.long
@pytest.mark.slow
def test_comparison_predicts_what_simulated_campaigns_achieve(designed, mission):
    plans = {"paper": paper_like_plan(), "designed": designed.plan}
    paper, better = compare_plans(plans, mission, simulated=16)
    assert better.worst_cross_term < paper.worst_cross_term / 1.5
    assert paper.total_time == pytest.approx(1855.0)
    for contender in (paper, better):
        z = contender.achieved.errors / contender.expected
        each = np.mean(z**2, axis=1)  # one number a campaign: its nine errors belong together
        error = np.std(each, ddof=1) / np.sqrt(len(each))
        assert abs(each.mean() - 1.0) < 4.0 * error
        assert not abs((4.0 * each).mean() - 1.0) < 4.0 * (
            4.0 * error
        )  # sds half as large would be noticed
    with pytest.raises(CampaignError, match="one name"):
        compare_plans([paper_like_plan(), paper_like_plan()], mission)


@pytest.mark.long
@pytest.mark.slow
def test_equal_seeds_meet_equal_truths(mission):
    plan = paper_like_plan()
    short = replace(plan, slews=plan.slews[:1], telemetry_period=1.0)
    first, again, other = (
        fit_simulated_campaigns(simulated_fits(short, mission, 1, seed)) for seed in (4, 4, 5)
    )
    np.testing.assert_array_equal(first.errors, again.errors)
    assert not np.array_equal(first.errors, other.errors)
