"""Why each parameter is as uncertain as it is: exact splits, degeneracies, the posterior beside."""

from __future__ import annotations

import json
from dataclasses import replace
from html import escape
from itertools import permutations
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from bayes_inertia.app import observe_folder
from bayes_inertia.app.cli import main
from bayes_inertia.app.observe_folder import run_observe
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.errors import EstimateError
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.objective import normal_equations
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.observability.against_posterior import compare_with_posterior, comparison_json
from bayes_inertia.observability.analysis import inflation_by_group, observe
from bayes_inertia.observability.degeneracy import data_information, stated_degeneracies
from bayes_inertia.observability.result import commands_worth, in_windows
from bayes_inertia.observability.sentences import answer, sentence
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.slew_input import Start, idle_slew
from bayes_inertia.report.formatting import plain
from bayes_inertia.report.observability_sections import observability_sections, observability_table
from bayes_inertia.report.pictures.observability import draw_observability


@pytest.fixture(scope="module")
def estimate(flown):
    return optimizer.estimate(Model(flown.campaign), starts=1)


@pytest.fixture(scope="module")
def observability(estimate):
    return observe(estimate)


def without_tachometers(campaign):
    return replace(campaign, wheels=tuple(replace(w, momentum_sigma=None) for w in campaign.wheels))


# --- variance inflation on linear examples made by hand ---------
def test_inflation_by_one_group_is_one_over_one_minus_r_squared():
    r = 0.8
    H = np.array([[1.0, r, 0.0], [r, 1.0, 0.0], [0.0, 0.0, 4.0]])
    np.testing.assert_allclose(
        inflation_by_group(H, [np.array([1]), np.array([2])], 1),
        [[1.0 / (1.0 - r**2), 1.0]],
        rtol=1e-12,
    )


def test_inflation_is_the_average_over_all_orders_and_multiplies_to_the_whole():
    rng = np.random.default_rng(7)
    rows = rng.normal(size=(12, 7))
    H = rows.T @ rows
    groups = [np.array([0, 1]), np.array([2]), np.array([3, 5]), np.array([4, 6])]
    factors = inflation_by_group(H, groups, 2)
    for i in range(2):
        logs = np.zeros(len(groups))
        for order in permutations(range(len(groups))):
            known, last = {i}, -np.log(H[i, i])
            for k in order:
                known |= set(groups[k].tolist())
                index = sorted(known)
                now = np.log(np.linalg.inv(H[np.ix_(index, index)])[index.index(i), index.index(i)])
                logs[k] += (now - last) / 24.0
                last = now
        np.testing.assert_allclose(np.log(factors[i]), logs, atol=1e-10)
        assert abs(np.prod(factors[i]) - np.linalg.inv(H)[i, i] * H[i, i]) < 1e-9
    assert factors.min() >= 1.0 - 1e-12
    again = inflation_by_group(H, groups[::-1], 2)
    np.testing.assert_allclose(again[:, ::-1], factors, rtol=1e-10)


# --- a real campaign --------------------------------------------
def test_sd_is_that_of_the_laplace_approximation_and_is_split_exactly(estimate, observability):
    np.testing.assert_allclose([p.sd for p in observability.parameters], estimate.sd, rtol=1e-9)
    for p in observability.parameters:
        assert p.share.min() >= 0.0
        assert abs(p.share.sum() + p.share_own_prior + p.share_other_priors - 1.0) < 1e-8
        assert abs(np.prod(list(p.inflation.values())) / p.variance_inflation - 1.0) < 1e-8
        assert abs((p.sd / p.conditional_sd) ** 2 / p.variance_inflation - 1.0) < 1e-8
        assert (
            p.conditional_sd
            <= p.sd
            <= min(p.sd_without_slew.min(), np.nanmin(p.sd_without_channel))
        )
        assert abs(np.sum(p.signal_by**2) - p.signal**2) < 1e-8 * p.signal**2


def test_information_over_time_sums_to_that_of_the_marginal(estimate, observability):
    for i, p in enumerate(observability.parameters):
        total = sum(a.precision[..., i].sum() for a in observability.arrivals)
        assert abs(total * p.sd**2 + p.share_own_prior + p.share_other_priors - 1.0) < 1e-8
        for s, arrival in enumerate(observability.arrivals):
            np.testing.assert_allclose(
                arrival.precision[..., i].sum(0) * p.sd**2, p.share[s], rtol=1e-7, atol=1e-12
            )
            np.testing.assert_allclose(
                in_windows(arrival)[1].sum(0), arrival.precision.sum(0), rtol=1e-12
            )
            assert len(arrival.time) == len(estimate.model.campaign.slews[s].time)
    # Star tracker fixes tell only at their own rows.
    fixes = np.isfinite(estimate.model.campaign.slews[0].attitude).all(axis=1)
    assert np.all(observability.arrivals[0].precision[~fixes, 1] == 0.0)
    assert np.all(observability.arrivals[0].precision[fixes, 1].sum(1) > 0.0)


