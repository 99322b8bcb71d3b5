"""A joint prior of J and K: what it is, where it is read from, and that copies keep it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import bayes_inertia as bi
from bayes_inertia.campaign.reader import campaign_sha256, copy_campaign
from bayes_inertia.physics.small_campaign import small_campaign

NAMES = ("Jxx", "Jyy", "K1")
COVARIANCE = np.array([[4e-4, 1e-4, 0.0], [1e-4, 9e-4, 2e-6], [0.0, 2e-6, 1e-6]])
PRIOR = bi.GaussianPrior(NAMES, [3.2, 2.2, 1.01], COVARIANCE, beyond_sd=[1e-3, 0.0, 0.0])


def run_with(folder, content):
    folder.mkdir()
    (folder / "summary.json").write_text(json.dumps(content), encoding="utf-8")
    return folder


@pytest.fixture
def run(tmp_path):
    return run_with(tmp_path / "run", {"as_prior": PRIOR.json()})


@pytest.fixture
def folder(tmp_path, run):
    """A campaign folder that names a run."""
    folder = bi.write_campaign(small_campaign(), tmp_path / "campaign")
    with open(folder / "campaign.toml", "a", encoding="utf-8") as file:
        file.write('\n[prior]\nfrom = "../run"\ninflate = { relative = 1e-3 }\n')
    return folder


def test_a_run_is_a_prior(run):
    assert bi.prior_in(run) == bi.prior_in(run / "summary.json") == PRIOR


def test_inflation_adds_a_stated_sd_to_each_parameter_alone():
    wider = PRIOR.inflated(1e-2)
    added = wider.covariance - COVARIANCE
    np.testing.assert_allclose(np.sqrt(np.diag(added)), [0.027, 0.027, 0.0101])
    np.testing.assert_array_equal(added - np.diag(np.diag(added)), 0.0)
    assert PRIOR.inflated(0.0) == PRIOR


def test_a_campaign_names_the_run_that_was_before(folder):
    assert bi.read_campaign(folder).prior == PRIOR.inflated(1e-3)


def test_a_copy_keeps_the_prior_and_the_digest(folder, run, tmp_path):
    digest = campaign_sha256(folder)
    copy = copy_campaign(folder, tmp_path / "elsewhere" / "copy")
    (run / "summary.json").unlink()
    assert bi.read_campaign(copy).prior == PRIOR.inflated(1e-3)
    assert campaign_sha256(copy) == digest


def test_another_result_is_another_campaign(folder, run):
    before = campaign_sha256(folder)
    other = replace(PRIOR, mean=PRIOR.mean + 1e-3).json()
    (run / "summary.json").write_text(json.dumps({"as_prior": other}), encoding="utf-8")
    assert campaign_sha256(folder) != before


def test_a_written_campaign_reads_back_with_its_prior(tmp_path):
    bounded = replace(PRIOR, lower=[3.0, -np.inf, 0.9], logarithmic=("Jyy",))
    campaign = replace(small_campaign(), prior=bounded)
    assert bi.read_campaign(bi.write_campaign(campaign, tmp_path / "c")).prior == bounded


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({}, "it holds no 'as_prior'; fit that campaign again"),
        ({"as_prior": None}, "the result is not trusted"),
        ({"as_prior": {"names": ["Jxx"]}}, "no prior of J and K"),
        ({"as_prior": PRIOR.json() | {"mean": [1.0]}}, "3 names do not fit the numbers"),
    ],
)
def test_what_is_no_prior_is_said(tmp_path, content, says):
    with pytest.raises(bi.CampaignError, match=says):
        bi.prior_in(run_with(tmp_path / "other", content))


def test_a_run_that_is_not_there_is_named_with_its_key(folder, run):
    (run / "summary.json").unlink()
    with pytest.raises(bi.CampaignError, match=r"campaign\.toml, key prior\.from"):
        bi.read_campaign(folder)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"names": ("Jxx", "Jxx", "K1")}, "a name is used twice"),
        ({"mean": [3.2, np.nan, 1.0]}, "not finite"),
        ({"covariance": -COVARIANCE}, "a variance is not above zero"),
        ({"covariance": COVARIANCE + np.triu(COVARIANCE, 1)}, "not symmetric"),
        ({"covariance": np.ones((3, 3))}, "not positive definite"),
        ({"logarithmic": ("Jzz",)}, "names what has no mean"),
    ],
)
def test_what_is_no_distribution_is_refused(changes, says):
    with pytest.raises(bi.CampaignError, match=says):
        replace(PRIOR, **changes)
