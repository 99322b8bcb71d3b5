"""posterior.nc and the report: the same every time, and damage that is told."""

from __future__ import annotations

import gc
import json
import os
import re
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from support.campaign_files import assert_teaches

import bayes_inertia as bi
from bayes_inertia.app import fit_campaign
from bayes_inertia.app.cli import main
from bayes_inertia.app.result_folder import write_json
from bayes_inertia.errors import CampaignError, OutputError, SettingsError
from bayes_inertia.files import write_atomically
from bayes_inertia.inference.likelihood_summary import summary_from_json, with_prior
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths.inertia_tensor import ELEMENTS
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.report.fit_sections import standard_sections
from bayes_inertia.report.page import render
from bayes_inertia.sealing import sealed

SEAL = b"\nbayes-inertia sha256"


def words(posterior: Posterior) -> str:
    """The page without its pictures, which take long to draw."""
    sections = [replace(part, pictures=()) for part in standard_sections(posterior)]
    return render(posterior, sections)


@pytest.mark.slow
def test_two_runs_of_one_seed_write_the_same_report(made):
    """They differ in the seconds that they took, which summary.json tells."""
    posterior = made("one_slew")
    first, attributes = words(posterior), posterior.attributes
    for changed, same in (({"seconds": 45.6}, True), ({"steps": 63}, False)):
        stated = attributes | {"diagnostics": attributes["diagnostics"] | changed}
        posterior.tree.attrs["bayes_inertia"] = json.dumps(stated)
        assert (words(posterior) == first) == same


@pytest.fixture
def stored(made, tmp_path):
    return made("one_slew").save(tmp_path / "posterior.nc")


def test_a_stored_posterior_is_read_back(stored):
    assert SEAL in stored.read_bytes()[-100:]
    assert Posterior.load(stored).summary()["parameters"]["Jxx"]["sd"] > 0.0


def test_what_is_no_posterior_is_told(made, tmp_path):
    posterior = made("one_slew")
    for call in (Posterior.load, posterior.save):
        with pytest.raises(CampaignError, match="path: None is no path"):
            call(None)
    for tree in (None, xr.DataTree()):
        with pytest.raises(CampaignError, match="tree: the format is not bayes-inertia-posterior"):
            Posterior(tree)
    xr.DataTree().to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(CampaignError, match=r"other\.nc, tree: the format is not"):
        Posterior.load(tmp_path / "other.nc")
    with pytest.raises(SettingsError, match=r"draws: its shape is \(3, 4\)"):
        posterior.widened(np.ones((3, 4)))


