"""`study calibration`: what is written and printed of right ranks and of wrong ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bayes_inertia.app.cli import main
from bayes_inertia.app.study_folder import run_calibration
from bayes_inertia.errors import OutputError, SettingsError
from bayes_inertia.studies.calibration import QUANTITIES, CalibrationFit
from bayes_inertia.studies.limits import LIMITS as STUDIES_LIMITS


@pytest.fixture
def ranked(monkeypatch):
    """Fits that take no time: uniform ranks, or those of sds that are far too small."""

    def fit(self, task_id, seed):
        rng = np.random.default_rng(seed)
        rank = rng.integers(0, STUDIES_LIMITS.ranked_draws + 1, len(QUANTITIES))
        if self.pipeline == "small_sd":
            rank = np.where(rank > STUDIES_LIMITS.ranked_draws // 2, STUDIES_LIMITS.ranked_draws, 0)
        row = {"rank": rank, "explained": True, "nested_rhat": 1.0}
        return row | {key: rng.uniform(1.0, 2.0, len(rank)) for key in ("truth", "mean", "sd")}

    monkeypatch.setattr(CalibrationFit, "__call__", fit)


@pytest.mark.slow
def test_right_and_wrong_posteriors_are_told_apart(ranked, tmp_path: Path, capsys):
    words = ["study", "calibration", "-o", str(tmp_path / "right"), "--fits", "40"]
    with pytest.raises(SystemExit) as stop:
        main([*words, "--cases", "two-slews,effects"])
    assert stop.value.code == 0
    printed = capsys.readouterr().out
    assert "40 fits" in printed
    assert "No quantity is rejected." in printed
    content = json.loads((tmp_path / "right" / "calibration.json").read_text())
    assert content["verdict"] == "not rejected"
    assert content["cases"]["effects"]["fits"] == 20
    assert set(content["cases"]["effects"]["quantities"]) == set(QUANTITIES)
    assert (tmp_path / "right" / "calibration.png").stat().st_size > 10_000
    wrong = run_calibration(tmp_path / "wrong", fits=20, cases=["two-slews"], pipeline="small_sd")
    assert {name for _, name in wrong.rejected} == set(QUANTITIES)
    with pytest.raises(OutputError, match="other pipeline"):
        run_calibration(tmp_path / "wrong", fits=20, cases=["two-slews"])
    with pytest.raises(SettingsError, match="choose from five-slews"):
        run_calibration(tmp_path / "none", cases=["six-slews"])
    with pytest.raises(SettingsError, match="4 fits for 5 cases"):
        run_calibration(tmp_path / "none", fits=4)
