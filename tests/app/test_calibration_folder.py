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

    def begin(*, small_sds: bool) -> None:
        def fit(self, task_id, seed):
            rng = np.random.default_rng(seed)
            last = STUDIES_LIMITS.ranked_draws
            rank = rng.integers(0, last + 1, len(QUANTITIES))
            rank = np.where(rank > last // 2, last, 0) if small_sds else rank
            row = {"rank": rank, "explained": True, "nested_rhat": 1.0}
            return row | {key: rng.uniform(1.0, 2.0, len(rank)) for key in ("truth", "mean", "sd")}

        monkeypatch.setattr(CalibrationFit, "__call__", fit)

    return begin


@pytest.mark.slow
def test_right_and_wrong_posteriors_are_told_apart(ranked, tmp_path: Path, capsys):
    ranked(small_sds=False)
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
    ranked(small_sds=True)
    wrong = run_calibration(tmp_path / "wrong", fits=20, cases=["two-slews"])
    assert {name for _, name in wrong.rejected} == set(QUANTITIES)
    with pytest.raises(OutputError, match="other seed"):
        run_calibration(tmp_path / "wrong", fits=20, cases=["two-slews"], seed=1)
    with pytest.raises(SettingsError, match="choose from five-slews"):
        run_calibration(tmp_path / "none", cases=["six-slews"])
    with pytest.raises(SettingsError, match="4 fits for 5 cases"):
        run_calibration(tmp_path / "none", fits=4)