def test_leaving_out_a_slew_is_what_the_estimate_says_of_it(estimate, observability):
    hessian, _ = normal_equations(
        estimate.model, estimate.point, estimate.information, np.outer([1.0, 0.0, 1.0], np.ones(3))
    )
    np.testing.assert_allclose(
        [p.sd_without_slew[1] for p in observability.parameters],
        np.sqrt(np.diag(np.linalg.inv(hessian)))[:9],
        rtol=1e-5,
    )


def test_directions_rebuild_the_covariance(estimate, observability):
    scale = estimate.model.space.sd
    rebuilt = sum(
        (1.0 - d.contraction) * np.outer(d.weights, d.weights) for d in observability.directions
    )
    np.testing.assert_allclose(rebuilt, estimate.covariance / np.outer(scale, scale), atol=1e-9)
    assert not any(d.exact for d in observability.directions)


def test_the_other_drive_must_be_of_the_same_parameters(estimate):
    with pytest.raises(EstimateError, match="other drive"):
        observe(estimate, estimate)


def test_commands_are_worth_the_sd_without_them_over_the_sd_with_them(estimate, observability):
    measured = replace(
        estimate,
        model=Model(estimate.model.campaign, drive="measured"),
        hessian=estimate.hessian / 4.0,
    )  # as if its sd were twice as large
    view = observe(estimate, measured)["Jxy"]
    assert abs(commands_worth(view, "commanded") - 2.0) < 1e-9
    assert abs(commands_worth(view, "measured") - 0.5) < 1e-9
    assert commands_worth(observability["Jxy"], "commanded") is None
    assert "without the recorded commands its sd would be 2 times larger" in sentence(
        observe(estimate, measured), "Jxy"
    )


# --- what cannot be told ----------------------------------------
@pytest.mark.long
@pytest.mark.slow
def test_one_slew_about_z_leaves_the_rest_of_the_tensor_to_the_prior(
    flying, setup_type, truth_type
):
    # A truth like the prior and wheels that start at rest: hardly any motion about x and y.
    setup = setup_type(turns=((0.0, 0.0, 0.7),), start_rate=(0.0, 0.0, 0.0), start_momentum=0.0)
    prior = flying(61, setup).campaign.inertia.elements
    flown = flying(61, setup, truth=truth_type(np.concatenate([prior, np.ones(3)]), np.zeros(3)))
    observability = observe(optimizer.estimate(Model(flown.campaign), starts=1))
    for seen in ("Jzz", "Jxz", "Jyz", "K3"):
        assert observability[seen].verdict == "determined", seen
    for hidden in ("Jxx", "Jyy", "Jxy", "K1", "K2"):
        assert observability[hidden].contraction < observability["Jxz"].contraction, hidden
        assert observability[hidden].verdict != "determined", hidden
    stated = {d.name: d for d in observability.degeneracies}
    assert {"Jxx", "Jyy", "Jxy"} <= set(stated["single axis"].parameters)
    assert not {"Jzz", "Jxz", "Jyz", "K3"} & set(stated["single axis"].parameters)
    weakest = observability.directions[0]
    assert weakest.verdict_is_prior
    assert not {"Jzz", "Jxz", "Jyz", "K3"} & set(
        weakest.says.replace("+", " ").replace("-", " ").split()
    )


