"""Fixtures that several files of this folder use."""

from __future__ import annotations

import pytest

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.physics.small_campaign import small_campaign


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return small_campaign()
