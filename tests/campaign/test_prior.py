"""A joint prior of J and K: what it is, where it is read from, and that copies keep it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bayes_inertia as bi
from bayes_inertia.campaign.reader import campaign_sha256, copy_campaign
from bayes_inertia.maths import inertia_tensor
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


def test_inflation_of_logarithmic_moments_is_one_of_products_in_their_size():
    for size in (1e-2, 1e3):
        moments = size * np.array([3.3, 2.2, 1.9])
        prior = bi.GaussianPrior.of_principal_moments(moments, 0.05, 2.0)
        added = prior.inflated(1e-2).covariance - prior.covariance
        sds = np.sqrt(np.diag(added))
        assert sds[:3] == pytest.approx(1e-2)
        assert sds[3:] == pytest.approx(1e-2 * moments.mean(), rel=0.01)


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
        ({"as_prior": None}, "the result quotes no sd"),
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
        ({"mean": ["a", 1.0, 1.0]}, "prior.mean: no array of numbers"),
        ({"lower": [4.0, 0.0, 0.0], "upper": [3.0, 9.0, 9.0]}, "no value lies between"),
        ({"lower": [np.nan, 0.0, 0.0]}, "no value lies between"),
        ({"beyond_sd": [-0.1, 0.0, 0.0]}, "beyond_sd: one is no sd"),
        ({"beyond_sd": [np.nan, 0.0, 0.0]}, "beyond_sd: one is no sd"),
    ],
)
def test_what_is_no_distribution_is_refused(changes, says):
    with pytest.raises(bi.CampaignError, match=says):
        replace(PRIOR, **changes)


MOMENTS = np.array([3.3, 2.2, 1.6])
# Turned by 24 deg about no axis of the body: rows are principal axes.
AXES = Rotation.from_rotvec([0.3, -0.2, 0.2]).as_matrix()
OF_MOMENTS = """
[prior]
principal_moments = [3.3, 2.2, 1.6]
relative_sd = 0.05
axes_sd_deg = 3.0
scale_factors = [1.0, 1.01, 0.99]
scale_factors_sd = 0.01
"""


def test_draws_have_the_principal_moments_and_axes_that_were_stated():
    prior = bi.GaussianPrior.of_principal_moments(MOMENTS, [0.05, 0.02, 0.1], 3.0, axes_B=AXES)
    rng = np.random.default_rng(1)
    drawn = rng.multivariate_normal(prior.mean, prior.covariance, 20_000)
    drawn[:, :3] = np.exp(drawn[:, :3])
    moments, axes = np.linalg.eigh(inertia_tensor.tensor(drawn))
    wanted = MOMENTS * np.exp([0.05, 0.02, 0.1] * rng.standard_normal((20_000, 3)))
    for share in (0.05, 0.5, 0.95):
        off = np.quantile(moments, share, 0) - np.quantile(np.sort(wanted, 1), share, 0)
        assert np.abs(off / wanted.std(0)[::-1]).max() < 0.15
    # The largest moment's axis turns about the two others.
    cosines = axes[:, :, 2] @ AXES.T
    turns = np.degrees(cosines[:, 1:] / cosines[:, :1])
    np.testing.assert_allclose(turns.std(0), 3.0, rtol=0.1)


def test_moments_about_body_axes_are_logarithmic_and_scale_factors_too():
    prior = bi.GaussianPrior.of_principal_moments(MOMENTS, 0.05, 1.0, scale_factors=(1.0, 1.02))
    assert prior.logarithmic == ("Jxx", "Jyy", "Jzz", "K1", "K2")
    np.testing.assert_allclose(
        np.exp(prior.mean)[[0, 1, 2, 6, 7]], [*MOMENTS, 1.0, 1.02], rtol=1e-3
    )
    np.testing.assert_allclose(prior.sd[[0, 1, 2, 6, 7]], [0.05, 0.05, 0.05, 0.03, 0.03], rtol=0.01)
    # A product of inertia comes from the turn: the moments' difference times its angle.
    assert prior.sd[3] == pytest.approx(1.1 * np.radians(1.0), rel=0.05)


def test_a_description_states_principal_moments(tmp_path):
    folder = bi.write_campaign(small_campaign(), tmp_path / "c")
    with open(folder / "campaign.toml", "a", encoding="utf-8") as file:
        file.write(OF_MOMENTS)
    wanted = bi.GaussianPrior.of_principal_moments(
        MOMENTS, 0.05, 3.0, scale_factors=(1.0, 1.01, 0.99), scale_factors_sd=0.01
    )
    read = bi.read_campaign(folder)
    assert read.prior == wanted
    copy = copy_campaign(folder, tmp_path / "copy")
    assert bi.read_campaign(copy).prior == wanted
    assert campaign_sha256(copy) == campaign_sha256(folder)
    assert bi.read_campaign(bi.write_campaign(read, tmp_path / "again")).prior == wanted
    file = tmp_path / "prior.json"
    said = {"principal_moments": [3.3, 2.2, 1.6], "relative_sd": 0.05, "axes_sd_deg": 3.0}
    file.write_text(
        json.dumps(said | {"scale_factors": [1.0, 1.01, 0.99], "scale_factors_sd": 0.01})
    )
    assert bi.prior_in(file) == wanted


def test_a_description_states_a_gaussian_with_ends(tmp_path):
    folder = bi.write_campaign(small_campaign(), tmp_path / "c")
    with open(folder / "campaign.toml", "a", encoding="utf-8") as file:
        file.write(
            '[prior]\nnames = ["Jxx", "K1"]\nmean = [3.2, 1.0]\nlower = [-inf, 0.97]\n'
            "covariance = [[4e-4, 1e-5], [1e-5, 1e-4]]\ninflate = { relative = 1e-3 }\n"
        )
    prior = bi.read_campaign(folder).prior
    stated = bi.GaussianPrior(
        ("Jxx", "K1"), [3.2, 1.0], [[4e-4, 1e-5], [1e-5, 1e-4]], lower=[-np.inf, 0.97]
    )
    assert prior == stated.inflated(1e-3)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[3.3, 2.2, 1.6]", "[5.3, 2.2, 1.6]", "no body has these moments"),
        ("relative_sd = 0.05", "relative_sd = 0.5", r"at most 0\.2; known worse than that"),
        ("axes_sd_deg = 3.0", "axes_sd_deg = 0.0", "above 0 and at most 10"),
        ("axes_sd_deg = 3.0", "", "missing .*axes_sd_deg.*; give names, mean and covariance; or"),
        ("axes_sd_deg = 3.0", "axes_sd_deg = 3.0\nfrom = 'x'", "says nothing, or two things"),
        ("scale_factors = [1.0,", "scale_factors = [-1.0,", "one is not above 0"),
        (
            "axes_sd_deg = 3.0",
            "axes_sd_deg = 3.0\naxes_B = [[1, 0, 0], [0, 1, 0], [0, 1, 1]]",
            "not orthonormal",
        ),
    ],
)
def test_what_is_no_prior_of_moments_is_refused(tmp_path, old, new, says):
    folder = bi.write_campaign(small_campaign(), tmp_path / "c")
    with open(folder / "campaign.toml", "a", encoding="utf-8") as file:
        file.write(OF_MOMENTS.replace(old, new))
    with pytest.raises(bi.CampaignError, match=rf"campaign\.toml, key prior.*{says}"):
        bi.read_campaign(folder)


def test_where_the_slews_tell_little_the_prior_of_moments_is_the_result():
    small = small_campaign()
    truth = np.sort(np.linalg.eigvalsh(small.inertia.tensor))[::-1]
    prior = bi.GaussianPrior.of_principal_moments(truth, 1e-6, 1e-4)
    fitted = bi.estimate(replace(small, prior=prior))
    seen = {p.name: p for p in bi.observe(fitted).parameters}
    assert seen["Jxx"].share_own_prior + seen["Jxx"].share_other_priors > 0.9
    assert fitted.sd[0] == pytest.approx(1e-6 * truth[0], rel=0.1)


def test_a_result_with_the_wheels_spin_is_taken_over_by_a_campaign_without_it(tmp_path):
    """Else J was off by the spin inertia, several sds of a good result."""
    content = {"as_prior": PRIOR.json(), "includes_wheel_spin": True}
    known = bi.prior_in(run_with(tmp_path / "run", content))
    small = small_campaign()
    taken = replace(small, prior=known).prior
    spin = sum(w.spin_inertia * np.outer(w.axis_B, w.axis_B) for w in small.wheels)
    names = {"Jxx": spin[0, 0], "Jyy": spin[1, 1], "Jzz": spin[2, 2]}
    shift = [names.get(name, 0.0) for name in PRIOR.names]
    np.testing.assert_array_equal(taken.mean, PRIOR.mean - shift)
    assert replace(small, prior=taken).prior == taken
    locked = replace(small, inertia=replace(small.inertia, includes_wheel_spin=True))
    np.testing.assert_array_equal(replace(locked, prior=known).prior.mean, PRIOR.mean)
    assert bi.prior_in(run_with(tmp_path / "again", {"as_prior": taken.json()})) == taken
    with pytest.raises(bi.CampaignError, match="spin inertia otherwise"):
        replace(small, prior=replace(known, logarithmic=("Jxx",)))


def test_a_prior_that_no_body_can_meet_is_refused_by_its_own_name():
    with pytest.raises(bi.CampaignError, match=r"key prior: the ends of Jxx leave out its mean"):
        bi.GaussianPrior(("Jxx",), [3.0], [[0.01]], lower=[100.0])
    # A logarithm that was forgotten.
    prior = bi.GaussianPrior(("Jxx",), [3.0], [[0.01]], logarithmic=("Jxx",))
    with pytest.raises(bi.CampaignError, match=r"key prior: hardly any draw .*logarithmic"):
        bi.Model(replace(small_campaign(), prior=prior)).draw_prior(1, 500)


def test_sds_of_scale_factors_without_their_medians_are_refused():
    with pytest.raises(bi.CampaignError, match=r"prior\.scale_factors_sd: there are no scale_fac"):
        bi.GaussianPrior.of_principal_moments([3.3, 2.2, 1.6], 0.05, 2.0, scale_factors_sd=1e-4)


def test_a_prior_prints_the_logarithms_that_it_holds():
    prior = bi.GaussianPrior.of_principal_moments([3.3, 2.2, 1.6], 0.05, 2.0)
    assert "log Jxx 1.193 ± 0.050, log Jyy 0.789 ± 0.050" in repr(prior)
