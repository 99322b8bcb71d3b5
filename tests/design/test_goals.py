"""Goals: their numbers, and their texts."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayes_inertia
from bayes_inertia.design.goals import Goal, correction_sensitivity, criterion, parse_goal
from bayes_inertia.errors import CampaignError
from bayes_inertia.flight.closed_loop_flights import predict_final_errors
from bayes_inertia.flight.plan import Plan, PlannedSlew
from bayes_inertia.flight.spacecraft import (
    Controller,
)

DEGREE = math.pi / 180.0


def test_goals_are_what_they_say():
    covariance = np.diag(np.arange(1.0, 14.0) ** 2) * 1e-6
    sd = np.sqrt(np.diag(covariance))
    theta, unit = np.ones(13), np.ones(13)
    of = {
        kind: float(criterion(Goal(kind), covariance, theta, unit))
        for kind in ("cross_terms", "inertia", "scale_factors")
    }
    assert of["cross_terms"] == pytest.approx(sd[5])
    assert of["scale_factors"] == pytest.approx(sd[8])
    assert of["inertia"] == pytest.approx(np.exp(np.mean(np.log(sd[:6]))))
    separate = float(
        criterion(parse_goal("separate:a,b"), covariance, theta, 2.0 * unit, ((9, 11), (11, 13)))
    )
    assert separate == pytest.approx(np.exp(np.mean(np.log(sd[9:] / 2.0))))


def test_correction_slew_is_that_of_the_closed_loop(craft, mission):
    """60 deg about one axis by a controller whose scale factors are off, against the formula."""
    plan = Plan("one", (PlannedSlew((1.0, 1.0, 0.0), 60.0 * DEGREE),))
    theta, off = mission.theta, 1e-4 * np.array([1.0, -2.0, 1.5])
    drawn = theta.copy()
    drawn[6:9] *= 1.0 + off
    controller = Controller(craft.inertia_B, craft.scale_factor)
    error = np.diff(
        predict_final_errors(
            np.array([theta, drawn]),
            plan,
            replace(mission, spacecraft=replace(craft, bias=(0.0, 0.0, 0.0))),
            controller,
        ),
        axis=0,
    )[0]
    forms = [form @ off for form in correction_sensitivity()]
    assert min(
        min(np.linalg.norm(error - f), np.linalg.norm(error + f)) for f in forms
    ) < 0.02 * np.linalg.norm(error)


def test_the_turn_whose_correction_is_forecast_stands_in_one_place():
    package = Path(bayes_inertia.__file__).parent
    constant = re.compile(r"^ *\w*(angle|turn)\w*(: float)? = .*\b60\b", re.MULTILINE | re.I)
    files = [path.name for path in package.rglob("*.py") if constant.search(path.read_text())]
    assert files == ["numerics.py"]


def test_unknown_goals_name_the_nearest():
    with pytest.raises(CampaignError, match="did you mean cross_terms"):
        parse_goal("cross_term")
    with pytest.raises(CampaignError, match="two different effects"):
        parse_goal("separate:wheel_friction")
