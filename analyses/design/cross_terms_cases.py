"""The spacecraft, plans and ranges of `cross_terms.py`."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.spacecraft import (
    most_like_prior,
    most_like_spacecraft,
)

DEGREE = math.pi / 180.0
CRAFT, PRIOR = replace(most_like_spacecraft(), bias=(0.0, 0.0, 0.0)), most_like_prior()
MISSION = Mission(CRAFT, PRIOR)
MISALIGNMENT = "rate_sensor_misalignment"
RATES = np.array([0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.4, 2.0])  # [deg/s]
NUMBERS = np.array([1, 2, 3, 4, 5, 7, 10])
NOISES = np.array([0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0])
# What is fitted and measured: (tachometers, misalignment fitted).
CASES = {
    "tachometers, misalignment known": (True, False),
    "no tachometers": (False, False),
    "misalignment fitted": (True, True),
    "no tachometers, misalignment fitted": (False, True),
}
