"""Hidden effects in the telemetry of an independent simulator."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.physics.effects import (
    by_name,
)
from bayes_inertia.physics.forward_model import Model

DATA = Path(__file__).resolve().parents[1] / "data"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("hidden_lag", "wheel_command_lag"),
        pytest.param("hidden_dipole", "magnetic_dipole", marks=pytest.mark.long),
    ],
)
def test_hidden_effects_of_another_simulator_are_found_at_their_true_size(folder, name):
    path = DATA / folder
    truth = json.loads((path / "truth.json").read_text())
    (hidden,) = truth["effects"].values()
    amplitude = hidden["amp"] * np.array(hidden.get("dir", [1.0]))
    expected = np.concatenate(
        [np.array(inertia_tensor.elements(np.array(truth["J_kgm2"]))), truth["K"], amplitude]
    )
    fitted = estimate(Model(read_campaign(path), by_name([name])), starts=1)
    assert np.abs((fitted.theta - expected) / fitted.sd).max() < 3.5
    assert (
        np.abs(amplitude).max() > 10.0 * fitted.sd[9:].max()
    )  # the effect is seen, not merely allowed
    assert not fitted.discounted
    for channel, test in fitted.tests.items():
        low, high = test.interval
        assert low < test.reduced_chi2 < high, channel
