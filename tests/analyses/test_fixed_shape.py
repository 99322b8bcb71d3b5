"""Campaigns of the naming study: what is hidden in those of each kind, and their seeds."""

from __future__ import annotations

import numpy as np
import pytest


@pytest.fixture
def study(analysis):
    """`fixed_shape.py`."""
    return analysis("naming.fixed_shape")


def test_a_longer_study_flies_the_campaigns_of_a_shorter_one_first(study):
    for kind, hidden in {"clean": 0, "single": 1, "strong": 1, "pair": 2, "triple": 3}.items():
        few, many = study.tasks(kind, 2), study.tasks(kind, 3)
        assert many[: len(few)] == few
        assert {len(effects) for _, _, effects in many} == {hidden}
    assert [label for label, *_ in study.tasks("single", 1)] == list(study.NAMES)


def test_a_text_says_what_is_hidden_and_how_large(analysis):
    kind = analysis("naming.kinds").Kind
    assert kind.of("random_x10/tacho") == kind("random", True, times=10.0)
    assert kind.of("single_0.9/notacho") == kind("single", False, power=0.9)
    assert kind.of("stated/tacho").labels == ["stated"]
    tachometers = {"wheel_torque_noise", "tachometer_noise_walk"}
    measured, unmeasured = (set(kind.of(f"random/{x}").labels) for x in ("tacho", "notacho"))
    assert measured - unmeasured == tachometers


def test_strong_effects_have_factors_and_seeds_of_their_own(study):
    """Names that end alike have one hash."""
    cases = [
        study.Case("strong", label, 0, effects, True)
        for label, _, effects in study.tasks("strong", 1)
    ]
    assert [case.factor for case in cases[:: len(study.NAMES)]] == list(study.FACTORS)
    assert len({case.seed.generate_state(4).tobytes() for case in cases}) == len(cases)
    single = study.Case("single", "rate_bias", 0, cases[0].effects, True)
    assert single.factor == 1.0


def test_what_no_spacecraft_has_is_not_flown(study):
    from analyses.naming.physical_limits import why_not_physical

    J = np.diag([3.0, 2.0, 2.5])
    turned = {"rate_sensor_misalignment": {"angle": np.array([0.087, 0.0, 0.0])}}
    assert why_not_physical(turned, J) == ""
    impossible = {
        "an angle of 0.9 rad": {"rate_sensor_misalignment": {"angle": [0.9, 0.0, 0.0]}},
        "more inertia than": {"flexible_mode": {"coupling": [1.5, 1.5, 0.0]}},
        "no body has": {"inertia_change": {"change": [9.0, 0.0, 0.0, 0.0, 0.0, 0.0]}},
        "times the Earth": {"gravity_gradient": {"factor": -9.0}},
        "a wheel with gain": {"wheel_torque_gain": {"gain": [1.0, -0.2, 1.0]}},
        "a delay of": {"wheel_command_lag": {"tau": 90.0}},
    }
    for words, values in impossible.items():
        assert words in why_not_physical(values, J)
