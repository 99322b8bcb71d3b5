"""`fit-many`: one row a campaign; what is added, changed or mended is fitted, and nothing else."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import pyarrow.parquet as pq
import pytest
from support.commands import run

import bayes_inertia
from bayes_inertia.app.many_folder import fit_many
from bayes_inertia.app.told_torques import refuse_impossible
from bayes_inertia.errors import CampaignError, EffectError, OutputError
from bayes_inertia.physics.parameters import BASE_NAMES

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
TRUTH = json.loads((EXAMPLE / "truth.json").read_text())


@pytest.fixture
def fleet(tmp_path) -> Path:
    """Three campaigns, one of them deeper."""
    for name in ("alpha", "beta", "older/2024"):
        shutil.copytree(EXAMPLE, tmp_path / "fleet" / name)
    return tmp_path / "fleet"


@pytest.fixture
def fitted(monkeypatch) -> list[int]:
    """Fits that take no time; the seeds of those that were made."""
    seeds: list[int] = []

    def fit(campaign, *, settings, **_):
        seeds.append(settings.seed)
        number = {
            "mean": 1.0,
            "sd": 0.01,
            "quoted_sd": 0.011,
            "robust_sd": None,
            "q05": 0.9,
            "q50": 1.0,
            "q95": 1.1,
        }
        summary = {
            "trusted": campaign.name != "bad",
            "gates": [{"name": "prior", "passed": campaign.name != "bad", "says": "far away"}],
            "reasons": [] if campaign.name != "bad" else ["far away"],
            "parameters": dict.fromkeys(BASE_NAMES, number),
            "derived": {"I1": number},
            "likelihood": None,
            "fit": {"reduced_chi2": {"rate": 1.0, "attitude": None, "total": 1.01}, "n_data": 9},
            "diagnostics": {"nested_rhat_max": 1.0, "ess_bulk_min": 9.0, "ess_tail_min": 9.0},
        }
        return SimpleNamespace(summary=lambda: summary)

    monkeypatch.setattr("bayes_inertia.app.many_folder.fit", fit)
    monkeypatch.setattr("bayes_inertia.app.many_folder.refuse_impossible", lambda *_: None)
    return seeds


def append(path: Path, text: str) -> None:
    path.write_text(path.read_text() + text)


def test_a_row_a_campaign_and_a_table(fleet, fitted, tmp_path, capsys):
    out = tmp_path / "out"
    assert run("fit-many", fleet, "-o", out) == 0
    printed = capsys.readouterr().out
    assert "3 of 3 campaigns give a result that can be used" in printed
    table = pq.read_table(out / "fits.parquet").to_pylist()
    assert [row["campaign"] for row in table] == ["alpha", "beta", "older/2024"]
    assert [row["seed"] for row in table] == fitted
    assert len(set(fitted)) == 3
    assert (table[0]["K1_sd"], table[0]["K1_quoted_sd"]) == (0.01, 0.011)
    content = json.loads((out / "fit_many.json").read_text())
    assert content["failures"] == []
    assert content["campaigns"][1]["reduced_chi2_total"] == 1.01
    assert run("fit-many", fleet, "-o", out, "--json") == 0
    assert json.loads(capsys.readouterr().out) == content
    assert len(fitted) == 3


def test_what_was_added_or_changed_is_fitted_and_nothing_else(fleet, fitted, tmp_path):
    out = tmp_path / "out"
    before = fit_many(fleet, out)
    shutil.copytree(EXAMPLE, fleet / "gamma")
    append(fleet / "beta" / "campaign.toml", "# a comment changes the file\n")
    after = fit_many(fleet, out)
    assert len(fitted) == 5
    assert [row["campaign"] for row in after.rows] == ["alpha", "beta", "gamma", "older/2024"]
    unchanged = {row["campaign"]: row for row in before.rows if row["campaign"] != "beta"}
    assert unchanged.items() <= {row["campaign"]: row for row in after.rows}.items()
    # In another place, in another order, alone: the same row.
    moved = fit_many(shutil.move(fleet, tmp_path / "moved"), tmp_path / "again")
    assert moved.rows == after.rows


def test_the_copy_of_a_campaign_that_a_run_keeps_is_no_other_campaign(fleet, fitted, tmp_path):
    for fitted_before in (fleet / "alpha/run", fleet / "runs/beta"):
        shutil.copytree(EXAMPLE, fitted_before / "campaign")
        (fitted_before / "run.json").write_text("{}")
    # Who fitted into the campaign's own folder still has a campaign there.
    (fleet / "beta/run.json").write_text("{}")
    rows = fit_many(fleet, tmp_path / "out").rows
    assert [row["campaign"] for row in rows] == ["alpha", "beta", "older/2024"]
    # A run named as the folder itself: its campaign is meant.
    rows = fit_many(fleet / "alpha/run", tmp_path / "again").rows
    assert [row["campaign"] for row in rows] == ["campaign"]


def test_bad_campaigns_are_reported_and_the_others_fitted(fleet, fitted, tmp_path, capsys):
    out, toml = tmp_path / "out", fleet / "alpha" / "campaign.toml"
    good = toml.read_text()
    toml.write_text(good.replace("[inertia]", "[inertia"))
    (fleet / "older" / "2024" / "slew_01.csv").unlink()
    assert run("fit-many", fleet, "-o", out) == 3
    printed = capsys.readouterr()
    assert "1 of 3 campaigns give a result" in printed.out
    assert "alpha could not be fitted: " in printed.out
    assert "alpha failed: " in printed.err
    assert "@" not in printed.err
    content = json.loads((out / "fit_many.json").read_text())
    assert [failure["campaign"] for failure in content["failures"]] == ["alpha", "older/2024"]
    assert "campaign.toml" in content["failures"][0]["reason"]
    # Mended, they are fitted by the same command.
    toml.write_text(good)
    shutil.copy(EXAMPLE / "slew_01.csv", fleet / "older" / "2024")
    assert run("fit-many", fleet, "-o", out) == 0
    assert len(fitted) == 3


def test_impossible_conventions_are_refused_unless_anyway(fleet, fitted, tmp_path, monkeypatch):
    monkeypatch.setattr("bayes_inertia.app.many_folder.refuse_impossible", refuse_impossible)
    for name in ("alpha", "older"):
        shutil.rmtree(fleet / name)
    toml = fleet / "beta" / "campaign.toml"
    toml.write_text(toml.read_text().replace('"rad/s"', '"deg/s"', 1))
    result = fit_many(fleet, tmp_path / "out")
    assert [failure.task.partition("@")[0] for failure in result.failures] == ["beta"]
    assert "rad/s" in result.failures[0].reason
    assert len(fit_many(fleet, tmp_path / "anyway", anyway=True).rows) == 1


def test_requests_that_cannot_be_are_refused(fleet, fitted, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    with pytest.raises(CampaignError, match=r"holds no campaign\.toml"):
        fit_many(tmp_path / "empty", tmp_path / "x")
    with pytest.raises(EffectError):
        fit_many(fleet, tmp_path / "out", effects=["wheel_friktion"])
    fit_many(fleet, tmp_path / "out")
    with pytest.raises(OutputError, match="other"):
        fit_many(fleet, tmp_path / "out", seed=1)
    assert run("fit-many", tmp_path / "none", "-o", tmp_path / "y") == 2
    assert "no such folder" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.slow
def test_a_real_campaign(tmp_path):
    shutil.copytree(EXAMPLE, tmp_path / "fleet" / "one")
    (row,) = fit_many(tmp_path / "fleet", tmp_path / "out").rows
    assert row["trusted"]
    for k, name in enumerate(("K1", "K2", "K3")):
        assert abs(row[name] - TRUTH["K"][k]) < 5.0 * row[f"{name}_sd"]
    assert row["converged"]
    assert row["explained"]
    assert row["prior"]
