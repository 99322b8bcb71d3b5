"""The MOST-like mission, and one plan designed for it, shared by all tests of designs."""

from __future__ import annotations

import pytest

from bayes_inertia.design.designer import design_plan
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.spacecraft import (
    most_like_prior,
    most_like_spacecraft,
)


@pytest.fixture(scope="session")
def craft():
    return most_like_spacecraft()


@pytest.fixture(scope="session")
def prior():
    return most_like_prior()


@pytest.fixture(scope="session")
def mission(craft, prior):
    return Mission(craft, prior)


@pytest.fixture(scope="session")
def designed(mission, computed_once):
    return computed_once(
        "designed", lambda: design_plan(mission, candidates=150, starts=3, draws=2, seed=1)
    )