@pytest.mark.long
@pytest.mark.slow
def test_a_common_wheel_gain_is_always_stated_and_shown_where_it_is_fitted(flown, observability):
    stated = [d for d in observability.degeneracies if d.name == "common wheel gain"]
    assert len(stated) == 1
    assert stated[0].exact
    assert not stated[0].in_sd
    assert stated[0].information_ratio is None
    estimate = optimizer.estimate(
        Model(without_tachometers(flown.campaign), by_name(["wheel_torque_gain"])), starts=1
    )
    with_gain = observe(estimate)
    shown = next(d for d in with_gain.degeneracies if d.name == "common wheel gain")
    assert shown.exact
    assert shown.in_sd
    assert shown.information_ratio < 1e-6
    # Along it the size of J follows the gains; both stay as uncertain as their priors leave them.
    weakest = with_gain.directions[0]
    gains = [n for n in with_gain.names if "gain" in n]
    assert len(gains) == 3
    for name in gains:
        assert name in weakest.says
    assert observability["Jxx"].sd < 0.1 * with_gain["Jxx"].sd
    assert with_gain["Jxx"].inflation["effects"] > 10.0
    # A direction that is not degenerate has information: the same test would have failed for it.
    v = np.zeros(len(with_gain.names))
    v[with_gain.names.index("Jxx")] = with_gain["Jxx"].value
    assert v @ data_information(estimate) @ v > 1e4


@pytest.mark.slow
def test_without_wheels_the_size_of_the_tensor_is_exactly_degenerate(flown):
    """A body that tumbles freely, simulated here: stated, and the weakest direction."""
    rng, truth = np.random.default_rng(62), flown.truth.theta
    slews = []
    for s in flown.campaign.slews:
        start = Start(
            jnp.asarray(0.02 * rng.normal(size=3)), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(0)
        )
        tumble = simulate_slew(
            idle_slew(s.time), start, inertia_tensor.tensor(jnp.asarray(truth[:6]))
        )[0]
        rate = np.asarray(tumble.rate_B) / truth[6:9] + 2e-5 * rng.normal(size=s.rate.shape)
        attitude = np.where(np.isfinite(s.attitude), np.asarray(tumble.attitude), np.nan)
        slews.append(
            replace(s, rate=rate, attitude=attitude, wheel_torque=None, wheel_momentum=None)
        )
    free = observe(
        optimizer.estimate(Model(replace(flown.campaign, wheels=(), slews=tuple(slews))), starts=1)
    )
    stated = next(d for d in free.degeneracies if d.name == "size of J")
    assert stated.exact
    assert stated.information_ratio < 1e-9
    assert [d.exact for d in free.directions] == [True] + [False] * 8
    assert free.directions[0].says == "Jxx+Jyy+Jzz"
    assert not any(d.name == "common wheel gain" for d in free.degeneracies)
    assert "only in its ratio to the others" in sentence(free, "Jxx")
    assert "momentum" not in "".join(sentence(free, name) for name in free.names)


@pytest.mark.long
@pytest.mark.slow
def test_tachometers_tell_the_gain_and_take_its_place(flown):
    estimate = optimizer.estimate(Model(flown.campaign, by_name(["wheel_torque_gain"])), starts=1)
    shown = next(d for d in stated_degeneracies(estimate) if d.name == "common wheel gain")
    assert not shown.exact
    assert not shown.in_sd
    assert shown.information_ratio > 1e-6
    assert "tachometers" in shown.says


def test_a_resting_wheel_a_plane_of_slews_and_a_missing_star_tracker_are_stated(estimate):
    campaign = estimate.model.campaign
    names = [d.name for d in stated_degeneracies(estimate)]
    assert names == ["common wheel gain"]

    def resting(slew):
        torque, momentum = slew.wheel_torque.copy(), slew.wheel_momentum.copy()
        torque[:, 2], momentum[:, 2] = 0.0, 0.01 + 1e-6 * np.sin(slew.time)
        return replace(slew, wheel_torque=torque, wheel_momentum=momentum)

    def planar(slew):
        return replace(slew, rate=slew.rate * [1.0, 1.0, 0.0])

    rests = stated_degeneracies(
        replace(estimate, model=Model(replace(campaign, slews=tuple(map(resting, campaign.slews)))))
    )
    assert next(d.says for d in rests if d.name == "wheel at rest").startswith("Wheel w2 ")
    flat = stated_degeneracies(
        replace(estimate, model=Model(replace(campaign, slews=tuple(map(planar, campaign.slews)))))
    )
    plane = next(d for d in flat if d.name == "single plane")
    assert plane.parameters == ("Jzz", "K3")
    blind = estimate.information.matrix.copy()
    blind[:, 1] = 0.0
    n_data = estimate.information.n_data.copy()
    n_data[:, 1] = 0
    no_fix = replace(
        estimate, information=estimate.information._replace(matrix=blind, n_data=n_data)
    )
    no_fix = replace(
        no_fix, hessian=normal_equations(no_fix.model, no_fix.point, no_fix.information)[0]
    )
    stated = next(d for d in stated_degeneracies(no_fix) if d.name == "no attitude")
    assert stated.information_ratio < 0.1


