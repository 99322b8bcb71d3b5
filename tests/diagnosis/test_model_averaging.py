"""J and K where it is not known which effect is the true one."""

import json
import math
import pickle

import numpy as np
import pytest
import xarray as xr
from support.refits import fitted_with

from bayes_inertia.app.diagnosis_json import next_fit_from
from bayes_inertia.app.fit_campaign import fit
from bayes_inertia.diagnosis.quoted_parameters import averaged_posterior
from bayes_inertia.diagnosis.residuals import BinnedResiduals, Disagreement
from bayes_inertia.diagnosis.result import AlternativeEffect, AlternativeParameters
from bayes_inertia.inference.posterior import FORMAT, Posterior
from bayes_inertia.inference.settings import Settings
from bayes_inertia.physics.effects import ConstantTorque
from bayes_inertia.physics.parameters import BASE_NAMES
from bayes_inertia.report.fit_sections import diagnosis_sections, standard_sections
from bayes_inertia.report.verdict import diagnosis_verdict


@pytest.mark.long
@pytest.mark.slow
def test_each_row_of_the_table_has_its_own_J_and_K(
    torqued, content_of, check_contract, rigid_library
):
    """About as a fit in full has them; with what is named they add up to one."""
    assert torqued.verdict == "ambiguous"
    assert set(torqued.ambiguous_with[0]) >= {"constant_torque", "star_tracker_shift"}
    listed = {row.effect: row for row in torqued.other_rows}
    own = {row.effects: row.probability for row in torqued.hypotheses if row.kind == "effects"}
    total = own[torqued.named] + sum(row.probability for row in torqued.other_rows)
    assert total == pytest.approx(1.0, abs=0.01)
    library = {effect.name for effect in rigid_library}
    for name in listed.keys() & library:
        # A size that is averaged over shrinks an amplitude more than one that is as stated.
        direct = fitted_with(torqued.base.model, name)
        moved = (listed[name].mean - torqued.base.theta[:9]) / direct.sd[:9]
        whole = (direct.theta[:9] - torqued.base.theta[:9]) / direct.sd[:9]
        assert 0.5 < moved @ whole / (whole @ whole) < 1.0
        assert np.linalg.norm(moved - whole * (moved @ whole) / (whole @ whole)) < 0.3
        assert np.all(np.abs(listed[name].sd / direct.sd[:9] - 1.0) < 0.3)
    assert listed.keys() & library
    content = content_of(torqued)
    check_contract(content, rigid_library)
    assert "J and K, whichever it is" in {s.title for s in diagnosis_sections(content)}
    assert any("averaged over what may be true" in s for s in diagnosis_verdict(content).sentences)
    stored = next_fit_from(content)
    assert [a.effect for a in stored.alternatives] == [row.effect for row in torqued.other_rows]


@pytest.fixture(scope="module")
def plain(torqued):
    """The posterior with the effect that was named."""
    settings = Settings(seed=2, ensembles=2, walkers=32, steps=60, max_steps=60)
    return fit(torqued.base.model.campaign, effects=(ConstantTorque(),), seed=2, settings=settings)


@pytest.mark.long
@pytest.mark.slow
def test_averaged_J_and_K_are_the_mixture_and_the_posterior_stays(plain, tmp_path):
    given = plain.summary()["parameters"]
    names = tuple(given)[:9]
    mean, sd = plain.samples[:, :9].mean(0), plain.samples[:, :9].std(0)
    far = AlternativeParameters(
        "star_tracker_shift",
        "constant_torque",
        0.3,
        names,
        mean + 4.0 * sd,
        np.diag((0.5 * sd) ** 2),
    )
    near = AlternativeParameters(
        "magnetic_dipole", "constant_torque", 0.1, names, mean - 2.0 * sd, np.diag(sd**2)
    )
    whole = averaged_posterior(plain, (far, near), seed=3)
    # Exactly: mean 0.3 * 4 - 0.1 * 2 = 1, variance 0.6 + 0.3 / 4 + 0.1 + (0.3 * 16 + 0.1 * 4 - 1) =
    # 4.975 in sds of the first.
    rows = whole.summary()["parameters"]
    n = whole.tree["averaged"][names[0]].size
    for name, m, s in zip(names, mean, sd, strict=True):
        error = math.sqrt(4.975 / n) + math.sqrt(
            0.6 / plain.attributes["diagnostics"]["ess_bulk_min"]
        )
        draws = whole.tree["averaged"][name].values.ravel()
        assert abs((draws.mean() - m) / s - 1.0) < 4.0 * error
        assert abs(draws.std() / s - math.sqrt(4.975)) < 4.0 * error
        assert rows[name]["mean"] == np.median(draws)
        low, high = np.quantile(draws, [0.05, 0.95])
        assert rows[name]["quoted_sd"] in (None, pytest.approx((high - low) / 3.2897, rel=1e-4))
    assert rows["constant_torque.torque_x"] == given["constant_torque.torque_x"]
    assert np.array_equal(whole.samples, plain.samples)
    assert averaged_posterior(plain, (), seed=3) is plain
    over = whole.summary()["averaged_over"]
    assert [row["effects"] for row in over] == [
        ["constant_torque"],
        ["star_tracker_shift"],
        ["magnetic_dipole"],
    ]
    assert [row["probability"] for row in over] == pytest.approx([0.6, 0.3, 0.1])
    again = Posterior.load(whole.save(tmp_path / "posterior.nc"))
    assert again.summary() == whole.summary()
    assert again.tree["averaged"]["Jxx"].attrs["units"] == "kg m^2"
    parameters = next(
        section for section in standard_sections(again) if section.title == "Parameters"
    )
    assert (
        parameters.context["averaged"]
        == "constant torque 60 %, star tracker shift 30 %, magnetic dipole 10 %"
    )


