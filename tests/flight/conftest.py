"""The MOST-like mission, for all tests of flights."""

from __future__ import annotations

import pytest

from bayes_inertia.flight.mission import Mission, most_like_mission
from bayes_inertia.flight.spacecraft import Spacecraft


@pytest.fixture(scope="module")
def mission() -> Mission:
    return most_like_mission()


@pytest.fixture(scope="module")
def craft(mission) -> Spacecraft:
    return mission.spacecraft
