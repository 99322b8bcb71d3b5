"""Series of campaigns whose truth is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from support.told_campaigns import PRIOR_MEAN, PRIOR_SD, campaign_of

from bayes_inertia.inference.likelihood_summary import LikelihoodSummary


@pytest.fixture
def series() -> Callable[..., list[LikelihoodSummary]]:
    """Campaigns of one spacecraft: `series(seed, jump=(after, element, share), walk=...)`."""

    def made(seed, *, jump=None, walk=0.0, campaigns=6, narrower=1.0, n=9):
        rng = np.random.default_rng(seed)
        truth = rng.normal(PRIOR_MEAN[:n], 0.5 * PRIOR_SD[:n])
        told = []
        for k in range(campaigns):
            if jump is not None and k == jump[0] + 1:
                truth = truth.copy()
                truth[jump[1]] *= 1.0 + jump[2]
            told.append(campaign_of(truth, rng, f"campaign {k + 1}", narrower))
            truth = truth + walk * rng.standard_normal(n) * np.repeat([2.4, 1.0], [6, n - 6])
        return told

    return made
