"""Fixtures that several files of this folder use."""

from __future__ import annotations

import pytest

from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.forward_model import Model

DRIVES = ("commanded", pytest.param("measured", marks=pytest.mark.slow))


@pytest.fixture(scope="module", params=DRIVES)
def small(request, small_flown):
    """The small campaign's fit in each drive."""
    return estimate(Model(small_flown.campaign, drive=request.param), starts=1)


@pytest.fixture(scope="session")
def small_at(flown):
    return estimate(Model(flown.campaign), seed=1)


@pytest.fixture(scope="session")
def fitted(flown):
    """The fit of the shared campaign."""
    return estimate(Model(flown.campaign), starts=1)
