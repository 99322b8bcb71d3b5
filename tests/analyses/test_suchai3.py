"""The study of a real CubeSat: halves of its sessions, and its page."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analyses.suchai3 import page as pages
from analyses.suchai3.held_out import SHOWN, Predicted, early, halves, summary
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor
from bayes_inertia.campaign.slew import Slew

RESULTS = Path(pages.__file__).parents[1] / "results" / "suchai3"


def slew(name: str, start: float) -> Slew:
    time = np.arange(91.0)
    ones = np.ones((len(time), 3))
    return Slew(name, start, time, rate=0.1 * ones, more={"magnetometer": 1e-5 * ones})


def test_halves_are_of_whole_sessions():
    starts = (0.0, 300.0, 9000.0, 20000.0, 20300.0)
    slews = tuple(replace(slew(f"slew {k}", x), more=None) for k, x in enumerate(starts))
    campaign = Campaign("a", InertiaPrior(np.eye(3), 0.1, 0.1), (), RateSensor(1e-3), None, slews)
    assert halves(campaign) == [[0, 1, 3, 4], [2]]


def test_the_beginning_of_a_slew_tells_its_start():
    shown = early(slew("a", 0.0))
    assert shown[: int(90 * SHOWN) + 1].all()
    assert not shown[int(90 * SHOWN) + 1 :].any()


def test_coverage_counts_readings_within_90_percent_intervals():
    rng = np.random.default_rng(1)
    z = rng.standard_normal((4000, 3))
    zero, sd = np.zeros_like(z), np.full_like(z, 2.0)
    right = Predicted(np.arange(4000.0), 2.0 * z, zero, sd)
    wrong = Predicted(np.arange(4000.0), 6.0 * z, zero, sd)
    told = summary([{"rate": right, "magnetometer": wrong}])
    assert told["rate"]["within_90"] == pytest.approx(0.90, abs=0.01)
    assert told["magnetometer"]["within_90"] < 0.5
    assert told["magnetometer"]["rms"] == pytest.approx(3.0, abs=0.1)


def test_halves_that_agree_are_apart_by_their_sds():
    rows = ((1.0, 0.1), (1.5, 0.3))
    fits = {
        name: {
            "ratios": {"x": {"median": mean, "low": mean - 1.6449 * sd, "high": mean + 1.6449 * sd}}
        }
        for name, (mean, sd) in zip("ab", rows, strict=True)
    }
    assert pages.apart({"fits": fits}, "x") == pytest.approx(-0.5 / math.hypot(0.1, 0.3))


def test_the_committed_page_is_that_of_the_committed_numbers():
    content = json.loads((RESULTS / "tumble.json").read_text())
    held_out = RESULTS / "held_out.json"
    content["held_out"] = json.loads(held_out.read_text()) if held_out.exists() else None
    assert pages.page(content) == (RESULTS / "tumble.md").read_text()
