"""Probabilities that are too sure are shown to be, and a temperature mends them."""

from __future__ import annotations

import numpy as np
import pytest


@pytest.fixture
def module(analysis):
    """`reliability.py`."""
    return analysis("calibration.reliability")


def _campaigns(module, too_sure: float):
    """Campaigns of four answers; stated evidences are so many times what they should be."""
    rng = np.random.default_rng(5)
    campaigns = []
    for _ in range(400):
        log_evidence = 2.0 * rng.normal(size=4)
        p = np.exp(log_evidence) / np.exp(log_evidence).sum()
        true = np.arange(4) == rng.choice(4, p=p)
        campaigns.append(module.Campaign(np.full(4, np.log(0.25)), too_sure * log_evidence, true))
    return campaigns


@pytest.mark.slow
@pytest.mark.parametrize("too_sure", [1.0, 4.0])
def test_statements_that_are_too_sure_leave_their_band(module, too_sure):
    campaigns = _campaigns(module, too_sure)
    temperature = module.best_temperature(campaigns[::2])
    assert temperature == pytest.approx(too_sure, rel=0.35)
    surest = module.reliability(campaigns[1::2])[-1]
    assert (surest.band[1] < surest.stated) == (too_sure > 1.0)
    mended = module.reliability(campaigns[1::2], temperature)[-1]
    assert mended.band[0] - 0.02 < mended.stated < mended.band[1] + 0.02


def test_each_kind_of_answer_has_its_truth(module):
    rows = [
        {"kind": "nothing", "effects": []},
        {"kind": "effects", "effects": ["rate_bias"]},
        {"kind": "others", "effects": []},
        {"kind": "nameless", "effects": []},
    ]
    rows = [row | {"log_prior": -1.0, "log_evidence": 0.0} for row in rows]
    truths = {
        (): "nothing",
        ("rate_bias",): "effects",
        ("rate_bias", "wheel_friction"): "others",
        ("outside_leak",): "nameless",
    }
    for hidden, kind in truths.items():
        true = module.campaign_of({"hidden": list(hidden), "hypotheses": rows}).true
        assert [row["kind"] for row, t in zip(rows, true, strict=True) if t] == [kind]
    assert module.hidden_in({"label": "clean"}) == set()
    assert module.hidden_in({"label": "torque_noise"}) == {"torque_noise"}