def test_a_flipped_bit_is_reported_by_every_command(stored, capsys):
    data = bytearray(stored.read_bytes())
    data[len(data) // 2] ^= 16
    stored.write_bytes(bytes(data))
    with pytest.raises(CampaignError, match="is damaged") as caught:
        Posterior.load(stored)
    assert_teaches(caught.value, ["posterior.nc", "resume"])
    with pytest.raises(SystemExit) as stop:
        main(["report", str(stored.parent)])
    assert stop.value.code == 2
    assert "posterior.nc: is damaged" in capsys.readouterr().err


@pytest.mark.slow
def test_without_a_seal_another_process_reads_it_first(stored):
    data = stored.read_bytes()
    bare = data[: data.rindex(SEAL)]
    stored.write_bytes(bare)
    assert Posterior.load(stored).names[0] == "Jxx"
    # As long as before, so that HDF5 itself may not see the end of the file missing.
    stored.write_bytes(bare[: len(bare) // 3] + bytes(len(bare) - len(bare) // 3))
    with pytest.raises(CampaignError, match=r"posterior\.nc"):
        Posterior.load(stored)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="limits of file size are POSIX")
def test_text_that_is_none_is_damage(made, stored, tmp_path):
    """Half a character, as a flipped bit makes it, cannot be written to a page."""
    posterior = made("one_slew")
    tree = posterior.tree.copy()
    tree.attrs["bayes_inertia"] = json.dumps(posterior.attributes | {"campaign": "\udc9e"})
    path = tmp_path / "unsealed.nc"
    tree.to_netcdf(path, engine="h5netcdf")
    with pytest.raises(CampaignError, match="is damaged") as caught:
        Posterior.load(path)
    assert_teaches(caught.value, ["unsealed.nc", "resume"])


def test_a_disk_without_room_leaves_the_old_result(made, stored):
    import resource

    before, posterior = stored.read_bytes(), made("good")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(OutputError, match=r"posterior\.nc: cannot be written"):
            posterior.save(stored)
        with pytest.raises(OutputError, match=r"report\.html: cannot be written"):
            write_atomically(stored.with_name("report.html"), bytes(10_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [(p.name, p.read_bytes()) for p in stored.parent.iterdir()] == [(stored.name, before)]
    # What was written to memory is let go of; pytest reports what is not.
    gc.collect()


def test_likelihood_and_prior_make_the_quoted_posterior(made):
    posterior = made("good")
    content, told = posterior.summary(), posterior.likelihood
    assert summary_from_json(content["likelihood"]) == told
    mean, covariance = with_prior(told)
    np.testing.assert_allclose(mean, posterior.tree["estimate"]["theta"][:9], rtol=1e-9)
    for k, name in enumerate(posterior.names[:9]):
        # Eight hundred draws tell an sd to 2.5 %, its 90 % interval to 5 %: three sds.
        quoted = content["parameters"][name]["quoted_sd"]
        assert np.sqrt(covariance[k, k]) == pytest.approx(quoted, rel=0.15)


def test_slews_that_disagree_widen_what_they_tell_and_not_the_prior(made):
    posterior = made("good")
    plain, estimate = posterior.likelihood, posterior.tree["estimate"]
    # Jzz and what it goes along with as its prior has it: the data tell nothing of it.
    covariance = estimate["covariance"].values.copy()
    covariance[2], covariance[:, 2] = 0.0, 0.0
    covariance[2, 2] = float(estimate["prior_sd"][2]) ** 2
    attributes = posterior.attributes
    attributes["fit"]["dispersion"] = {"factor": 2.0}
    tree = posterior.tree.copy(deep=True)
    tree.attrs["bayes_inertia"] = json.dumps(attributes)
    tree["estimate"]["covariance"].values[:] = covariance
    wider = Posterior(tree)
    rows, before = wider.summary()["parameters"], posterior.summary()["parameters"]
    assert rows["Jzz"]["quoted_sd"] == pytest.approx(before["Jzz"]["quoted_sd"], rel=1e-6)
    assert rows["Jxx"]["quoted_sd"] == pytest.approx(2.0 * before["Jxx"]["quoted_sd"], rel=0.01)
    told = np.delete(np.arange(9), 2)
    ratio = np.diag(plain.precision)[told] / np.diag(wider.likelihood.precision)[told]
    assert ratio == pytest.approx(4.0, rel=0.05)
    assert wider.likelihood.precision[2, 2] == pytest.approx(0.0, abs=1e-9)


def test_a_refused_result_passes_nothing_on(made):
    assert made("thrown").summary()["likelihood"] is None


def test_what_a_former_result_quotes_beyond_its_model_is_in_every_quoted_sd(made):
    """Of elements, principal moments and ratios, and of the draws that a forecast flies."""
    posterior = made("good")
    plain, sd = posterior.summary(), 1e-2
    shifts = np.zeros((2, len(posterior.names)))
    shifts[0, 0], shifts[1, 6] = sd, 2.0 * sd
    shifts = xr.DataArray(shifts, dims=("known", "parameter"))
    posterior.tree["estimate"]["prior_beyond_shifts"] = shifts
    wider = Posterior(posterior.tree)
    told, J = wider.summary(), posterior.tree["estimate"]["theta"].values[:6]

    def added(part: str, name: str) -> float:
        before, after = (content[part][name]["quoted_sd"] for content in (plain, told))
        return float(np.sqrt(after**2 - before**2))

    assert added("parameters", "Jxx") == pytest.approx(sd)
    assert added("parameters", "K1") == pytest.approx(2.0 * sd)
    assert added("parameters", "Jyy") == 0.0
    trace = J[:3].sum()
    assert added("ratios", "Jyy/trace") == pytest.approx(J[1] / trace**2 * sd, rel=0.02)
    assert added("derived", "I3") == pytest.approx(sd, rel=0.1)
    for k, size in ((0, sd), (6, 2.0 * sd)):
        spread = np.hypot(posterior.samples[:, k].std(), size)
        # An sd of 800 draws scatters by 2.5 %.
        assert wider.widened(posterior.samples)[:, k].std() == pytest.approx(spread, rel=0.1)


def test_where_nothing_ties_the_size_of_the_tensor_it_shows_ratios(made):
    """The sd of an element of J would be the prior's, under the heading of a quoted one."""
    posterior = made("good")
    attributes = posterior.attributes | {"scale_of_J": []}
    posterior.tree.attrs["bayes_inertia"] = json.dumps(attributes)
    shown = repr(posterior)
    assert "Jxx/trace" in shown
    assert "kg m²" not in shown
    assert "K1 " in shown


def test_a_refused_result_shows_no_sd(made):
    posterior = made("thrown")
    assert "± –" in repr(posterior)
    for text in (repr(posterior), posterior._repr_html_()):
        assert not re.search(r"± \d", text)
    assert "<td>yes</td>" not in posterior._repr_html_()


@pytest.fixture
def changed(make_case) -> Posterior:
    """A fit with a change of J during the campaign."""
    return make_case(extra=tuple(f"fuel.change_{name}" for name in ELEMENTS))


def test_a_series_goes_on_with_the_tensor_after_its_change(changed):
    mean, covariance = with_prior(changed.likelihood)
    np.testing.assert_allclose(mean, changed.as_prior.mean, rtol=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), changed.as_prior.sd, rtol=1e-6)


def test_the_next_campaign_begins_with_the_tensor_after_its_change(changed):
    """J of a fit is the one before; the next campaign flies what came after."""
    posterior = changed
    prior, estimate = posterior.as_prior, posterior.tree["estimate"]
    theta, sd = estimate["theta"].values, np.sqrt(np.diag(estimate["covariance"].values))
    np.testing.assert_allclose(prior.mean[:6], theta[:6] + theta[9:], rtol=1e-12)
    np.testing.assert_allclose(prior.sd[:6], np.hypot(sd[:6], sd[9:]), rtol=1e-9)
    np.testing.assert_allclose(prior.mean[6:], theta[6:9], rtol=1e-12)
    np.testing.assert_allclose(prior.sd[6:], sd[6:9], rtol=1e-9)


@pytest.fixture
def fitted(monkeypatch) -> list[tuple]:
    """What `fit` is called with, which fits nothing."""
    calls: list[tuple] = []
    monkeypatch.setattr(fit_campaign, "fit", lambda *given, **more: calls.append((*given, more)))
    return calls


def test_an_update_of_a_posterior_a_file_or_a_run_is_one_fit(made, fitted, tmp_path):
    posterior, campaign = made("good"), small_campaign()
    stored = posterior.save(tmp_path / "posterior.nc")
    write_json(tmp_path / "summary.json", sealed(posterior.summary()))
    for former in (posterior, stored, tmp_path, str(tmp_path)):
        bi.update(former, campaign, inflate=1e-3, seed=3, effects=["rate_bias"])
    known = posterior.as_prior.inflated(1e-3)
    assert fitted == [(replace(campaign, prior=known), {"seed": 3, "effects": ["rate_bias"]})] * 4
    assert known.sd[0] > posterior.as_prior.sd[0]


def test_what_cannot_be_updated_is_said(made, fitted, tmp_path):
    campaign, good = small_campaign(), made("good")
    known = good.attributes | {"slew_digests": campaign.slew_digests}
    good.tree.attrs["bayes_inertia"] = json.dumps(known)
    for former, new, says in (
        (
            made("thrown"),
            campaign,
            "the result quotes no sd: it is not to be used, and no prior; read its report",
        ),
        (good, campaign, "holds this telemetry already: it would count twice"),
        (good, "my_campaign", "campaign: a str is no Campaign; give a Campaign: read_campaign"),
        (3, campaign, "former: 3 is no path"),
        (tmp_path / "none", campaign, "summary.json|none"),
    ):
        with pytest.raises(CampaignError, match=says):
            bi.update(former, new)
    assert fitted == []


def test_what_former_results_determined_stays_determined(made):
    """An update of a trusted result said that J and K are not determined."""
    posterior = made("good")
    before, estimate = posterior.summary()["parameters"], posterior.tree["estimate"]
    estimate["preflight_sd"] = estimate["prior_sd"].copy()
    estimate["prior_sd"] = 0.0 * estimate["theta"] + 1.2 * posterior.samples.std(0)
    for name in ELEMENTS:
        prior = posterior.tree["posterior"][name].values
        posterior.tree["prior"][name].values[:] = prior.mean() + 1.2 * np.resize(
            prior - prior.mean(), posterior.tree["prior"][name].shape
        )
    told = Posterior(posterior.tree).summary()
    rows, ratios = told["parameters"], told["ratios"]
    assert rows == {
        name: row | {"prior_sd": rows[name]["prior_sd"]} for name, row in before.items()
    }
    assert all(row["contraction"] > 0.9 for row in ratios.values())
