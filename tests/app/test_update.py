"""`update` and `fit --prior`: a former run and a new campaign are the joint fit."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.commands import run

import bayes_inertia as bi
from bayes_inertia.app import run_folder
from bayes_inertia.app.result_folder import write_json
from bayes_inertia.sealing import sealed

EXAMPLE = Path(bi.__file__).parent / "example"
J_AND_K = ("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz", "K1", "K2", "K3")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Two campaign folders, made of the example's slews."""
    root, epoch = tmp_path_factory.mktemp("campaigns"), {"epoch": "2026-03-02T12:00:00"}
    example = replace(bi.read_campaign(EXAMPLE), mission=epoch)
    parts = {"a": example.subset(range(3)), "b": example.subset(range(3, 5))}
    return {name: bi.write_campaign(part, root / name) for name, part in parts.items()}


@pytest.mark.parametrize("command", ["update", "fit"])
def test_a_run_without_a_prior_is_refused_before_any_work(command, folders, tmp_path, capsys):
    (tmp_path / "run").mkdir()
    former = {"update": [tmp_path / "run", folders["b"]], "fit": [folders["b"]]}[command]
    options = ["--prior", tmp_path / "run"] if command == "fit" else []
    assert run(command, *former, "-o", tmp_path / "out", *options) == 2
    said = "run: no finished fit is here; give the folder of a finished run"
    assert said in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


def test_a_run_keeps_the_prior_it_began_with(folders, tmp_path):
    prior = bi.GaussianPrior(("Jxx",), [3.3], [[1e-6]])
    begun = run_folder.start(folders["b"], tmp_path / "run", prior=prior)
    assert run_folder.read_run(tmp_path / "run") == begun
    assert begun.prior == prior.json()
    with pytest.raises(bi.OutputError, match="holds a run with other prior"):
        run_folder.start(folders["b"], tmp_path / "run", prior=prior.inflated(1e-3))
    with pytest.raises(bi.OutputError, match="holds a run with other prior"):
        run_folder.start(folders["b"], tmp_path / "run")


def test_telemetry_that_a_former_result_holds_is_refused(folders, tmp_path, capsys):
    first, second = (bi.read_campaign(folders[name]) for name in "ab")
    prior = bi.GaussianPrior(("Jxx",), [3.3], [[1e-6]])
    for known in (
        first.slew_digests["own"],
        first.slew_digests["own"][-1:] + second.slew_digests["own"],
    ):
        content = {"as_prior": replace(prior, learnt_from=known).json()}
        write_json(tmp_path / "summary.json", sealed(content))
        assert run("update", tmp_path, folders["a"], "-o", tmp_path / "out") == 2
        assert "holds this telemetry already: it would count twice" in capsys.readouterr().err
        with pytest.raises(bi.CampaignError, match="would count twice"):
            replace(first, prior=bi.prior_in(tmp_path).inflated(1e-3))
    assert not (tmp_path / "out").exists()
    # Other telemetry takes it.
    content = {"as_prior": replace(prior, learnt_from=first.slew_digests["own"]).json()}
    write_json(tmp_path / "summary.json", sealed(content))
    with_it = replace(second, prior=bi.prior_in(tmp_path))
    assert with_it.slew_digests["former"] == first.slew_digests["own"]


def test_nothing_is_inflated_without_a_former_result(folders, tmp_path, capsys):
    assert run("fit", folders["a"], "-o", tmp_path / "out", "--inflate", "1e-3") == 2
    assert "--inflate: there is no former result to inflate; add --prior" in capsys.readouterr().err


@pytest.mark.slow
def test_an_update_is_the_joint_fit_and_quotes_no_less_than_its_parts(folders, tmp_path):
    assert run("fit", folders["a"], "-o", tmp_path / "a", "--no-report") == 0
    begun = (tmp_path / "a", folders["b"], "-o", tmp_path / "ab", "--no-report")
    assert run("update", *begun) == 0
    first, both = (
        json.loads((tmp_path / name / "summary.json").read_text()) for name in ("a", "ab")
    )
    known, prior = first["as_prior"], bi.prior_in(tmp_path / "a")
    assert prior.names == J_AND_K
    # In one fit, by the estimate: exactly what the command's fit begins with.
    campaign = replace(bi.read_campaign(folders["b"]), prior=prior)
    fitted = bi.estimate(campaign)
    sd = np.array([both["parameters"][name]["sd"] for name in J_AND_K])
    mean = np.array([both["parameters"][name]["q50"] for name in J_AND_K])
    assert np.abs(fitted.sd / sd - 1.0).max() < 0.1
    assert np.abs((fitted.theta - mean) / sd).max() < 1.0
    known_sd = np.sqrt(np.diag(known["covariance"]))
    for i, row in enumerate(both["parameters"].values()):
        assert row["sd"] <= 1.02 * known_sd[i]
        assert row["quoted_sd"] >= 0.98 * row["sd"]
        assert row["observable"]  # by what was known before either
    # The prior is taken off again: the likelihood is that of the second campaign alone.
    alone = bi.estimate(bi.read_campaign(folders["b"]))
    told = np.array(both["likelihood"]["precision"])
    own = np.linalg.inv(alone.covariance) - np.diag(alone.model.space.sd**-2.0)
    assert np.all(np.diag(told) < 1.5 * np.diag(own))
    assert "as_prior" in both
    # What an export needs of the campaign, which begins 1290 s after the epoch.
    assert both["begin_utc"] == "2026-03-02T12:21:30.000"
    np.testing.assert_array_equal(both["wheel_spin_kgm2"], 1e-3 * np.eye(3))