@pytest.mark.long
@pytest.mark.slow
def test_coefficients_of_an_effect_are_no_noise_of_tachometers(flown):
    seen = observe(optimizer.estimate(Model(flown.campaign, by_name(["torque_noise"])), starts=1))
    for p in seen.parameters:
        assert "tachometer noise" not in p.inflation
        assert np.prod(list(p.inflation.values())) == pytest.approx(p.variance_inflation, rel=1e-6)
    assert seen["Jxx"].inflation["effects"] > 1.01
    assert all(np.isfinite(p.signal) for p in seen.parameters)


# --- beside a posterior -----------------------------------------
def sampled(observability, draws):
    return SimpleNamespace(
        names=list(observability.names),
        samples=draws,
        attributes={"diagnostics": {"ess_bulk_min": len(draws)}},
    )


def test_a_gaussian_posterior_agrees_and_every_kind_of_difference_is_named(estimate, observability):
    rng = np.random.default_rng(3)
    draws = rng.multivariate_normal(estimate.theta, estimate.covariance, 20_000, method="cholesky")
    rows = compare_with_posterior(observability, sampled(observability, draws))
    assert [r.warnings for r in rows] == [()] * 9
    content = comparison_json(rows)
    assert list(content) == list(observability.names)
    assert set(content["Jxx"]) == {
        "predicted_sd",
        "posterior_sd",
        "ratio",
        "shift",
        "skewness",
        "kurtosis",
        "warnings",
    }
    for row in rows:  # four Monte Carlo errors
        assert abs(row.ratio - 1.0) < 4.0 / np.sqrt(2 * 20_000)
    odd = draws.copy()
    odd[:, 0] = estimate.theta[0] + 1.2 * (draws[:, 0] - estimate.theta[0])
    odd[:, 3] = (
        estimate.theta[3]
        + estimate.sd[3] * (stats.gamma(4.0).rvs(20_000, random_state=rng) - 4.0) / 2.0
    )
    warned = {
        r.name: " ".join(r.warnings)
        for r in compare_with_posterior(observability, sampled(observability, odd))
        if r.warnings
    }
    assert set(warned) == {"Jxx", "Jxy"}
    assert "differs from the prediction: sd 1.2" in warned["Jxx"]
    assert "non-Gaussian" in warned["Jxy"]
    with pytest.raises(EstimateError, match="other parameters"):
        compare_with_posterior(observability, SimpleNamespace(names=["Jxx"]))


def test_truncation_by_physics_is_named(observability):
    """A thin plate: Jxx + Jyy is nearly Jzz, and half of the predicted Gaussian is no body."""
    values = {"Jxx": 1.0, "Jyy": 1.0, "Jzz": 2.0, "Jxy": 0.0, "Jxz": 0.0, "Jyz": 0.0}
    plate = replace(
        observability,
        parameters=tuple(
            replace(p, value=values.get(p.name, p.value), sd=0.01) for p in observability.parameters
        ),
        covariance=1e-4 * np.eye(9),
    )
    rng = np.random.default_rng(4)
    draws = np.array([p.value for p in plate.parameters]) + 0.01 * rng.normal(size=(40_000, 9))
    inside = draws[:, 0] + draws[:, 1] > draws[:, 2]
    warned = {
        r.name: " ".join(r.warnings)
        for r in compare_with_posterior(plate, sampled(plate, draws[inside]))
    }
    for name in ("Jxx", "Jyy", "Jzz"):
        assert "truncated by physics" in warned[name]
    assert "truncated" not in warned["K1"]


# --- the command ------------------------------------------------
@pytest.mark.parametrize("factor", [1.0, 0.5])
def test_a_posterior_of_another_prior_is_not_put_beside_it(
    factor, estimate, observability, tmp_path, monkeypatch
):
    """`fit --prior` there, `observe` here: that its sds are smaller is no finding."""
    draws = np.random.default_rng(5).multivariate_normal(estimate.theta, estimate.covariance, 99)
    posterior = sampled(observability, draws)
    posterior.attributes |= {"campaign_sha256": "ab", "drive": observability.drive}
    prior_sd = [factor * p.prior_sd for p in observability.parameters]
    posterior.tree = {"estimate": {"prior_sd": prior_sd}}
    (tmp_path / "posterior.nc").touch()
    monkeypatch.setattr(observe_folder.Posterior, "load", lambda _: posterior)
    compared = observe_folder._comparison(observability, tmp_path, "ab")
    assert (compared is None) == (factor != 1.0)


