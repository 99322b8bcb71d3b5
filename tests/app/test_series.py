"""`history` and `fleet`: from runs that were made to an answer, a file and a page."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.told_campaigns import PRIOR_MEAN, PRIOR_SD, campaign_of

import bayes_inertia as bi
from bayes_inertia.app.cli import main
from bayes_inertia.app.result_folder import write_json
from bayes_inertia.report.series_sections import history_answer
from bayes_inertia.sealing import sealed
from bayes_inertia.series.history import History


def call(*words) -> int:
    try:
        main([str(word) for word in words])
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


@pytest.fixture(params=[9, 6], ids=["three_K", "no_rate_sensor"])
def runs(tmp_path, request):
    """Folders of runs: Jzz is 1 % smaller from the third on; the last one is refused."""
    rng = np.random.default_rng(4)
    truth = rng.normal(PRIOR_MEAN, 0.5 * PRIOR_SD)[: request.param]
    after = truth * np.where(np.arange(truth.size) == 2, 0.99, 1.0)
    told = [
        campaign_of(x, rng, name)
        for x, name in zip((truth, truth, after, after), "abcd", strict=True)
    ]
    folders = []
    for summary in (*told, None):
        folder = tmp_path / f"run_{len(folders)}"
        folder.mkdir()
        name = "refused" if summary is None else summary.campaign
        likelihood = None if summary is None else summary.json()
        content = sealed({"campaign": name, "likelihood": likelihood})
        write_json(folder / "summary.json", content)
        folders.append(folder)
    return folders


def test_history_dates_a_change_and_says_what_it_leaves_out(runs, tmp_path, capsys):
    out = tmp_path / "history"
    assert call("history", *runs, "-o", out) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "J changed between b and c (probability above 99.9 %): Jzz by" in printed
    assert "left out, because their result must not be used: refused" in printed
    content = json.loads((out / "history.json").read_text())
    assert content["left_out"] == ["refused"]
    assert content["jumps"][0]["between"] == ["b", "c"]
    page = (out / "history.html").read_text()
    assert "must not be used: refused" in page


@pytest.mark.parametrize(("share", "another"), [(0.01, False), (0.2, True)])
def test_history_of_two_campaigns_says_that_something_changed(share, another, tmp_path, capsys):
    """One step: nothing tells a jump from a wander, and that J changed is certain."""
    rng, folders = np.random.default_rng(9), [tmp_path / name for name in "ab"]
    changed = PRIOR_MEAN * np.where(np.arange(9) == 2, 1.0 + share, 1.0)
    for folder, truth in zip(folders, (PRIOR_MEAN, changed), strict=True):
        folder.mkdir()
        told = campaign_of(truth, rng, folder.name).json()
        write_json(folder / "summary.json", sealed({"campaign": "x", "likelihood": told}))
    assert call("history", *folders, "-o", tmp_path / "history") == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "no change" not in printed
    assert "wanders from campaign to campaign" not in printed
    assert printed.startswith("J changed") or "J changed between a and b" in printed
    content = json.loads((tmp_path / "history" / "history.json").read_text())
    assert content["changed"]["J"] > 0.99 > content["changed"]["K"]
    assert ("check that all campaigns are of one spacecraft" in printed) == another


def test_a_change_that_no_jump_explains_is_told_without_one():
    """Of a wander alone between two campaigns no jump is weighed, and there is none to date."""
    two = np.zeros((2, 9))
    history = History(("a", "b"), two, two, two, two, (), {"K": 0.98}, {"K": 0.98})
    wanted = "K changed (probability 98 %): a little from each campaign to the next (98 %)"
    assert history_answer(history) == wanted


def test_python_asks_as_the_command_does(runs, tmp_path, capsys):
    out, days = tmp_path / "history", pd.date_range("2026-01-01", periods=5, freq="30D")
    assert call("history", *runs, "-o", out) == 0
    told, history = json.loads((out / "history.json").read_text()), bi.history(runs, time=days)
    assert history.left_out == ("refused",)
    assert history.jumps[0].probability == told["jumps"][0]["probability"]
    text = repr(history).splitlines()
    jump = "a jump of J after number 2 has the probability 100.0 %"
    left_out = "left out, not to be used: refused"
    assert text[0] == f"History of 4 campaigns: {jump}; {left_out}"
    shortened = replace(bi.fleet({"a": runs[:1], "b": runs[2:3]}), left_out=("refused",))
    assert left_out in repr(shortened)
    assert text[1].startswith("Jxx ")
    assert "<td>Jzz</td>" in history._repr_html_()
    table = history.to_dataframe()
    assert list(table["time"]) == list(days[:4])  # the last campaign is left out
    for row in told["campaigns"]:
        for name, values in row["parameters"].items():
            assert table.loc[row["campaign"], name] == values["mean"]
            assert table.loc[row["campaign"], f"{name}_sd"] == values["quoted_sd"]
    assert (table["Jzz_sd"] < table["Jzz_alone_sd"]).all()


def test_what_python_cannot_ask_is_said(runs, tmp_path):
    days = pd.date_range("2026-01-01", periods=5)
    for sources, more, says in (
        (3, {}, "sources: an int is no list"),
        ([3], {}, "sources: an int is no Posterior or str or Path"),
        ([tmp_path], {}, "no finished fit is here; give a Posterior, or the folder"),
        (runs[:1], {}, "1 of 1 campaigns have a result that can be used"),
        (runs, {"time": days[:4]}, "time: shape .4,. of datetime64.ns. for 5 campaigns; give"),
        (runs, {"time": days[::-1]}, "time: times do not increase; give campaigns in the order"),
    ):
        with pytest.raises(bi.CampaignError, match=says):
            bi.history(sources, **more)
    with pytest.raises(bi.CampaignError, match=r'crafts: a list is no Mapping; give ."sat A'):
        bi.fleet([runs[0], runs[1]])
    with pytest.raises(bi.CampaignError, match="crafts: 1 of 2 spacecraft have a result"):
        bi.fleet({"sat A": runs[:2], "sat B": runs[-1]})
    with pytest.raises(bi.SettingsError, match=r"seed: is 1\.5"):
        bi.fleet({"sat A": runs[:2], "sat B": runs[2]}, seed=1.5)


def test_one_usable_campaign_is_no_series(runs, tmp_path, capsys):
    assert call("history", runs[0], runs[-1], "-o", tmp_path / "history") == 2
    assert "1 of 2 campaigns have a result that can be used" in capsys.readouterr().err


def test_a_run_of_an_older_version_is_named(runs, tmp_path, capsys):
    write_json(runs[1] / "summary.json", sealed({"campaign": "old"}))
    assert call("history", *runs, "-o", tmp_path / "history") == 2
    assert "run_1: the run was made by an older version" in capsys.readouterr().err


def fits_in(folder, likelihoods: dict[str, object], **more):
    folder.mkdir()
    rows = more | {
        "campaign": list(likelihoods),
        "likelihood": list(map(json.dumps, likelihoods.values())),
    }
    pq.write_table(pa.table(rows), folder / "fits.parquet")
    return folder


def test_a_fit_of_many_says_which_campaigns_count_in_nothing(tmp_path):
    rng = np.random.default_rng(6)
    told = {f"craft_{k}/c": campaign_of(PRIOR_MEAN, rng).json() for k in range(3)}
    fits = fits_in(tmp_path / "fits", told)
    failure = {"campaign": "craft_1/broken", "error": "CampaignError", "reason": "no column time"}
    write_json(fits / "fit_many.json", {"campaigns": [], "failures": [failure]})
    assert bi.fleet(fits).left_out == bi.history(fits).left_out == ("craft_1/broken",)
    with pytest.raises(bi.CampaignError, match=r"left out too: craft_1/broken$"):
        bi.history(fits, time=[1, 2, 3])
    with pytest.raises(bi.CampaignError, match=r"broken; `pandas\.to_datetime` reads texts"):
        bi.history(fits, time=["2026-01-01"] * 4)
    write_json(fits / "fit_many.json", {})
    assert bi.fleet(fits).left_out == ()
    mixed = fits_in(tmp_path / "mixed", told, includes_wheel_spin=[True, None, False])
    with pytest.raises(bi.CampaignError, match="some results hold the wheels' spin inertia in J"):
        bi.fleet(mixed)


def test_fleet_reads_what_fit_many_wrote(tmp_path, capsys):
    rng = np.random.default_rng(5)
    truth = PRIOR_MEAN + 5e-3 * rng.standard_normal((3, 9))
    told = {
        f"craft_{k}/campaign_{c}": campaign_of(x, rng).json()
        for k, x in enumerate(truth)
        for c in range(2)
    }
    fits = fits_in(tmp_path / "fits", told | {"craft_9/campaign_0": None})
    assert call("fleet", fits, "-o", tmp_path / "fleet") == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "the moments of inertia of 3 spacecraft differ by" in printed
    assert "left out, because their result must not be used: craft_9/campaign_0" in printed
    content = json.loads((tmp_path / "fleet" / "fleet.json").read_text())
    assert [craft["name"] for craft in content["spacecraft"]] == ["craft_0", "craft_1", "craft_2"]
    # The same from runs, named in Python.
    runs = {}
    for name, likelihood in told.items():
        run = tmp_path / name
        run.mkdir(parents=True)
        write_json(run / "summary.json", sealed({"campaign": "of a run", "likelihood": likelihood}))
        runs.setdefault(run.parent.name, []).append(run)
    fleet = bi.fleet(runs)
    of_many = bi.fleet(fits)
    assert of_many.left_out == ("craft_9/campaign_0",)
    assert replace(of_many, left_out=()) == fleet != bi.fleet(runs, seed=1)
    table = fleet.to_dataframe()
    assert repr(fleet).startswith("Fleet of 3 spacecraft\nJxx 3.")
    # Three sisters that differ by far more than each is known tell hardly anything of each other.
    np.testing.assert_allclose(table["K1_sd"], table["K1_alone_sd"], rtol=0.02)
    assert (table["K1_sd"] != table["K1_alone_sd"]).all()
    for craft, x in zip(content["spacecraft"], truth, strict=True):
        assert table.loc[craft["name"], "Jxx"] == craft["parameters"]["Jxx"]["mean"]
        Jxx = craft["parameters"]["Jxx"]
        assert abs(Jxx["mean"] - x[0]) < 5.0 * Jxx["quoted_sd"]


@pytest.mark.parametrize("moved", [pytest.param(0.0, marks=pytest.mark.slow), 0.01])
def test_campaigns_of_one_spacecraft_that_disagree_are_said(moved, tmp_path, capsys):
    """Fuel used between two campaigns, or a campaign in the folder of another spacecraft."""
    rng = np.random.default_rng(8)
    changed = PRIOR_MEAN + moved * np.eye(9)[2] * PRIOR_MEAN
    told = {
        f"craft_{k}/campaign_{c}": campaign_of(changed if k + c == 2 else PRIOR_MEAN, rng).json()
        for k in range(2)
        for c in range(2)
    }
    fits = fits_in(tmp_path / "fits", told)
    assert call("fleet", fits, "-o", tmp_path / "fleet") == (3 if moved else 0)
    said = "campaigns of craft_1 disagree by more than their sds"
    assert (said in " ".join(capsys.readouterr().out.split())) == (moved > 0.0)
    assert (said in (tmp_path / "fleet" / "fleet.html").read_text()) == (moved > 0.0)
    content = json.loads((tmp_path / "fleet" / "fleet.json").read_text())
    assert content["disagree"] == (["craft_1"] if moved else [])


def test_one_spacecraft_is_no_fleet(tmp_path, capsys):
    told = campaign_of(PRIOR_MEAN, np.random.default_rng(6)).json()
    fits = fits_in(tmp_path / "fits", {"craft/a": told, "craft/b": told})
    assert call("fleet", fits, "-o", tmp_path / "fleet") == 2
    assert "1 of 1 spacecraft have a result" in capsys.readouterr().err


@pytest.mark.parametrize("untied", [True, False])
def test_campaigns_of_free_bodies_say_whose_sds_these_are(untied, tmp_path, capsys):
    rng = np.random.default_rng(7)
    for name in "ab":
        told = replace(campaign_of(PRIOR_MEAN, rng, name), is_scale_untied=untied)
        (tmp_path / name).mkdir()
        content = sealed({"campaign": name, "likelihood": told.json()})
        write_json(tmp_path / name / "summary.json", content)
    out = tmp_path / "history"
    assert call("history", tmp_path / "a", tmp_path / "b", "-o", out) == 0
    said = "nothing ties the size of J"
    assert (said in " ".join(capsys.readouterr().out.split())) == untied
    assert (said in (out / "history.html").read_text()) == untied
    assert len(json.loads((out / "history.json").read_text())["notes"]) == untied


def test_the_same_telemetry_counts_once(runs, tmp_path, capsys):
    """Twice in a product of likelihoods, it would make every sd too small by a root of two."""
    for folder, slews in zip(runs, (["1", "2"], ["2", "3"]), strict=False):
        content = json.loads((folder / "summary.json").read_text())
        content["likelihood"] = content["likelihood"] | {"learnt_from": slews}
        write_json(folder / "summary.json", sealed(content))
    assert call("history", *runs, "-o", tmp_path / "history") == 2
    assert "a and b hold the same telemetry, which would count twice" in capsys.readouterr().err
    assert call("history", *runs[1:], "-o", tmp_path / "history") == 0
    told = campaign_of(PRIOR_MEAN, np.random.default_rng(6)).json() | {"learnt_from": ["1"]}
    fits = fits_in(tmp_path / "fits", {"one/a": told, "other/a": told})
    assert call("fleet", fits, "-o", tmp_path / "fleet") == 2
    assert "one/a and other/a" in capsys.readouterr().err


@pytest.mark.slow
def test_a_page_names_the_data_it_is_of(tmp_path):
    told = campaign_of(PRIOR_MEAN, np.random.default_rng(6)).json()
    fits = fits_in(tmp_path / "fits", {"one/a": told, "other/a": told})
    assert call("fleet", fits, "-o", tmp_path / "answer") == 0
    assert "data <b>fits</b>" in (tmp_path / "answer" / "fleet.html").read_text()