@pytest.mark.long
@pytest.mark.slow
def test_an_average_holds_no_tensor_that_no_body_has(plain):
    names = plain.names[:9]
    edge = np.array(
        [4.0, 2.0, 2.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    )  # 4 = 2 + 2: half of all draws about it break the triangle inequality
    other = AlternativeParameters(
        "star_tracker_shift", "constant_torque", 0.5, tuple(names), edge, 1e-4 * np.eye(9)
    )
    whole = averaged_posterior(plain, (other,), seed=1)
    moments = whole.tree["averaged"]["principal_moment"].values.reshape(-1, 3)
    assert np.all(moments[:, 0] + moments[:, 1] >= moments[:, 2])
    assert np.mean(moments[:, 2] > 3.9) == pytest.approx(
        0.5, abs=4.0 * math.sqrt(0.25 / len(moments))
    )


@pytest.mark.long
@pytest.mark.slow
def test_probabilities_that_add_up_to_more_than_one_by_rounding_are_averaged(plain):
    names = tuple(plain.names[:9])
    mean = np.array([plain.summary()["parameters"][name]["mean"] for name in names])
    rows = [
        AlternativeParameters(f"effect_{k}", "", probability, names, mean, 1e-8 * np.eye(9))
        for k, probability in enumerate((0.3, 0.7 + 2e-16, 2e-16))
    ]
    assert sum(row.probability for row in rows) > 1.0
    over = averaged_posterior(plain, rows, seed=1).summary()["averaged_over"]
    assert min(row["probability"] for row in over) >= 0.0


@pytest.mark.slow
def test_alternatives_keep_to_the_ends_of_the_prior_and_impossible_ones_have_no_draws():
    names, draws = BASE_NAMES, np.tile([3.0, 2.5, 2.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0], (2, 4000, 1))
    variables = {name: (("chain", "draw"), draws[..., i]) for i, name in enumerate(names)}
    moments = {"principal_moment": (("chain", "draw", "axis"), draws[..., :3])}
    groups = {"posterior": xr.Dataset(variables), "derived": xr.Dataset(moments)}
    tree = xr.DataTree.from_dict(groups)
    tree.attrs["format"] = FORMAT
    tree.attrs["bayes_inertia"] = json.dumps({"effects": ["a"]})
    rows = [
        AlternativeParameters(name, "a", 0.3, names, mean, 1e-4 * np.eye(9))
        for name, mean in (("b", draws[0, 0]), ("c", [9.0, 2.0, 2.0, 0, 0, 0, 1, 1, 1]))
    ]
    ends = np.full(9, -np.inf), np.append(np.full(8, np.inf), 1.0)
    averaged = averaged_posterior(Posterior(tree), rows, 1, ends).tree["averaged"]
    K3 = averaged["K3"].values
    assert K3.max() == 1.0
    # Half of a Gaussian has the sd 0.6 of the whole.
    assert K3[K3 < 1.0].std() == pytest.approx(0.6e-2, rel=0.1)
    assert np.mean(K3 < 1.0) == pytest.approx(0.3, abs=4.0 * math.sqrt(0.21 / K3.size))
    assert averaged["Jxx"].values.max() < 4.0


def test_a_copy_of_what_has_no_correlation_is_equal():
    alternative = AlternativeEffect("nothing", 1.0, math.nan)
    copy = pickle.loads(pickle.dumps(alternative))
    assert copy == alternative
    assert hash(copy) == hash(alternative)
    binned = BinnedResiduals(("x",), np.zeros((1, 2)), np.full((1, 1, 1), math.nan))
    where = Disagreement((), 1.0, {"rate": binned}, ("slew 1",))
    copy = pickle.loads(pickle.dumps(where))
    assert (copy, hash(copy)) == (where, hash(where))