@pytest.mark.slow
def test_one_outlier_does_not_make_a_slew_count_for_little(flown, observability, tmp_path):
    """As `fit`, the command leaves it out; the plain estimate, the control, does not."""
    first, *others = flown.campaign.slews
    rate = first.rate.copy()
    rate[len(rate) // 2, 1] += 100.0 * flown.campaign.rate_sensor.sigma[1]
    dirty = replace(flown.campaign, slews=(replace(first, rate=rate), *others))
    write_campaign(dirty, tmp_path / "campaign")
    seen = run_observe(tmp_path / "campaign", tmp_path / "run", both_drives=False)
    clean = np.array([p.sd for p in observability.parameters])
    assert np.all(np.array([p.sd for p in seen.observability.parameters]) < 1.05 * clean)
    dusty = observe(optimizer.estimate(Model(dirty)))
    assert np.any(np.array([p.sd for p in dusty.parameters]) > 1.05 * clean)


def test_the_answer_names_parameters_of_further_sensors_as_the_table_does(observability):
    first, *others = observability.parameters
    renamed = replace(observability, parameters=(replace(first, name="mems.K3"), *others))
    assert "mems: K3" in answer(renamed, plain)
    assert "mems.K3" not in answer(renamed, plain)


@pytest.mark.parametrize("times", [30.0, 2e5])
def test_the_ticks_of_what_others_cost_leave_each_other_room(observability, times):
    """Where nothing ties the size of J, others cost it a factor of 200,000."""
    first, *others = observability.parameters
    dear = replace(first, variance_inflation=times**2)
    axes = draw_observability(replace(observability, parameters=(dear, *others))).axes[1]
    assert np.diff(axes.get_xticks()).min() > 0.07 * np.ptp(axes.get_xlim())


def test_no_slew_and_no_sensor_is_named_of_what_only_priors_tell(observability):
    first, *others = observability.parameters
    assert first.tells_most == int(first.share.sum(1).argmax())
    tiny = 1e-4 * first.share
    untold = replace(first, share=tiny, share_other_priors=1.0 - tiny.sum(), variance_inflation=9e8)
    seen = replace(observability, parameters=(untold, *others))
    assert untold.tells_most is None
    said = sentence(seen, untold.name)
    assert "all that is known is prior knowledge" in said
    assert not [channel for channel in seen.channels if f"{channel} channel" in said]
    table = observability_table(seen)
    cells = dict(zip(table.columns, table.rows[0], strict=True))
    assert (cells["most from"], cells["others cost"]) == ("–", "× 30,000")


def test_a_spacecraft_without_wheels_has_no_drive_in_print(observability):
    drives = [
        dict(observability_sections(seen)[-1].context["rows"])["drive"]
        for seen in (observability, replace(observability, wheels=0))
    ]
    assert drives == ["commanded: torque commands are the input", "there are no wheels"]


def test_observe_writes_its_file_once_for_one_campaign(flown, observability, tmp_path, capsys):
    write_campaign(flown.campaign, tmp_path / "campaign")
    out = tmp_path / "run"

    def run(*more):
        with pytest.raises(SystemExit) as stop:
            main(["observe", str(tmp_path / "campaign"), "-o", str(out), "--no-both-drives", *more])
        return stop.value.code

    assert run() == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert printed.startswith(answer(observability))
    content = json.loads((out / "observability.json").read_text())
    assert content["format"] == "bayes-inertia-observability/1"
    assert abs(content["parameters"]["Jxz"]["sd"] / observability["Jxz"].sd - 1.0) < 1e-3
    assert content["posterior"] is None
    assert (out / "observability.png").read_bytes().startswith(b"\x89PNG")
    page = (out / "observability.html").read_text()
    assert escape(answer(observability)) in page
    assert page.count("</tr>") > len(observability.names)
    toml = tmp_path / "campaign" / "campaign.toml"
    toml.write_text(toml.read_text().replace("relative_sigma = 0.04", "relative_sigma = 0.05"))
    before = (out / "observability.json").read_bytes()
    assert run() == 2
    assert (out / "observability.json").read_bytes() == before
    assert "other data" in capsys.readouterr().err
    (out / "observability.json").write_text("mine")
    assert run() == 2
    assert (out / "observability.json").read_text() == "mine"
    (out / "observability.json").unlink()
    assert run() == 2
    assert "observability.png" in capsys.readouterr().err
