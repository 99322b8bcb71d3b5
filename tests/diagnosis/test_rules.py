"""The thresholds of a diagnosis: what they may be."""

import math

import numpy as np
import pytest

from bayes_inertia.diagnosis.limits import Rules, rules_of
from bayes_inertia.errors import SettingsError


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("false_alarm_probability", 0.0),
        ("false_alarm_probability", 2.0),
        ("misfit_p_value", 1.0),
        ("imitation_correlation", 1.1),
        ("max_refits", 0),
        ("max_refits", 2.5),
        ("max_refits", 6.0),
        ("max_effects", math.nan),
        ("max_effects", math.inf),
        ("max_effects", 0),
        ("log_evidence_margin", -1.0),
        ("log_evidence_margin", math.nan),
        ("max_effects", "four"),
    ],
)
def test_a_threshold_outside_its_range_is_an_error_that_names_it(name, value):
    with pytest.raises(SettingsError, match=name):
        Rules(**{name: value})


def test_numbers_of_numpy_are_numbers_and_a_dictionary_is_no_rules():
    assert Rules(max_effects=np.int64(2), misfit_p_value=np.float32(0.5)) == Rules(
        max_effects=2, misfit_p_value=0.5
    )
    assert rules_of(None) == Rules()
    with pytest.raises(SettingsError, match="a dict is no Rules"):
        rules_of({"max_effects": 2})


def test_the_edges_of_the_ranges_are_inside():
    Rules(imitation_correlation=1.0, max_refits=1, max_effects=1)
    Rules(log_evidence_margin=0.0)
