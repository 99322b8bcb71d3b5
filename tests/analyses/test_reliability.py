"""Probabilities that are too sure are shown to be."""

from __future__ import annotations

import numpy as np
import pytest

ANSWERS = [["nothing", []], ["effects", ["a"]], ["effects", ["b"]], ["effects", ["a", "b"]]]


@pytest.fixture
def module(analysis):
    """`reliability.py`."""
    return analysis("calibration.reliability")


def _campaigns(too_sure: float):
    """Campaigns of four answers; stated evidences are so many times what they should be."""
    rng = np.random.default_rng(5)
    campaigns = []
    for _ in range(400):
        log_evidence = 2.0 * rng.normal(size=4)
        true, stated = (np.exp(t * log_evidence) for t in (1.0, too_sure))
        (_, hidden) = ANSWERS[rng.choice(4, p=true / true.sum())]
        told = zip(ANSWERS, stated / stated.sum(), strict=True)
        campaigns.append({"hidden": hidden, "rows": [[*answer, p, 0.0] for answer, p in told]})
    return campaigns


@pytest.mark.parametrize("too_sure", [1.0, 4.0])
def test_statements_that_are_too_sure_leave_their_band(module, too_sure):
    surest = module.reliability(_campaigns(too_sure))[-1]
    low, high = surest.band
    assert (high < surest.stated) == (too_sure > 1.0)
    assert too_sure > 1.0 or low - 0.02 < surest.stated


def test_each_kind_of_answer_has_its_truth(module):
    told = [
        ["nothing", [], 0.5, 0.0],
        ["effects", ["rate_bias"], 0.3, 0.0],
        ["nameless", [], 0.14, 0.0],
        ["others", [], 0.01, 0.0],  # without those that the study did not list
    ]
    truths = {
        (): 0.5,
        ("rate_bias",): 0.3,
        ("outside_leak",): 0.14,
        ("rate_bias", "wheel_friction"): 0.06,
    }
    for hidden, stated in truths.items():
        bins = module.table_page.by_probability([{"hidden": list(hidden), "rows": told}])
        (true,) = (x["p"] for _, _, some in bins for x in some if x["true"])
        assert true == pytest.approx(stated)
